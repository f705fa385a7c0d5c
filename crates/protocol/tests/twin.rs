//! The simulated microscope behind the protocol: the same conformance suite, over a port of this machine.

#![expect(clippy::print_stdout, reason = "a test may tell what it measured")]

use scopeservo_protocol::{Driver, DriverError, Offer, Secret, listen};
use scopeservo_scope::{
    Axis, CancelToken, ChangeRule, Clock, Devices, Immersion, Instrument, Motion, ObjectiveId,
    Rules, ScopeError, StagePose, SystemClock, conformance,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::net::TcpListener;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The twin in real time on a port of its own, for as long as the test runs.
fn served(secret: Option<Secret>) -> String {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut config = Config::realistic();
    config.camera.width = 320;
    config.camera.height = 240;
    let twin = Twin::new(config, Arc::new(Tissue::new(3)), 3, clock).unwrap();
    offered(twin, secret)
}

/// A twin on a port of its own.
fn offered(twin: Twin, secret: Option<Secret>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let offer = Offer {
            name: "simulated microscope".into(),
            devices: twin.devices(),
        };
        listen(&listener, &offer, secret.as_ref(), &|_| {})
    });
    address
}

#[test]
fn the_immersion_of_a_driver_s_objectives_is_asked_about_here() {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut config = Config::realistic();
    config.optics[2].immersion = Immersion::Oil;
    let twin = Twin::new(config, Arc::new(Tissue::new(3)), 3, clock).unwrap();
    let scope = instrument(&offered(twin, None));
    let refused = scope.select_objective(&ObjectiveId("40x".into()));
    assert!(
        matches!(&refused, Err(ScopeError::ImmersionNotAgreed { change }) if change.to == Immersion::Oil),
        "{refused:?}"
    );
    let stays = scope.gate().current_objective().unwrap();
    assert_eq!(stays, Some(ObjectiveId("10x".into())));
    scope.select_objective(&ObjectiveId("20x".into())).unwrap();
}

fn instrument(address: &str) -> Instrument {
    of(&Driver::connect(address, None).unwrap())
}

fn of(driver: &Driver) -> Instrument {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let rules = Rules::travel_only(ChangeRule::Retracted {
        z: -2e-3,
        margin: 0.0,
    });
    Instrument::new(driver.devices(&clock).unwrap(), rules, CancelToken::new()).unwrap()
}

#[test]
fn the_twin_passes_the_conformance_suite_over_the_protocol() {
    let address = served(None);
    let driver = Driver::connect(&address, None).unwrap();
    let scope = Arc::new(of(&driver));
    let mut checks = conformance::check_instrument(&scope);
    let (replug, _) = conformance::check_replug(
        scope,
        || driver.cut(),
        || Ok(Arc::new(instrument(&address))),
    );
    checks.extend(replug);
    for check in checks {
        assert_eq!(check.outcome, Ok(()), "{}", check.name);
    }
}

#[test]
fn a_hundred_stops_on_the_way_are_quick() {
    let scope = instrument(&served(None));
    let gate = scope.gate();
    // Whose move a busy computer let end before the stop was asked for tells nothing, and is made again.
    let mut latencies = Vec::new();
    for k in 0..1000 {
        if latencies.len() == 100 {
            break;
        }
        let x = if k % 2 == 0 { 15e-3 } else { -15e-3 };
        gate.start_move(&StagePose::default().with_si(Axis::X, x))
            .unwrap();
        std::thread::sleep(Duration::from_millis(30));
        let is_asked_in_time = gate.poll().unwrap() == Motion::Moving;
        let start = Instant::now();
        gate.stop().unwrap();
        while gate.poll().unwrap() == Motion::Moving {}
        let took = start.elapsed();
        let at = gate.position().unwrap().si(Axis::X).unwrap();
        let is_on_the_way = (at - x).abs() > 1e-4;
        if is_asked_in_time && is_on_the_way {
            latencies.push(took);
        }
    }
    latencies.sort();
    assert_eq!(latencies.len(), 100, "stops wait for the move's end");
    println!(
        "stop latency over the protocol: median {:?}, 99th of 100 {:?}",
        latencies[50], latencies[98]
    );
    // The figure is in docs/hardware.md; that no stop waits for the move is seen by where it ends.
}

#[test]
fn only_one_client_at_a_time_and_the_next_after_it() {
    let address = served(None);
    let first = Driver::connect(&address, None).unwrap();
    let second = Driver::connect(&address, None).err().unwrap();
    assert!(matches!(second, DriverError::Taken { .. }), "{second}");
    drop(first);
    // The next one waits for the one before to leave.
    Driver::connect(&address, None).unwrap();
}

#[test]
fn without_the_secret_nothing_is_done() {
    let secret = |text: &str| Secret::new(text.as_bytes()).unwrap();
    let address = served(Some(secret("correct horse battery")));
    let without = Driver::connect(&address, None).err().unwrap();
    assert!(
        matches!(without, DriverError::NeedsSecret { .. }),
        "{without}"
    );
    let connect = |text: &str| Driver::connect(&address, Some(&secret(text)));
    let wrong = connect("wrong horse battery 2").err().unwrap();
    assert!(wrong.to_string().contains("not the secret"), "{wrong}");
    let driver = connect("correct horse battery").unwrap();
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let stage = driver.devices(&clock).unwrap().stage.unwrap();
    assert!(stage.position().is_ok());
}

#[test]
fn a_port_for_everybody_needs_a_secret() {
    let listener = TcpListener::bind("0.0.0.0:0").unwrap();
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let offer = Offer {
        name: "nothing".into(),
        devices: Devices::none(clock),
    };
    let refused = listen(&listener, &offer, None, &|_| {}).unwrap_err();
    assert_eq!(refused.kind(), std::io::ErrorKind::PermissionDenied);
    assert!(refused.to_string().contains("secret"), "{refused}");
}

#[test]
fn a_client_that_goes_away_leaves_nothing_moving() {
    let address = served(None);
    let scope = instrument(&address);
    let to = StagePose::default().with_si(Axis::X, 15e-3);
    scope.gate().start_move(&to).unwrap();
    std::thread::sleep(Duration::from_millis(50));
    drop(scope);
    std::thread::sleep(Duration::from_millis(200));
    let scope = instrument(&address);
    assert_eq!(scope.gate().poll(), Ok(Motion::Stopped));
    assert!(scope.gate().position().unwrap().si(Axis::X).unwrap() < 10e-3);
}
