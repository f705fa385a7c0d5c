//! The fit is that of `scipy.optimize.least_squares`, whose answers make_cases.py stored.

use scopeservo_servo::joint::{Pair, Priors, View, fit};
use serde::Deserialize;

#[derive(Deserialize)]
struct Case {
    priors: Priors,
    views: Vec<View>,
    pairs: Vec<Pair>,
    /// Backlash, map, centre.
    numbers: Vec<f64>,
    covariance: Vec<f64>,
    chi_sq: f64,
}

const CASES: [(&str, &str); 3] = [
    ("hexapod", include_str!("case_hexapod.json")),
    ("table", include_str!("case_table.json")),
    ("xy", include_str!("case_xy.json")),
];

#[test]
fn scipy_finds_the_same_answer_and_covariance() {
    for (name, text) in CASES {
        let case: Case = serde_json::from_str(text).unwrap();
        let priors = Priors {
            coupled: Some(false),
            sure: true,
            ..case.priors
        };
        let fit = fit(&priors, &case.views, &case.pairs).unwrap();
        let optics = &fit.instrument.optics[0];
        let map = optics.stage_from_pixel.0;
        let numbers = [
            &fit.instrument.backlash[..],
            &map[0],
            &map[1],
            &optics.centre_m,
        ]
        .concat();
        let sigma: Vec<f64> = (0..9).map(|k| case.covariance[k * 10].sqrt()).collect();
        for k in 0..9 {
            let off = (numbers[k] - case.numbers[k]).abs();
            assert!(off <= 1e-3 * sigma[k], "{name} {k}: {off} of {}", sigma[k]);
            for j in 0..9 {
                let off = (fit.covariance[k * 9 + j] - case.covariance[k * 9 + j]).abs();
                assert!(off <= 1e-3 * sigma[k] * sigma[j], "{name} {k} {j}: {off}");
            }
        }
        let off = (fit.chi_sq - case.chi_sq).abs();
        assert!(off < 1e-3, "{name}: chi-square off by {off}");
    }
}
