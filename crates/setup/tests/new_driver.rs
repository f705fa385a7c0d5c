//! A driver of another maker: this file is all there is to it, and a description opens it.

use scopeservo_drivers::factory::{
    Around, ConnectError, Connected, Described, FACTORIES, Factory, Place,
};
use scopeservo_scope::{
    Axis, AxisInfo, CancelToken, Kinematics, Motion, PositiveZ, ScopeError, Stage, StageInfo,
    StagePose,
};
use scopeservo_setup::{Config, Consent, SetupError, open};
use serde::Deserialize;
use std::path::Path;
use std::sync::{Arc, Mutex};

const TOY: Factory = Factory {
    kind: "toy",
    schema: r#"{"type": "object", "properties": {"port": {"type": "string"}, "travel_um": {"type": "number"}}}"#,
    read: |table| table.read::<Toy>(),
};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Toy {
    port: String,
    travel_um: f64,
}

impl Described for Toy {
    fn check(&self) -> Result<(), String> {
        match self.travel_um > 0.0 {
            true => Ok(()),
            false => Err("travel_um must be above 0".into()),
        }
    }
    fn place(&self) -> Option<Place<'_>> {
        Some(Place::Serial(&self.port))
    }
    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let half = 0.5e-6 * self.travel_um;
        let stage = ToyStage {
            info: StageInfo {
                name: format!("toy on {}", self.port),
                axes: vec![AxisInfo {
                    axis: Axis::X,
                    min: -half,
                    max: half,
                    repeatability: 0.0,
                    arrival_tolerance: None,
                }],
                kinematics: Kinematics::SpecimenXyOnTop,
                positive_z: PositiveZ::Closer,
            },
            at: Mutex::new(0.0),
        };
        Ok(Connected::stage(Arc::new(stage), None, around))
    }
}

/// It is there at once.
struct ToyStage {
    info: StageInfo,
    at: Mutex<f64>,
}

impl Stage for ToyStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        Ok(StagePose::default().with_si(Axis::X, *self.at.lock().unwrap()))
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let mut at = self.at.lock().unwrap();
        *at = to.si(Axis::X).unwrap_or(*at);
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(Motion::Settled)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Ok(())
    }
}

fn described(toy: &str) -> Result<Config, SetupError> {
    let text = format!(
        "name = \"bench\"\n[drivers.mine.toy]\n{toy}\n[drivers.eye.twin]\n[devices]\nstage = \"mine\"\ncamera = \"eye\"\n\
         nosepiece = \"none\"\n[[objective]]\nid = \"10x\"\nmagnification = 100\nnumerical_aperture = 0.25\num_per_px = 2.2\n\
         [limits]\nx_um = [-500, 500]\n"
    );
    let known = [FACTORIES, &[TOY]].concat();
    Config::parse_with(&text, Path::new("scopeservo.toml"), &known)
}

const WHOLE: &str = "port = \"/dev/toy-of-this-test\"\ntravel_um = 2000";

#[test]
fn a_new_maker_is_one_file_and_a_line_of_the_registry() {
    let config = described(WHOLE).unwrap();
    let consent = Consent {
        home: false,
        ask: Arc::new(|_, _| false),
        ask_immersion: Arc::new(|_, _| false),
    };
    let opened = open(&config, &consent, CancelToken::new()).unwrap();
    let mine = ("mine".to_owned(), "toy on /dev/toy-of-this-test".to_owned());
    assert!(opened.drivers.contains(&mine), "{:?}", opened.drivers);
    // Behind the same gate as all others, and nobody else's meanwhile.
    let x = |um: f64| StagePose::default().with_si(Axis::X, um * 1e-6);
    assert_eq!(opened.instrument.move_to(&x(300.0)), Ok(x(300.0)));
    assert!(matches!(
        opened.instrument.move_to(&x(600.0)),
        Err(ScopeError::OutsideLimits { .. })
    ));
    let again = open(&config, &consent, CancelToken::new()).err();
    assert!(matches!(again, Some(SetupError::InUse { .. })), "{again:?}");
}

#[test]
fn what_is_wrong_in_its_table_is_told_with_its_place() {
    let said = |toy: &str| described(toy).unwrap_err().to_string();
    let key = said("port = \"a\"\ntravel_mm = 2");
    assert!(
        key.starts_with("scopeservo.toml:4:1: unknown key 'travel_mm'"),
        "{key}"
    );
    let value = said("port = \"a\"\ntravel_um = \"far\"");
    assert!(value.starts_with("scopeservo.toml:4:13: "), "{value}");
    let none = said("port = \"a\"");
    assert!(none.contains("missing field `travel_um`"), "{none}");
    let sense = said("port = \"a\"\ntravel_um = -1");
    assert!(
        sense.contains("drivers.mine: travel_um must be above 0"),
        "{sense}"
    );
    let two = said(&format!(
        "{WHOLE}\n[drivers.mine.folder]\npath = \"a\"\norder = \"newest\"\nexposure_ms = 1"
    ));
    assert!(
        two.contains("exactly one of") && two.contains("toy"),
        "{two}"
    );
    // A program that does not know the maker says so.
    let text = "name = \"a\"\n[drivers.mine.toy]\n";
    let unknown = Config::parse(text, Path::new("scopeservo.toml")).unwrap_err();
    let unknown = unknown.to_string();
    assert!(
        unknown.starts_with("scopeservo.toml:2:15: unknown key 'toy'"),
        "{unknown}"
    );
}
