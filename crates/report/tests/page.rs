//! Pages of made-up runs: well-formed, complete, self-contained, and honest about what is missing.

mod synthetic;

use scopeservo_report::{Context, Recorder, Truth, html};
use std::sync::OnceLock;

/// Made once: images of tissue cost more than everything else here.
fn arrived() -> &'static synthetic::Teller {
    static RUN: OnceLock<synthetic::Teller> = OnceLock::new();
    RUN.get_or_init(synthetic::arrived)
}

fn page() -> String {
    let run = arrived();
    html(&run.recorder, Some(&run.truth), &synthetic::context())
}

/// What holds for every page.
fn check(page: &str) {
    balanced(page);
    assert!(page.len() < 6_000_000, "{} bytes", page.len());
    let mut visible = without_data(page);
    for wrong in ["NaN", "inf\"", "inf ", " inf", "-0\"", "undefined"] {
        assert!(!visible.contains(wrong), "{wrong:?} is in the page");
    }
    for outside in ["http:", "https:", "src=", "url(", "@import", "<link"] {
        assert!(!visible.contains(outside), "{outside:?} is in the page");
    }
    // Every image that is drawn is there, once.
    while let Some(at) = visible.find("<use href=\"#") {
        let name: String = visible[at + 12..]
            .chars()
            .take_while(|c| *c != '"')
            .collect();
        assert_eq!(
            page.matches(&format!("<image id=\"{name}\"")).count(),
            1,
            "{name}"
        );
        visible.replace_range(at..at + 12, "");
    }
}

/// The page without its images' bytes.
fn without_data(page: &str) -> String {
    let mut parts = page.split(";base64,");
    let mut out = parts.next().unwrap_or("").to_string();
    for part in parts {
        out.push_str(&part[part.find('"').unwrap_or(0)..]);
    }
    out
}

/// Every element is closed in order, every attribute quoted, every ampersand an entity.
fn balanced(page: &str) {
    let body = page.strip_prefix("<!DOCTYPE html>").expect("a doctype");
    let mut open = Vec::new();
    let mut rest = body;
    while let Some(start) = rest.find('<') {
        let text = &rest[..start];
        for entity in text.split('&').skip(1) {
            let end = entity.find(';').expect("an entity ends");
            assert!(
                ["amp", "lt", "gt", "quot", "#39"].contains(&&entity[..end]),
                "{entity:.20}"
            );
        }
        let tag_end = start + rest[start..].find('>').expect("a tag ends");
        let tag = &rest[start + 1..tag_end];
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes in <{tag:.80}>");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(
                open.pop().as_deref(),
                Some(name),
                "an element is closed out of order"
            );
        } else if !tag.ends_with('/') {
            let name = tag
                .split_whitespace()
                .next()
                .expect("an element has a name");
            open.push(name.to_string());
        }
        rest = &rest[tag_end + 1..];
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

#[test]
fn an_arrival_shows_everything() {
    let page = page();
    check(&page);
    let shown = without_data(&page);
    assert!(shown.contains("<h1>Arrived</h1>"));
    for objective in ["100x", "200x", "400x"] {
        assert!(shown.contains(&format!("<h3>{objective}</h3>")));
        for figure in [
            format!("aria-label=\"View at {objective}, iteration 0\""),
            format!("aria-label=\"Error in x, y and theta against iteration at {objective}\""),
            format!("aria-label=\"Velocity in x, y and theta against iteration at {objective}\""),
            format!(
                "aria-label=\"Size of the error against iteration at {objective}, logarithmic\""
            ),
            format!("aria-label=\"Path of the view&#39;s centre over the specimen at {objective}"),
            format!("<b>{objective} to 400x.</b>"),
            format!("aria-label=\"Sharpness against focus position at {objective}\""),
            format!("Displacements of the image in the calibration views of {objective}"),
        ] {
            assert!(shown.contains(&figure), "{figure}");
        }
    }
    assert!(!shown.contains("class=\"none\""), "nothing is missing");
    // Four legs: the target's objective first, for its calibration, then the three.
    assert_eq!(shown.matches("class=\"leg\"").count(), 4);
    assert_eq!(shown.matches("class=\"card\"").count(), 4);
    assert!(shown.contains("off in truth") && shown.contains(" σ</td>"));
}

#[test]
fn without_truth_nothing_is_called_true() {
    let page = html(&arrived().recorder, None, &synthetic::context());
    check(&page);
    let shown = without_data(&page);
    let body = shown.split("</style>").nth(1).unwrap();
    for word in ["in truth", "in truth", "simulation knows"] {
        assert!(!body.contains(word), "{word}");
    }
    assert!(
        body.contains("the program&#39;s own measurement")
            || body.contains("program's own measurement")
    );
}

#[test]
fn a_target_that_is_not_found_is_said_and_shown() {
    let run = synthetic::not_found();
    let page = html(&run.recorder, None, &synthetic::context());
    check(&page);
    let shown = without_data(&page);
    assert!(shown.contains("<h1>Not found</h1>"));
    assert!(shown.contains("6 inliers among 41 matches could be chance"));
    assert!(shown.contains("The last view, 100x at iteration 2"));
    assert!(shown.contains("there is no error to plot"));
    assert!(shown.contains("no matching places to show"));
    assert!(!shown.contains("off, as measured"));
}

#[test]
fn without_focus_only_the_sweep_is_shown() {
    let run = synthetic::no_focus();
    let page = html(&run.recorder, None, &synthetic::context());
    check(&page);
    let shown = without_data(&page);
    assert!(shown.contains("<h1>Refused</h1>"));
    assert!(shown.contains("no peak in 17 frames"));
    assert!(shown.contains("The sharpest image of the last focus sweep."));
    for sentence in [
        "The run ended before the stage was servoed",
        "The run did not come to a calibration.",
    ] {
        assert!(shown.contains(sentence), "{sentence}");
    }
}

#[test]
fn an_empty_record_is_a_page_too() {
    let page = html(
        &Recorder::new(),
        Some(&Truth::default()),
        &Context::default(),
    );
    check(&page);
    assert!(page.contains("<h1>Unfinished</h1>"));
    assert!(page.contains("No image of this run was kept."));
}

#[test]
fn a_dim_image_is_shown_brighter_and_its_caption_says_so() {
    use scopeservo_scope::{Channels, Frame, Samples, Timestamp};
    use scopeservo_servo::{FrameRole, Sink as _};
    let page = |most: u16, hot: u16| {
        let mut samples: Vec<u16> = (0..4800_u32)
            .map(|i| (i % 80 * u32::from(most) / 79) as u16)
            .collect();
        samples[7] = hot;
        let frame = Frame {
            width: 80,
            height: 60,
            channels: Channels::Gray,
            bit_depth: 16,
            samples: Samples::U16(samples),
            sequence: 1,
            exposure_start: Timestamp::default(),
            exposure: std::time::Duration::ZERO,
        };
        let mut recorder = Recorder::new();
        recorder.frame(&frame, FrameRole::Target);
        html(&recorder, None, &Context::default())
    };
    // 0.8 of 65535 over what it has, whatever one pixel says.
    for (most, times) in [(4095, "12.8"), (1023, "51.2"), (300, "174.8")] {
        for hot in [0, 65535] {
            let said = page(most, hot);
            check(&said);
            let caption = format!("Dim: shown {times} times as bright as taken.");
            assert!(said.contains(&caption), "{most} {hot}");
        }
    }
    assert!(!page(40_000, 0).contains("Dim:"));
}

#[test]
fn every_beginning_of_a_run_is_a_page() {
    use scopeservo_servo::Sink as _;
    let events = arrived().recorder.events();
    for n in (0..events.len()).step_by(23) {
        let mut recorder = Recorder::new();
        events[..n].iter().for_each(|e| recorder.event(e.clone()));
        check(&html(
            &recorder,
            Some(&arrived().truth),
            &synthetic::context(),
        ));
        let mut recorder = Recorder::new();
        events[n..].iter().for_each(|e| recorder.event(e.clone()));
        check(&html(&recorder, None, &synthetic::context()));
    }
}

#[test]
fn text_from_outside_stays_text() {
    let evil = "<script>alert(\"1\")</script> & 'more'";
    let context = Context {
        title: evil.into(),
        specimen: evil.into(),
        instrument: evil.into(),
        command: evil.into(),
        version: evil.into(),
        credit: Some(evil.into()),
        ..Context::default()
    };
    let page = html(&arrived().recorder, None, &context);
    check(&page);
    // The page's own, which closes its parts on a phone.
    assert_eq!(page.matches("<script").count(), 1);
    assert!(!page.contains("<script>alert"));
    assert!(
        page.contains("&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; &#39;more&#39;")
    );
}

#[test]
fn values_that_are_no_numbers_do_not_reach_the_page() {
    use scopeservo_servo::{Event, Sink as _};
    let mut recorder = Recorder::new();
    for stamped in arrived().recorder.events() {
        let mut stamped = stamped.clone();
        match &mut stamped.event {
            Event::Iteration {
                error,
                sigma_px,
                iteration,
                ..
            } if *iteration % 2 == 0 => {
                error.t_m[0] = f64::NAN;
                *sigma_px = f64::INFINITY;
            }
            Event::FocusSample { sharpness, .. } => *sharpness = f64::NAN,
            Event::Calibrated { residual_px, .. } => *residual_px = f64::INFINITY,
            _ => {}
        }
        recorder.event(stamped);
    }
    let truth = Truth {
        error_um: f64::NAN,
        ..arrived().truth.clone()
    };
    check(&html(&recorder, Some(&truth), &synthetic::context()));
}

#[test]
fn blocks_of_pixels_are_drawn_on_the_view_that_they_testify_of() {
    use scopeservo_servo::{Event, Sink as _};
    let block = |x: f64, agrees: bool| serde_json::json!({"in_view": [x, 100.0], "agrees": agrees, "correlation": 0.9});
    let seen = serde_json::json!({"evidence": {
        "judgement": "agrees", "asked": 2, "agree": 1, "held_out": true, "log10_chance": -8.0, "share": 0.75, "side_px": 24.0,
        "blocks": [block(100.0, true), block(200.0, false)],
    }});
    let mut recorder = arrived().recorder.clone();
    let mut events: Vec<_> = recorder.events().to_vec();
    let last = events
        .iter()
        .rposition(|e| matches!(e.event, Event::Iteration { .. }));
    let mut last = events.swap_remove(last.unwrap());
    if let Event::Iteration { pixels, by, .. } = &mut last.event {
        *pixels = Some(serde_json::from_value(seen).unwrap());
        *by = scopeservo_servo::LocatedBy::Correlation;
    }
    let by_features = html(&recorder, None, &synthetic::context());
    recorder.event(last);
    let page = html(&recorder, None, &synthetic::context());
    check(&page);
    let words = "by correlation, as features said nothing";
    assert!(page.contains(words) && !by_features.contains(words));
    assert_eq!(page.matches("class=\"block yes\"").count(), 1);
    assert_eq!(
        page.matches("class=\"block no\" x=\"188\" y=\"88\" width=\"24\"")
            .count(),
        1
    );
    assert!(page.contains("1 of 2 blocks of pixels lie where they should"));
}

#[test]
fn a_move_is_drawn_where_it_ended_from_where_it_was_to_end() {
    use scopeservo_servo::{Event, PoseError, Promised, Sink as _};
    let with = |beside_um: f64| {
        let mut recorder = arrived().recorder.clone();
        let is = |e: &scopeservo_servo::Stamped| matches!(e.event, Event::Iteration { .. });
        let mut last = recorder.events().iter().rfind(|e| is(e)).unwrap().clone();
        if let Event::Iteration {
            error, promised, ..
        } = &mut last.event
        {
            let [x, y] = error.t_m;
            *promised = Some(Box::new(Promised {
                error: PoseError {
                    t_m: [x - 1e-6 * beside_um, y],
                    theta_rad: error.theta_rad,
                },
                sigma_m: 1.5e-6,
                sigma_rad: 1e-5,
            }));
        }
        recorder.event(last);
        let page = html(&recorder, None, &synthetic::context());
        check(&page);
        page
    };
    let kept = with(3.0);
    assert!(kept.contains("1 of 1 moves ended within 4 standard deviations"));
    assert!(kept.contains("ended 3.00 µm and"), "told in words");
    let broken = with(30.0);
    assert!(broken.contains("0 of 1 moves ended within 4 standard deviations"));
    assert!(!page().contains("moves ended within"), "nothing was told");
}

/// A run whose calibrations were known shows what one shows that made them.
#[test]
fn stored_calibrations_show_what_fresh_ones_do() {
    use scopeservo_report::{Context, Stored};
    use scopeservo_servo::{Event, Sink as _};
    let mut recorder = Recorder::new();
    let mut stored = Vec::new();
    for stamped in arrived().recorder.events() {
        match &stamped.event {
            Event::Calibrated { calibration, .. } => stored.push(Stored {
                calibration: (**calibration).clone(),
                file: format!("calibrations/{}/000001.json", calibration.objective),
                made: "2026-11-20 08:15 UTC".into(),
            }),
            Event::CalibrationView { .. } => {}
            _ => recorder.event(stamped.clone()),
        }
    }
    let context = Context {
        stored,
        ..synthetic::context()
    };
    let page = html(&recorder, None, &context);
    check(&page);
    for objective in ["100x", "200x", "400x"] {
        let path =
            format!("aria-label=\"Path of the view&#39;s centre over the specimen at {objective}");
        assert!(page.contains(&path), "{objective}");
        assert!(page.contains(&format!("calibrations/{objective}/000001.json")));
    }
    assert!(page.contains("As it was known of 2026-11-20 08:15 UTC"));
    // Without any it says that there is none.
    let bare = html(&recorder, None, &synthetic::context());
    check(&bare);
    assert!(!bare.contains("As it was known"));
}

/// Whoever looks at a page knows when, what and where; and every picture has a scale.
#[test]
fn a_page_says_when_what_and_where_and_every_picture_has_its_scale() {
    let page = page();
    for fact in [
        "2026-11-27 09:30 UTC",
        "mitosis-3",
        "Stage at the end",
        "Objective at the end",
    ] {
        assert!(page.contains(fact), "{fact}");
    }
    for (k, heading) in ["The way there", "What was recognised", "Focus"]
        .iter()
        .enumerate()
    {
        assert!(page.contains(&format!("<a href=\"#h{k}\">{heading}</a>")));
    }
    let drawn = page.matches("<use href=\"#").count();
    let scales = page.matches("class=\"scale-bar\"").count();
    // The comparison shows two pictures one over the other.
    assert_eq!(drawn, scales, "pictures and scale bars");
    assert!(!page.contains(" um") && !page.contains("\u{2212}0.0000"));
}
