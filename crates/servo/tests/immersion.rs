//! Runs on a nosepiece that carries a dry objective and one that works in oil.

mod common;

use common::{Bench, PLACE_UM, bench, options};
use scopeservo_scope::{AskImmersion, Immersion, ImmersionChange, Instrument, ObjectiveId};
use scopeservo_servo::{
    Bring, FocusOptions, NoSink, Outcome, Reposition, Target, Verdict, VisionOptions, run,
};
use scopeservo_twin::{Config, Truth};
use std::sync::{Arc, Mutex};

type Heard = Arc<Mutex<Vec<ImmersionChange>>>;

/// A dry 10x and a 40x in oil; whoever is asked answers like this.
fn wet(yes: bool) -> (Bench, Heard) {
    let mut config = Config::realistic();
    config.optics.remove(1);
    config.optics[1].immersion = Immersion::Oil;
    let Bench {
        twin,
        scope,
        cancel,
    } = bench(config);
    let heard = Heard::default();
    let ears = heard.clone();
    let ask: AskImmersion = Arc::new(move |change, _| {
        let mut heard = ears.lock().unwrap();
        heard.push(change.clone());
        // The first brings the objective in for the target.
        yes || heard.len() == 1
    });
    let scope = scope.asking_before_immersion(ask);
    let bench = Bench {
        twin,
        scope,
        cancel,
    };
    (bench, heard)
}

/// A target of the objective in oil, which stays in; the slide is laid `off_um` beside it.
fn saved(bench: &Bench, off_um: f64) -> (Target, Truth) {
    let id = ObjectiveId("40x".into());
    let vision = VisionOptions::default();
    let mut bring = Bring::new(id, Some(FocusOptions::default()), vision.clone());
    run(&mut bring, &bench.scope, &mut NoSink).unwrap();
    let target = Target::save(&bench.scope, &vision, &mut NoSink).unwrap();
    let truth = bench.twin.truth_now();
    let beside = [PLACE_UM[0] + off_um, PLACE_UM[1]];
    bench.twin.centre_specimen(beside, 0.3);
    (target, truth)
}

fn reposition(scope: &Instrument, target: Target) -> Outcome {
    run(&mut Reposition::new(target, options()), scope, &mut NoSink).unwrap()
}

#[test]
fn what_is_in_the_field_is_brought_back_in_oil_and_nobody_is_asked() {
    let (bench, heard) = wet(true);
    let (target, truth) = saved(&bench, 40.0);
    let outcome = reposition(&bench.scope, target);
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert_eq!(outcome.magnifications.len(), 1);
    let (um, deg) = bench.error_from(&truth);
    assert!(um <= 1.0 && deg <= 0.05, "{um} um, {deg} deg");
    // Once, before the run.
    assert_eq!(heard.lock().unwrap().len(), 1);
}

#[test]
fn what_is_not_is_looked_for_with_the_whole_ladder_where_that_is_agreed_to() {
    let (bench, heard) = wet(true);
    let (target, truth) = saved(&bench, 350.0);
    let outcome = reposition(&bench.scope, target);
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    let used = outcome.magnifications.iter().map(|m| m.magnification);
    assert_eq!(used.collect::<Vec<_>>(), [400.0, 100.0, 400.0]);
    let (um, deg) = bench.error_from(&truth);
    assert!(um <= 1.0 && deg <= 0.05, "{um} um, {deg} deg");
    let heard = heard.lock().unwrap();
    let to: Vec<Immersion> = heard.iter().map(|change| change.to).collect();
    assert_eq!(to, [Immersion::Oil, Immersion::Air, Immersion::Oil]);
    // As far as the widest view goes.
    let [width, _] = outcome.unique_within_um.unwrap();
    assert!(width > 1000.0, "{width}");
}

#[test]
fn where_it_is_not_agreed_to_the_target_is_not_found_and_the_objective_stays() {
    let (bench, heard) = wet(false);
    let (target, _) = saved(&bench, 350.0);
    let outcome = reposition(&bench.scope, target);
    assert_eq!(outcome.verdict, Verdict::NotFound, "{}", outcome.message);
    assert!(
        outcome.message.contains("10x works in air"),
        "{}",
        outcome.message
    );
    assert_eq!(heard.lock().unwrap().len(), 2);
    let stays = bench.scope.gate().current_objective().unwrap();
    assert_eq!(stays, Some(ObjectiveId("40x".into())));
}
