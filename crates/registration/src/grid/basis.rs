//! The two periods of a square grid, from how the image repeats itself.

use super::types::NoGrid;
use crate::period::{Peak, SelfLikeness};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Mat2, Vec2};

/// One period may be so many times the other, and the angle between them so far from a right one: pixels need be neither square nor upright.
const ANISOTROPY: f64 = 1.12;
const SKEW_RAD: f64 = 0.1;
/// A whole period makes the image as alike as any other does, to this share. Half of one does not, and neither does a way along the lines of
/// a grid of lines, where half of them stay.
const AS_ALIKE: f64 = 0.75;
/// On the way to a period the image is less alike, by this share of it. Along the lines of a grating it is not.
const DIP: f64 = 0.15;
/// Two directions are two when the sine between them is this.
const ACROSS: f64 = 0.35;

/// The shortest two periods as columns, px: the first the one nearest to image x, the second that nearest to image y.
pub(super) fn basis_of(image: &GrayImage) -> Result<Mat2, NoGrid> {
    let likeness = SelfLikeness::of(image).ok_or(NoGrid::NothingRepeats)?;
    let peaks = likeness.peaks();
    let highest = peaks.iter().map(|p| p.height).fold(0.0, f64::max);
    let whole = peaks.iter().filter(|p| p.height >= AS_ALIKE * highest);
    let mut periods = whole.filter(|p| dips(&likeness, p));
    let first = periods.next().ok_or(match peaks.is_empty() {
        true => NoGrid::NothingRepeats,
        false => NoGrid::OneDirection,
    })?;
    let across = |p: &&Peak| {
        let [[ax, ay], [bx, by]] = [first.shift, p.shift];
        let length = |x: i64, y: i64| f64::hypot(x as f64, y as f64);
        (ax * by - ay * bx).abs() as f64 > ACROSS * length(ax, ay) * length(bx, by)
    };
    let second = periods.find(across).ok_or(NoGrid::OneDirection)?;
    let second = nearest(&likeness, first, second);
    // Beyond the next line of a grating the image is as alike as along this one.
    if !dips(&likeness, &second) {
        return Err(NoGrid::OneDirection);
    }
    let every = likeness.every as f64;
    let [a, b] = [first.shift, second.shift].map(|s| top(&likeness, s).map(|v| v * every));
    square(a, b)
}

fn dot(a: Vec2, b: Vec2) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// The second period without whole first ones.
fn nearest(likeness: &SelfLikeness, first: &Peak, second: &Peak) -> Peak {
    let [a, b] = [first.shift, second.shift];
    let times = (a[0] * b[0] + a[1] * b[1]) as f64 / (a[0] * a[0] + a[1] * a[1]) as f64;
    let shift = [0, 1].map(|k| b[k] - times.round() as i64 * a[k]);
    let height = likeness.at(shift[0], shift[1]);
    Peak { shift, height }
}

/// Whether the image is less alike on the way to a peak.
fn dips(likeness: &SelfLikeness, peak: &Peak) -> bool {
    let [x, y] = peak.shift.map(|v| v as f64);
    let on_the_way = (1..16).map(|k| {
        let share = f64::from(k) / 16.0;
        likeness.at((share * x).round() as i64, (share * y).round() as i64)
    });
    on_the_way.fold(f64::INFINITY, f64::min) < (1.0 - DIP) * peak.height
}

/// The top of a peak between samples, by a parabola along each axis.
fn top(likeness: &SelfLikeness, [x, y]: [i64; 2]) -> Vec2 {
    let between = |before: f64, here: f64, after: f64| {
        let bend = before - 2.0 * here + after;
        match bend < 0.0 && bend.is_finite() {
            true => (0.5 * (before - after) / bend).clamp(-0.5, 0.5),
            false => 0.0,
        }
    };
    let here = likeness.at(x, y);
    [
        x as f64 + between(likeness.at(x - 1, y), here, likeness.at(x + 1, y)),
        y as f64 + between(likeness.at(x, y - 1), here, likeness.at(x, y + 1)),
    ]
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
