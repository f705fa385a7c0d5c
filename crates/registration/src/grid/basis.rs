//! The two periods of a square grid, from how the image repeats itself.

use super::types::NoGrid;
use crate::period::SelfLikeness;
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Mat2, Vec2};

/// One period may be so many times the other, and the angle between them so far from a right one: pixels need be neither square nor upright.
const ANISOTROPY: f64 = 1.12;
const SKEW_RAD: f64 = 0.1;

/// The shortest two periods as columns, px: the first the one nearest to image x, the second that nearest to image y.
pub(super) fn basis_of(image: &GrayImage) -> Result<Mat2, NoGrid> {
    let likeness = SelfLikeness::of(image).ok_or(NoGrid::NothingRepeats)?;
    match likeness.shortest_periods()[..] {
        [a, b] => square(a, b),
        [_] => Err(NoGrid::OneDirection),
        _ => Err(NoGrid::NothingRepeats),
    }
}

fn dot(a: Vec2, b: Vec2) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Two periods as a right-handed basis; refused when they are not those of squares.
fn square(a: Vec2, b: Vec2) -> Result<Mat2, NoGrid> {
    let [long, short] = match dot(a, a) > dot(b, b) {
        true => [dot(a, a).sqrt(), dot(b, b).sqrt()],
        false => [dot(b, b).sqrt(), dot(a, a).sqrt()],
    };
    let cosine = dot(a, b) / (long * short);
    if long > ANISOTROPY * short || cosine.abs() > SKEW_RAD.sin() {
        return Err(NoGrid::NotSquare {
            ratio: long / short,
            angle_deg: cosine.abs().acos().to_degrees(),
        });
    }
    let [mut x, mut y] = match a[0].abs() >= b[0].abs() {
        true => [a, b],
        false => [b, a],
    };
    if x[0] < 0.0 {
        x = x.map(|v| -v);
    }
    if y[1] < 0.0 {
        y = y.map(|v| -v);
    }
    Ok(Mat2([[x[0], y[0]], [x[1], y[1]]]))
}
