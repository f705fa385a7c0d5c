//! What a camera makes of a scene: spoilt, noisy and in 8 bits.

use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, SplitMix64};
use scopeservo_studies::warp::SIZE;

/// Blur to 6 pixels, 40 % of what the target shows hidden, dark, noisy; one after the other, and the last three together.
pub(crate) fn spoil(
    view: &GrayImage,
    target_from_view: &Affine2,
    which: u64,
    rng: &mut SplitMix64,
) -> Option<(&'static str, GrayImage)> {
    let names = ["blur", "hidden", "dark", "noise", "all"];
    let name = names[which as usize % names.len()];
    let has = |n: &str| name == n || name == "all";
    let mut image = view.clone();
    if has("blur") {
        let most = if name == "all" { 3.0 } else { 6.0 };
        image = blurred(&image, most * (0.5 + 0.5 * rng.uniform()))?;
    }
    // A band across the target's field that hides 40 % of it.
    let from = 0.6 * rng.uniform();
    let grey = rng.uniform();
    let gain = if has("dark") { 0.3 } else { 1.0 };
    let noise = if has("noise") { 15.0 / 255.0 } else { 0.004 };
    let data = image.data().to_vec();
    let hidden = |x: usize, y: usize| {
        let p = target_from_view.apply([x as f64, y as f64]);
        let share = p[0] / SIZE[0] as f64;
        has("hidden")
            && (from..from + 0.4).contains(&share)
            && (0.0..SIZE[1] as f64).contains(&p[1])
    };
    let view = frame(
        |x, y| match hidden(x, y) {
            true => gain * grey,
            false => gain * f64::from(data[y * SIZE[0] + x]),
        },
        noise,
        rng,
    )?;
    Some((name, view))
}

fn blurred(image: &GrayImage, sigma: f64) -> Option<GrayImage> {
    let reach = (3.0 * sigma).ceil() as i64;
    let taps: Vec<f32> = (-reach..=reach)
        .map(|d| (-0.5 * (d as f64 / sigma).powi(2)).exp() as f32)
        .collect();
    let sum: f32 = taps.iter().sum();
    let (w, h) = (image.width(), image.height());
    let pass = |from: &GrayImage, step: [i64; 2]| {
        GrayImage::from_fn(w, h, |x, y| {
            let at = |d: i64| {
                let x = (x as i64 + d * step[0]).clamp(0, w as i64 - 1);
                let y = (y as i64 + d * step[1]).clamp(0, h as i64 - 1);
                from.get(x as usize, y as usize)
            };
            let each = (-reach..=reach).zip(&taps);
            each.map(|(d, t)| t * at(d)).sum::<f32>() / sum
        })
    };
    pass(&pass(image, [1, 0]).ok()?, [0, 1]).ok()
}

/// What a camera of 8 bits makes of light 0 to 1.
pub(crate) fn frame(
    light: impl Fn(usize, usize) -> f64,
    noise: f64,
    rng: &mut SplitMix64,
) -> Option<GrayImage> {
    let [w, h] = SIZE;
    let image = GrayImage::from_fn(w, h, |x, y| {
        let noisy = (light(x, y) + noise * rng.normal()).clamp(0.0, 1.0);
        ((noisy * 255.0).round() / 255.0) as f32
    });
    image.ok()
}
