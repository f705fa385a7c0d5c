//! Stages on our own drivers, from the file to a move, against the emulators.

use scopeservo_drivers::emulator::gcs2::{EmulatedStage, Gcs2Emulator};
use scopeservo_drivers::emulator::sangaboard::{EmulatedSanga, SangaEmulator};
use scopeservo_scope::{Axis, CancelToken, ObjectiveId, Remedy, ScopeError, StagePose};
use scopeservo_setup::{Config, Consent, Opened, SetupError, open};
use std::path::Path;
use std::sync::Arc;

const REST: &str = "
[drivers.eye.twin]
[devices]
stage = \"own\"
camera = \"eye\"
nosepiece = \"none\"
[[objective]]
id = \"10x\"
magnification = 100
numerical_aperture = 0.25
um_per_px = 2.2
[limits]
x_um = [-500, 500]
";

fn opened(own: &str, home: bool) -> Result<Opened, SetupError> {
    let text = format!("name = \"bench\"\n{own}{REST}");
    let config = Config::parse(&text, Path::new("scopeservo.toml"))?;
    let consent = Consent {
        home,
        ask: Arc::new(|_, _| false),
        ask_immersion: Arc::new(|_, _| false),
    };
    open(&config, &consent, CancelToken::new())
}

fn gcs2(address: &str) -> String {
    let axis = |axis: &str, name: &str| {
        format!(
            "[[drivers.own.gcs2.settings.linear]]\naxis = \"{axis}\"\nname = \"{name}\"\n\
             repeatability_um = 0.1\narrival_tolerance_um = 1\n"
        )
    };
    format!(
        "[drivers.own.gcs2]\ntcp = \"{address}\"\n[drivers.own.gcs2.settings]\nkinematics = \"moves_microscope\"\n\
         positive_z = \"closer\"\ncoupled = true\n{}{}{}",
        axis("x", "X"),
        axis("y", "Y"),
        axis("z", "Z")
    )
}

#[test]
fn a_gcs2_stage_moves_within_the_files_limits() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    let scope = opened(&gcs2(&emulator.address()), false)
        .unwrap()
        .instrument;
    let x = |um: f64| StagePose::default().with_si(Axis::X, um * 1e-6);
    scope.move_to(&x(300.0)).unwrap();
    assert!((emulator.truth()[0] - 0.3).abs() < 1e-4);
    let refused = scope.move_to(&x(600.0)).unwrap_err();
    assert!(
        matches!(refused, ScopeError::OutsideLimits { .. }),
        "{refused}"
    );
    assert!((emulator.truth()[0] - 0.3).abs() < 1e-4);
}

#[test]
fn a_stage_that_needs_homing_is_homed_only_with_consent() {
    let mut stage = EmulatedStage::hexapod();
    stage.referenced = false;
    let emulator = Gcs2Emulator::serve(stage).unwrap();
    let refused = opened(&gcs2(&emulator.address()), false).err().unwrap();
    assert!(
        matches!(
            refused.root(),
            SetupError::Scope(ScopeError::NotHomed { device: "stage" })
        ),
        "{refused}"
    );
    // What to do is a word for whoever asks the user, and no flag of any program.
    assert_eq!(refused.remedy(), Some(Remedy::Home));
    assert!(!refused.to_string().contains("--"), "{refused}");
    assert!(
        !emulator
            .heard()
            .iter()
            .any(|l| l.contains("FRF") && !l.contains('?'))
    );
    let scope = opened(&gcs2(&emulator.address()), true).unwrap().instrument;
    assert!(
        emulator
            .heard()
            .iter()
            .any(|l| l.contains("FRF") && !l.contains('?'))
    );
    scope
        .move_to(&StagePose::default().with_si(Axis::X, 1e-4))
        .unwrap();
}

#[test]
fn a_sangaboard_is_described_motor_by_motor() {
    let emulator = SangaEmulator::serve(EmulatedSanga::new()).unwrap();
    let motor = "{ um_per_step = 0.1, min_um = -5000, max_um = 5000, repeatability_um = 0.5 }";
    let own = format!(
        "[drivers.own.sangaboard]\ntcp = \"{}\"\n[drivers.own.sangaboard.settings]\nkinematics = \"specimen_xy_on_top\"\n\
         positive_z = \"closer\"\nx = {motor}\ny = {motor}\n",
        emulator.address()
    );
    let scope = opened(&own, false).unwrap().instrument;
    scope
        .move_to(&StagePose::default().with_si(Axis::X, 1e-4))
        .unwrap();
    assert_eq!(emulator.truth()[0], 1000);
}

#[test]
fn a_device_that_is_not_there_is_said_so() {
    let none = opened(&gcs2("127.0.0.1:1"), false).err().unwrap();
    assert!(
        none.to_string()
            .contains("no device answers at 127.0.0.1:1"),
        "{none}"
    );
    let both = gcs2("127.0.0.1:1").replace("tcp =", "serial = \"/dev/null\"\ntcp =");
    let both = opened(&both, false).err().unwrap();
    assert!(
        both.to_string().contains("exactly one of tcp and serial"),
        "{both}"
    );
}

#[test]
fn a_nosepiece_on_the_stages_controller_turns_where_the_file_allows_it() {
    let mut stage = EmulatedStage::hexapod_and(&[("A", 180.0)]);
    stage.velocity = 300.0;
    let emulator = Gcs2Emulator::serve(stage).unwrap();
    let objective = |id: &str, magnification: f64, deg: f64| {
        format!(
            "[[drivers.own.gcs2.settings.nosepiece.objectives]]\nid = \"{id}\"\nmagnification = {magnification}\n\
             numerical_aperture = 0.25\num_per_px = 2.2\nat_deg = {deg}\n"
        )
    };
    let text = format!(
        "name = \"bench\"\n{}[drivers.own.gcs2.settings.nosepiece]\nname = \"A\"\narrival_tolerance_deg = 0.1\n{}{}\
         [drivers.eye.twin]\n[devices]\nstage = \"own\"\ncamera = \"eye\"\nnosepiece = \"own\"\n\
         [objective_change]\nretract_z_um = -2000\nmargin_um = 50\n",
        gcs2(&emulator.address()),
        objective("10x", 100.0, 0.0),
        objective("40x", 400.0, 90.0)
    );
    let config = Config::parse(&text, Path::new("scopeservo.toml")).unwrap();
    let consent = Consent {
        home: false,
        ask: Arc::new(|_, _| false),
        ask_immersion: Arc::new(|_, _| false),
    };
    let opened = open(&config, &consent, CancelToken::new()).unwrap();
    let (gate, id) = (opened.instrument.gate(), ObjectiveId("40x".into()));
    let refused = gate.start_change(&id).unwrap_err();
    assert!(matches!(refused, ScopeError::NotRetracted { .. }));
    opened.instrument.select_objective(&id).unwrap();
    let truth = emulator.truth();
    // Retracted, turned, and back as far as the margin allows.
    assert!((truth[6] - 90.0).abs() < 1e-6, "{truth:?}");
    assert!((truth[2] + 0.05).abs() < 1e-4, "{truth:?}");
    assert_eq!(gate.current_objective(), Ok(Some(id)));
    assert!(!gate.objective_is_reported());
}

#[test]
fn cameras_of_our_own_say_what_is_wrong_with_them() {
    let camera = |camera: &str| {
        let text = format!(
            "name = \"bench\"\n[drivers.t.twin]\n{camera}\n[devices]\nstage = \"t\"\ncamera = \"eye\"\nnosepiece = \"t\"\n\
             [objective_change]\nanywhere = true\n"
        );
        let config = Config::parse(&text, Path::new("scopeservo.toml"));
        let consent = Consent {
            home: false,
            ask: Arc::new(|_, _| false),
            ask_immersion: Arc::new(|_, _| false),
        };
        let opened = config.and_then(|c| open(&c, &consent, CancelToken::new()));
        opened.err().unwrap().to_string()
    };
    let web = |more: &str, url: &str| {
        camera(&format!(
            "[drivers.eye.mjpeg]\n{more}\nsettings = {{ url = \"{url}\", latency_ms = 100, exposure = {{ now_ms = 10 }} }}"
        ))
    };
    let nobody = web("", "http://127.0.0.1:9/stream");
    assert!(nobody.contains("the camera is lost"), "{nobody}");
    let secure = web("", "https://127.0.0.1/stream");
    assert!(secure.contains("encrypted"), "{secure}");
    let half = web("user = \"me\"", "http://127.0.0.1:9/");
    assert!(
        half.contains("user and password_file belong together"),
        "{half}"
    );
    let none = web(
        "user = \"me\"\npassword_file = \"none.txt\"",
        "http://127.0.0.1:9/",
    );
    assert!(none.contains("none.txt"), "{none}");
    let folder =
        camera("[drivers.eye.folder]\npath = \"nowhere\"\norder = \"in-turn\"\nexposure_ms = 10");
    assert!(folder.contains("nowhere"), "{folder}");
    let video = camera(
        "[drivers.eye.v4l]\ndevice = \"/dev/null\"\nwidth_px = 640\nheight_px = 480\nformat = \"yuyv\"\nlatency_ms = 100",
    );
    assert!(video.contains("/dev/null"), "{video}");
}
