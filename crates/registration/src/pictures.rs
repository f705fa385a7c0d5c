//! Two pictures and nothing else: no stage that could move, so what is fixed to the camera and what repeats itself must be told from the
//! pictures alone.

use crate::correspondences::centre;
use crate::likeness::Pair;
use crate::{
    Estimate, NotFound, Options, Prior, Registration, Rival, find_rivals, periods, register,
    shifted, undecided,
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

/// What two pictures say.
#[derive(Debug, Clone, PartialEq)]
pub enum PictureVerdict {
    /// One transform, and no other says as much. `mirrored`: it is a mirror image, as was allowed.
    Found {
        /// The transform.
        estimate: Estimate,
        /// Whether the view is a mirror image.
        mirrored: bool,
    },
    /// Both pictures agree where they are, and most of them does not: that is what dust on the sensor, a reticle or burnt-in text do.
    Suspect {
        /// The transform, near the identity.
        estimate: Estimate,
        /// Share of the picture that agrees.
        share: f64,
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
/// Of two pictures of one place at least so much is alike; dust, text and a reticle together were seen to cover half.
const MOST: f64 = 0.75;
/// Fewer agreeing places than this, and the pixels must agree, too: single alike cells or dies of a lattice may agree by place
const FEW: usize = 20;
/// in more than this share of what has the most structure.
const FEW_EXPLAIN: f64 = 0.5;

/// Registers two pictures with the features of an engine, and judges. `target` is described once and may be asked about many views; of a
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
    let stays = stays(&estimate, view, target) && !allow.same_place;
    // Not one bit changed, noise included: that is one picture.
    let equal = view == target;
    let pair = Pair::new(view, target, transform.linear.det().abs().sqrt());
    if answer.inliers < FEW && pair.share_explained(&transform) < FEW_EXPLAIN {
        return PictureVerdict::NotFound(NotFound::ByChance {
            inliers: answer.inliers,
            matches: answer.matches,
            log10_nfa: answer.log10_nfa,
        });
    }
    if stays && !equal {
        let share = pair.share_alike(&transform);
        if share < MOST {
            return PictureVerdict::Suspect { estimate, share };
        }
    }
    let mut rivals = shifted(&estimate, &periods(target));
    rivals.extend(find_rivals(
        view_features,
        target_features,
        answer,
        prior,
        options,
        false,
    ));
    // What decides for a picture that stays may itself be fixed to the camera.
    let trusted = !stays || equal;
    if let Some(rival) = undecided(&pair, &transform, &rivals, trusted, |_| true) {
        return PictureVerdict::Ambiguous { estimate, rival };
    }
    PictureVerdict::Found {
        estimate,
        mirrored: false,
    }
}

/// Whether everything is where it was on the sensor, whatever size its pictures have. As far as it is known: three sigmas more are
/// allowed.
fn stays(estimate: &Estimate, view: &GrayImage, target: &GrayImage) -> bool {
    let transform = &estimate.target_from_view;
    let [x, y] = [
        target.width() as f64 / view.width() as f64,
        target.height() as f64 / view.height() as f64,
    ];
    // Both pictures begin at the same edge, half a pixel before the first pixel's centre.
    let sensor = Affine2 {
        linear: Mat2::diagonal(x, y),
        offset: [0.5 * (x - 1.0), 0.5 * (y - 1.0)],
    };
    let c = centre([view.width(), view.height()]);
    let (p, q) = (sensor.apply(c), transform.apply(c));
    let turn = transform.linear.rotation_angle().unwrap_or(f64::NAN);
    let scale = transform.linear.det().abs().sqrt() / (x * y).sqrt();
    f64::hypot(q[0] - p[0], q[1] - p[1]) <= STAYS_PX * x.max(1.0) + 3.0 * estimate.sigma_px
        && turn.abs() <= STAYS_DEG.to_radians() + 3.0 * estimate.sigma_angle_rad
        && (scale - 1.0).abs() <= STAYS_SCALE + 3.0 * estimate.sigma_angle_rad
}

/// Columns in the other order.
fn flipped(image: &GrayImage) -> Result<GrayImage, FeatureError> {
    let rows = image.data().chunks_exact(image.width());
    let data = rows.flat_map(|row| row.iter().rev().copied()).collect();
    Ok(GrayImage::new(image.width(), image.height(), data)?)
}

/// Target from the picture as it came, from target from its mirror image.
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
    /// The verdict about a mirror image, told of the picture as it came.
    fn mirrored(self, width: usize) -> Self {
        match self {
            Self::Found { estimate, .. } => Self::Found {
                estimate: unflipped(&estimate, width),
                mirrored: true,
            },
            Self::Suspect { estimate, share } => Self::Suspect {
                estimate: unflipped(&estimate, width),
                share,
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
