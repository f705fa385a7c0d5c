//! Two images and nothing else: no stage that could move, so what is fixed to the camera and what repeats itself must be told from the
//! images alone.

use crate::corners::centre;
use crate::likeness::Pair;
use crate::{
    Estimate, NotFound, Options, Prior, Registration, Rival, find_rivals, periods, register,
    undecided,
};
use scopeservo_features::{FeatureEngine, FeatureError, Features, GrayImage};
use scopeservo_geometry::{Affine2, Mat2};

/// What the asker vouches for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Allow {
    /// Both show the same place: what stays where it is on the sensor may be the specimen.
    pub same_place: bool,
    /// The view may be a mirror image.
    pub mirror: bool,
}

/// What two images say.
#[derive(Debug, Clone, PartialEq)]
pub enum PictureVerdict {
    /// One transform, and no other says as much. `mirrored`: it is a mirror image, as was allowed.
    Found {
        /// The transform.
        estimate: Estimate,
        /// Whether the view is a mirror image.
        mirrored: bool,
    },
    /// Both images agree where they are, and most of them does not, or each shows what the other lacks: that is what dust on the sensor, a
    /// reticle or burnt-in text do.
    Suspect {
        /// The transform, near the identity.
        estimate: Estimate,
        /// Share of the image that agrees.
        share: f64,
        /// Share of what either image shows that the other lacks.
        contradicted: f64,
    },
    /// Two transforms say as much.
    Ambiguous {
        /// The one.
        estimate: Estimate,
        /// The other.
        rival: Rival,
    },
    /// It is there as a mirror image, which nobody allowed.
    Mirrored {
        /// Target from view, a reflection.
        estimate: Estimate,
    },
    /// Nothing was found.
    NotFound(NotFound),
}

/// How near to the identity a transform leaves everything where it is on the sensor, px and degrees.
const STAYS_PX: f64 = 0.5;
const STAYS_DEG: f64 = 0.02;
const STAYS_SCALE: f64 = 0.002;
/// Most of the places, that is more than this share.
const MOST_PLACES: f64 = 0.6;
/// Of two images of one place at least so much is alike; dust, text and a reticle together were seen to cover half.
const MOST: f64 = 0.75;
/// and no more than this of what either shows is missing in the other: 0 to 0.2 % of nearly all of 285 such pairs, and 10 % of two nearly
/// empty places behind soft dust that covers most of the image.
const CONTRADICTED: f64 = 0.02;
/// Fewer inliers than this, or a smaller share of the matches, and the pixels must agree, too: single alike cells or dies of a lattice may
/// agree by place
const FEW: usize = 20;
const FEW_OF_MATCHES: f64 = 0.1;
/// in more than this share of what has the most structure.
const FEW_EXPLAIN: f64 = 0.5;

/// Registers two images with the features of an engine, and judges. `target` is described once and may be asked about many views; of a
/// mirror image at most `most` features are made.
///
/// # Errors
/// Those of the engine.
pub fn register_pictures(
    (engine, most): (&dyn FeatureEngine, usize),
    (view, view_features): (&GrayImage, &Features),
    (target, target_features): (&GrayImage, &Features),
    prior: &Prior,
    options: &Options,
    allow: Allow,
) -> Result<(Registration, PictureVerdict), FeatureError> {
    let answer = register(engine, view_features, target_features, prior, options);
    let verdict = match answer.outcome.clone() {
        Ok(estimate) => judge(
            (view, view_features),
            (target, target_features),
            (&answer, estimate),
            prior,
            options,
            allow,
        ),
        Err(reason) => PictureVerdict::NotFound(reason),
    };
    if !matches!(
        verdict,
        PictureVerdict::NotFound(_) | PictureVerdict::Suspect { .. }
    ) {
        return Ok((answer, verdict));
    }
    let mirror = flipped(view)?;
    let features = engine.features(&mirror, most)?;
    let found = register(engine, &features, target_features, prior, options);
    let Ok(estimate) = found.outcome.clone() else {
        return Ok((answer, verdict));
    };
    let mirrored = judge(
        (&mirror, &features),
        (target, target_features),
        (&found, estimate),
        prior,
        options,
        allow,
    );
    Ok(match mirrored.mirrored(view.width()) {
        PictureVerdict::Found { estimate, .. } if !allow.mirror => {
            (found, PictureVerdict::Mirrored { estimate })
        }
        _ if !allow.mirror => (answer, verdict),
        // A mirror image that is not there says nothing of what else was seen.
        PictureVerdict::NotFound(_) => (answer, verdict),
        told => (found, told),
    })
}

fn judge(
    (view, view_features): (&GrayImage, &Features),
    (target, target_features): (&GrayImage, &Features),
    (answer, estimate): (&Registration, Estimate),
    prior: &Prior,
    options: &Options,
    allow: Allow,
) -> PictureVerdict {
    let transform = estimate.target_from_view;
    let sensor = sensor(view, target);
    let stays = stays(&estimate, &sensor, view) || places_stay(answer, &sensor);
    let stays = stays && !allow.same_place;
    // Not one bit changed, noise included: that is one image.
    let equal = view == target;
    let pair = Pair::new(view, target, transform.linear.det().abs().sqrt());
    let few =
        answer.inliers < FEW || (answer.inliers as f64) < FEW_OF_MATCHES * answer.matches as f64;
    if few && pair.share_explained(&transform) < FEW_EXPLAIN {
        return PictureVerdict::NotFound(NotFound::ByChance {
            inliers: answer.inliers,
            matches: answer.matches,
            log10_nfa: answer.log10_nfa,
        });
    }
    if stays && !equal {
        let share = pair.share_alike(&transform);
        let contradicted = contradicted(&pair, (view, target), &transform);
        if share < MOST || contradicted > CONTRADICTED {
            return PictureVerdict::Suspect {
                estimate,
                share,
                contradicted,
            };
        }
    }
    let rivals = find_rivals(
        view_features,
        target_features,
        answer,
        prior,
        options,
        false,
    );
    // What decides for an image that stays may itself be fixed to the camera.
    let trusted = !stays || equal;
    let periods_px = periods(target);
    let of_target = (target, &*periods_px);
    if let Some(rival) = undecided(&pair, &estimate, of_target, &rivals, trusted, |_| true) {
        return PictureVerdict::Ambiguous { estimate, rival };
    }
    PictureVerdict::Found {
        estimate,
        mirrored: false,
    }
}

/// The share of what either image shows that is not in the other, the greater of both.
fn contradicted(
    pair: &Pair,
    (view, target): (&GrayImage, &GrayImage),
    target_from_view: &Affine2,
) -> f64 {
    let there = pair.share_contradicted(target_from_view);
    let Some(view_from_target) = target_from_view.inverse() else {
        return there;
    };
    let back = Pair::new(target, view, view_from_target.linear.det().abs().sqrt());
    there.max(back.share_contradicted(&view_from_target))
}

/// Target from view for what is fixed to the sensor, whatever size its images have.
fn sensor(view: &GrayImage, target: &GrayImage) -> Affine2 {
    let [x, y] = [
        target.width() as f64 / view.width() as f64,
        target.height() as f64 / view.height() as f64,
    ];
    // Both images begin at the same edge, half a pixel before the first pixel's centre.
    Affine2 {
        linear: Mat2::diagonal(x, y),
        offset: [0.5 * (x - 1.0), 0.5 * (y - 1.0)],
    }
}

/// Target pixels of a pixel of the sensor, one at least.
fn pixel_of(sensor: &Affine2) -> f64 {
    sensor.linear.0[0][0].max(1.0)
}

/// Whether everything is where it was on the sensor. As far as it is known: three sigmas more are allowed.
fn stays(estimate: &Estimate, sensor: &Affine2, view: &GrayImage) -> bool {
    let transform = &estimate.target_from_view;
    let c = centre([view.width(), view.height()]);
    let (p, q) = (sensor.apply(c), transform.apply(c));
    let turn = transform.linear.rotation_angle().unwrap_or(f64::NAN);
    let scale = (transform.linear.det() / sensor.linear.det()).abs().sqrt();
    f64::hypot(q[0] - p[0], q[1] - p[1]) <= STAYS_PX * pixel_of(sensor) + 3.0 * estimate.sigma_px
        && turn.abs() <= STAYS_DEG.to_radians() + 3.0 * estimate.sigma_angle_rad
        && (scale - 1.0).abs() <= STAYS_SCALE + 3.0 * estimate.sigma_angle_rad
}

/// Whether most of the inliers are where they were on the sensor. A line of text, or the arms of a reticle, leaves open what a
/// transform does beside it. Of few places the same column or row is enough: a sensor's pattern has columns.
fn places_stay(answer: &Registration, sensor: &Affine2) -> bool {
    let near = STAYS_PX * pixel_of(sensor);
    let ways = answer.pairs.iter().map(|pair| {
        let [x, y, u, v] = pair.map(f64::from);
        let p = sensor.apply([x, y]);
        [u - p[0], v - p[1]].map(f64::abs)
    });
    let ways: Vec<[f64; 2]> = ways.collect();
    let most = |stays: &dyn Fn(&[f64; 2]) -> bool| {
        let count = ways.iter().filter(|way| stays(way)).count();
        count as f64 > MOST_PLACES * ways.len() as f64
    };
    let few = ways.len() < FEW;
    most(&|way| f64::hypot(way[0], way[1]) <= near)
        || few && (most(&|way| way[0] <= near) || most(&|way| way[1] <= near))
}

/// An image turned over from left to right: its columns in the other order.
///
/// # Errors
/// [`FeatureError`] when there is no memory for it.
pub fn flipped(image: &GrayImage) -> Result<GrayImage, FeatureError> {
    let rows = image.data().chunks_exact(image.width());
    let data = rows.flat_map(|row| row.iter().rev().copied()).collect();
    Ok(GrayImage::new(image.width(), image.height(), data)?)
}

/// Target from the image as it came, from target from its mirror image.
fn unflip(target_from_mirror: &Affine2, width: usize) -> Affine2 {
    target_from_mirror.after(&Affine2 {
        linear: Mat2::diagonal(-1.0, 1.0),
        offset: [width as f64 - 1.0, 0.0],
    })
}

fn unflipped(estimate: &Estimate, width: usize) -> Estimate {
    Estimate {
        target_from_view: unflip(&estimate.target_from_view, width),
        ..estimate.clone()
    }
}

impl PictureVerdict {
    /// The verdict about a mirror image, told of the image as it came.
    fn mirrored(self, width: usize) -> Self {
        match self {
            Self::Found { estimate, .. } => Self::Found {
                estimate: unflipped(&estimate, width),
                mirrored: true,
            },
            Self::Suspect {
                estimate,
                share,
                contradicted,
            } => Self::Suspect {
                estimate: unflipped(&estimate, width),
                share,
                contradicted,
            },
            Self::Ambiguous { estimate, rival } => Self::Ambiguous {
                estimate: unflipped(&estimate, width),
                rival: Rival {
                    target_from_view: unflip(&rival.target_from_view, width),
                    ..rival
                },
            },
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(pairs: &[[f32; 4]]) -> Registration {
        Registration {
            inliers: pairs.len(),
            pairs: pairs.to_vec(),
            ..Registration::not_found(NotFound::NoAgreement { matches: 0 }, pairs.len())
        }
    }

    fn stay(pairs: &[[f32; 4]]) -> bool {
        places_stay(&answer(pairs), &Affine2::IDENTITY)
    }

    /// Places that agreed in frames that share nothing but their camera, each with a transform that does not stay: a reticle's arms, a line
    /// of text with one place elsewhere, and columns of a sensor.
    #[test]
    fn a_reticle_a_line_of_text_and_columns_stay_whatever_the_transform_does_beside_them() {
        let reticle = [
            [335.57, 254.18, 335.58, 254.17],
            [306.56, 254.15, 306.57, 254.16],
            [393.58, 254.17, 393.58, 254.15],
            [349.04, 267.58, 349.10, 267.52],
            [324.73, 181.44, 324.48, 181.61],
            [324.51, 297.70, 324.68, 297.66],
        ];
        let text = [
            [56.14, 423.00, 56.14, 423.00],
            [121.80, 423.43, 121.80, 423.43],
            [160.88, 422.88, 160.88, 422.87],
            [172.95, 422.91, 172.95, 422.92],
            [132.61, 422.99, 132.73, 423.04],
            [509.96, 166.64, 510.92, 158.12],
        ];
        let columns = [
            [560.28, 398.72, 560.25, 385.64],
            [560.80, 77.78, 561.07, 78.81],
            [407.21, 231.55, 407.18, 230.44],
            [606.43, 87.39, 605.84, 84.78],
            [299.65, 207.79, 300.08, 208.19],
            [199.06, 350.67, 199.48, 347.36],
            [498.81, 143.35, 498.92, 143.16],
        ];
        for fixed in [&reticle[..], &text, &columns] {
            assert!(stay(fixed));
            let rows: Vec<[f32; 4]> = fixed.iter().map(|&[x, y, u, v]| [y, x, v, u]).collect();
            assert!(stay(&rows));
        }
    }

    #[test]
    fn what_moves_does_not_stay_and_many_places_may_move_along_a_row() {
        let moved = |count: usize, by: [f32; 2]| -> Vec<[f32; 4]> {
            let place = |i: usize| [(37 * i % 600) as f32, (61 * i % 440) as f32];
            let of = |[x, y]: [f32; 2]| [x, y, x + by[0], y + by[1]];
            (0..count).map(|i| of(place(i))).collect()
        };
        assert!(!stay(&moved(8, [3.0, -2.0])));
        assert!(!stay(&moved(FEW, [40.0, 0.0])));
        assert!(stay(&moved(8, [40.0, 0.0])) && stay(&moved(FEW, [0.1, 0.2])));
        assert!(!stay(&[]));
    }
}
