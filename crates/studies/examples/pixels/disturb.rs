//! What is done to the view of a pair.

use scopeservo_geometry::SplitMix64;
use scopeservo_sift::GrayImage;

/// In order of the tables.
pub(crate) const ALL: [&str; 13] = [
    "nothing",
    "noise 1 %",
    "noise 5 %",
    "covered 40 %",
    "blur 2 px",
    "blur 4 px",
    "blur 6 px",
    "gamma 0.5",
    "gamma 2",
    "light x0.1",
    "light x1.8",
    "darker by 80",
    "30 soft shadows",
];

/// The view as it is then; noise comes last, and eight bits.
pub(crate) fn disturbed(view: &GrayImage, what: &str, seed: u64) -> GrayImage {
    let mut rng = SplitMix64::new(seed);
    let (w, h) = (view.width(), view.height());
    let noise = match what {
        "noise 1 %" => 0.01,
        "noise 5 %" => 0.05,
        _ => 0.0,
    };
    let data: Vec<f64> = match what {
        "blur 2 px" => blurred(view, 2.0),
        "blur 4 px" => blurred(view, 4.0),
        "blur 6 px" => blurred(view, 6.0),
        _ => view.data().iter().map(|&v| f64::from(v)).collect(),
    };
    let side = (0.4 * (w * h) as f64).sqrt();
    let corner = [w, h].map(|n| (n as f64 - side) * rng.uniform());
    let shadows: Vec<[f64; 3]> = (0..30)
        .map(|_| {
            let at = [w, h].map(|n| n as f64 * rng.uniform());
            [at[0], at[1], 8.0 + 16.0 * rng.uniform()]
        })
        .collect();
    GrayImage::from_fn(w, h, |x, y| {
        let (v, [px, py]) = (data[y * w + x], [x, y].map(|v| v as f64));
        let covered =
            px >= corner[0] && px < corner[0] + side && py >= corner[1] && py < corner[1] + side;
        let shadow = |s: &[f64; 3]| {
            let d = ((px - s[0]).powi(2) + (py - s[1]).powi(2)) / (s[2] * s[2]);
            1.0 - 0.15 * (-0.5 * d).exp()
        };
        let v = match what {
            "covered 40 %" if covered => 0.3,
            "gamma 0.5" => v.max(0.0).sqrt(),
            "gamma 2" => v * v,
            "light x0.1" => 0.1 * v,
            "light x1.8" => 1.8 * v,
            "darker by 80" => v - 80.0 / 255.0,
            "30 soft shadows" => v * shadows.iter().map(shadow).product::<f64>(),
            _ => v,
        };
        let v = (v + noise * rng.normal()).clamp(0.0, 1.0);
        ((v * 255.0).round() / 255.0) as f32
    })
    .expect("a view is finite and not empty")
}

/// Three running means, one after the other: nearly a Gaussian, and nothing that the library has.
fn blurred(view: &GrayImage, sigma: f64) -> Vec<f64> {
    let (w, h) = (view.width(), view.height());
    let mut data: Vec<f64> = view.data().iter().map(|&v| f64::from(v)).collect();
    // Each of width 2 r + 1 has a variance of r (r + 1) / 3.
    let r = ((0.25 + sigma * sigma).sqrt() - 0.5).round().max(1.0) as i64;
    for _ in 0..3 {
        data = run(&data, w, h, r, true);
        data = run(&data, w, h, r, false);
    }
    data
}

fn run(data: &[f64], w: usize, h: usize, r: i64, along: bool) -> Vec<f64> {
    let at = |x: i64, y: i64| {
        let [x, y] = [(x, w), (y, h)].map(|(v, n)| v.clamp(0, n as i64 - 1) as usize);
        data[y * w + x]
    };
    (0..w * h)
        .map(|k| {
            let (x, y) = ((k % w) as i64, (k / w) as i64);
            let sum: f64 = (-r..=r)
                .map(|d| if along { at(x + d, y) } else { at(x, y + d) })
                .sum();
            sum / (2 * r + 1) as f64
        })
        .collect()
}
