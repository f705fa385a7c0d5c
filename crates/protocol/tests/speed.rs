//! A move at a speed: said only to drivers that know speeds, by the words of the page, and seen by the conformance suite where it is not kept.

use scopeservo_protocol::{Driver, Offer, listen};
use scopeservo_scope::{
    Axis, CancelToken, ChangeRule, Clock, Devices, Instrument, Motion, Rules, ScopeError, Stage,
    StageInfo, StagePose, SystemClock, conformance,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};

/// A driver on a port that agrees to all, and the lines that it reads after its hello.
fn agreeing(speeds: &'static str) -> (Driver, Receiver<serde_json::Value>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (tell, told) = channel();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let input = BufReader::new(stream.try_clone().unwrap());
        for line in input.lines().map_while(Result::ok) {
            let said: serde_json::Value = serde_json::from_str(&line).unwrap();
            let id = &said["id"];
            let answer = match said["call"] == "hello" {
                true => format!(
                    r#"{{"id":{id},"ok":true,"protocol":1,"name":"n","stage":{{"name":"s","moves":"microscope","positive_z":"closer"{speeds},"axes":[{{"axis":"z","min_um":0,"max_um":1000,"repeatability_um":0.1}}]}}}}"#
                ),
                false => format!(r#"{{"id":{id},"ok":true}}"#),
            };
            if said["call"] != "hello" {
                let _ = tell.send(said);
            }
            if writeln!(stream, "{answer}").is_err() {
                return;
            }
        }
    });
    (Driver::connect(&address, None).unwrap(), told)
}

fn z(um: f64) -> StagePose {
    StagePose::default().with_si(Axis::Z, um * 1e-6)
}

fn stage_of(driver: &Driver) -> Box<dyn Stage> {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    driver.devices(&clock).unwrap().stage.unwrap()
}

#[test]
fn a_driver_that_knows_speeds_is_told_one_in_um_per_s() {
    let (driver, told) = agreeing(r#","speeds":true"#);
    let stage = stage_of(&driver);
    assert!(stage.knows_speeds());
    stage.start_move_at(&z(500.0), 8.6e-4).unwrap();
    stage.start_move(&z(0.0)).unwrap();
    let said = told.recv().unwrap();
    assert_eq!(said["call"], "move");
    assert!((said["z_um"].as_f64().unwrap() - 500.0).abs() < 1e-9);
    assert!((said["speed_um_per_s"].as_f64().unwrap() - 860.0).abs() < 1e-9);
    assert!(told.recv().unwrap().get("speed_um_per_s").is_none());
    for m_per_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(stage.start_move_at(&z(1.0), m_per_s).is_err());
    }
    assert!(told.try_recv().is_err(), "nothing more was said");
}

#[test]
fn a_driver_that_does_not_say_that_it_knows_speeds_is_never_told_one() {
    for hello in ["", r#","speeds":false"#, r#","speed":true"#] {
        let (driver, told) = agreeing(hello);
        let stage = stage_of(&driver);
        assert!(!stage.knows_speeds());
        let refused = stage.start_move_at(&z(500.0), 8.6e-4);
        assert!(
            matches!(
                &refused,
                Err(ScopeError::Refused {
                    device: "stage",
                    ..
                })
            ),
            "{refused:?}"
        );
        stage.start_move(&z(0.0)).unwrap();
        assert!(told.recv().unwrap().get("speed_um_per_s").is_none());
        assert!(told.try_recv().is_err(), "the other move was not sent");
    }
}

/// The twin's stage that says it knows speeds, and does or does not keep them; what it was asked.
struct Says {
    real: Box<dyn Stage>,
    knows: bool,
    keeps: bool,
    asked: Arc<Mutex<Vec<f64>>>,
}

impl Stage for Says {
    fn info(&self) -> &StageInfo {
        self.real.info()
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        self.real.position()
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.real.start_move(to)
    }
    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        self.asked.lock().unwrap().push(m_per_s);
        match self.keeps {
            true => self.real.start_move_at(to, m_per_s),
            false => self.real.start_move(to),
        }
    }
    fn knows_speeds(&self) -> bool {
        self.knows
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.real.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.real.stop()
    }
}

#[test]
fn whether_a_driver_keeps_the_speed_that_it_knows_is_seen_by_the_suite() {
    for (knows, keeps) in [(true, true), (true, false), (false, false)] {
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let mut config = Config::realistic();
        (config.camera.width, config.camera.height) = (320, 240);
        let twin = Twin::new(config, Arc::new(Tissue::new(3)), 3, clock.clone()).unwrap();
        let asked = Arc::new(Mutex::new(Vec::new()));
        let says = Says {
            real: twin.stage(),
            knows,
            keeps,
            asked: asked.clone(),
        };
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let devices = Devices {
            stage: Some(Box::new(says)),
            ..twin.devices()
        };
        std::thread::spawn(move || {
            let offer = Offer {
                name: "n".into(),
                devices,
            };
            listen(&listener, &offer, None, &|_| {})
        });
        let driver = Driver::connect(&address, None).unwrap();
        let rules = Rules::travel_only(ChangeRule::Anywhere);
        let devices = driver.devices(&clock).unwrap();
        let scope = Instrument::new(devices, rules, CancelToken::new()).unwrap();
        let speeds = conformance::check_speed(&scope);
        assert_eq!(
            speeds.outcome.is_ok(),
            keeps || !knows,
            "{knows} {keeps}: {:?}",
            speeds.outcome
        );
        let asked = asked.lock().unwrap();
        assert_eq!(asked.len(), usize::from(knows));
        assert!(asked.iter().all(|v| (v - 40e-6).abs() < 1e-9), "{asked:?}");
    }
}
