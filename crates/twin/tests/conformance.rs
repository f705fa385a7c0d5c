//! The instrument contract's own suite, on every stage and every kinematics.

mod common;

use common::{Bench, waves};
use scopeservo_scope::{Kinematics, conformance::check_instrument};
use scopeservo_twin::{Config, StageConfig};

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
            for check in check_instrument(&bench.instrument()) {
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
