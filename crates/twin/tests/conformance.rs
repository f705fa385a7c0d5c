//! The instrument contract's own suite, on every stage and every kinematics.

mod common;

use common::{Bench, waves};
use scopeservo_scope::Kinematics;
use scopeservo_scope::conformance::{check_instrument, check_replug};
use scopeservo_twin::{Config, StageConfig, StageFault};
use std::sync::Arc;

#[test]
fn every_stage_and_kinematics_keeps_the_contract() {
    let mut camera = Config::realistic().camera;
    camera.width = 160;
    camera.height = 120;
    for stage in [
        StageConfig::hexapod(),
        StageConfig::xyz_theta(),
        StageConfig::xyz(),
        StageConfig::xy(),
    ] {
        for kinematics in [
            Kinematics::MovesMicroscope,
            Kinematics::SpecimenRotationOnTop,
            Kinematics::SpecimenXyOnTop,
        ] {
            let stage = StageConfig {
                kinematics,
                ..stage.clone()
            };
            let name = stage.name.clone();
            let mut config = Config::realistic().with_stage(stage);
            config.camera = camera.clone();
            let bench = Bench::new(config, waves());
            let mut checks = check_instrument(&bench.instrument());
            let (replug, _) = check_replug(
                Arc::new(bench.instrument()),
                || bench.twin.fault(StageFault::Unplugged(true)),
                || {
                    bench.twin.fault(StageFault::Unplugged(false));
                    Ok(Arc::new(bench.instrument()))
                },
            );
            checks.extend(replug);
            for check in checks {
                assert_eq!(
                    check.outcome,
                    Ok(()),
                    "{name}, {kinematics:?}: {}",
                    check.name
                );
            }
        }
    }
}
