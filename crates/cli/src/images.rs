//! Image files for `scopeservo register`: which image of each file is looked at, reduced while it is decoded.

use crate::args::RegisterArgs;
use crate::error::CliError;
use scopeservo_features::{FeatureError, GrayImage};
use scopeservo_geometry::{Affine2, Mat2};
use scopeservo_slide::{Choice, Slide, Wanted};
use std::path::Path;

/// Above this many pixels an image is reduced before looking.
const MAX_PIXELS: u64 = 4_000_000;
/// Smaller images cannot hold features.
const LEAST_SIDE: usize = 16;

/// One image.
pub(crate) struct Loaded {
    pub(crate) image: GrayImage,
    /// By how much it was reduced.
    pub(crate) factor: usize,
    pub(crate) level: usize,
    /// Pixel size of that level, um.
    pub(crate) um_per_px: Option<f64>,
    /// Pages and channels, where there is a choice.
    pub(crate) choices: Option<String>,
}

/// View and target as the options ask for them.
pub(crate) fn load_both(args: &RegisterArgs) -> Result<[Loaded; 2], CliError> {
    let level = pair("--level", &args.level)?;
    let page = pair("--page", &args.page)?;
    let channel = pair("--channel", &args.channel)?;
    let one = |k: usize, path: &Path| {
        let choice = Choice {
            page: page[k],
            channel: channel[k],
        };
        load(path, level[k].unwrap_or(0), choice)
    };
    Ok([one(0, &args.view)?, one(1, &args.target)?])
}

/// One number for both, or one for each.
fn pair(name: &str, values: &[usize]) -> Result<[Option<usize>; 2], CliError> {
    match values {
        [] => Ok([None; 2]),
        [both] => Ok([Some(*both); 2]),
        [view, target] => Ok([Some(*view), Some(*target)]),
        more => Err(CliError::Usage(format!(
            "{name} takes one number for both files or two, of view and target, and was given {}",
            more.len()
        ))),
    }
}

fn load(path: &Path, level: usize, choice: Choice) -> Result<Loaded, CliError> {
    let slide = Slide::open_as(
        path,
        &Wanted {
            choice,
            ..Wanted::default()
        },
    )?;
    let (gray, factor) = slide.read_gray_reduced(level, MAX_PIXELS)?;
    let info = slide.levels()[level];
    let (width, height) = (info.width as usize, info.height as usize);
    if width < LEAST_SIDE || height < LEAST_SIDE {
        return Err(CliError::TooSmall {
            path: path.into(),
            width,
            height,
            least: LEAST_SIDE,
        });
    }
    Ok(Loaded {
        image: GrayImage::new(gray.width, gray.height, gray.data).map_err(FeatureError::from)?,
        factor,
        level,
        um_per_px: slide.um_per_px().map(|um| um * info.downsample),
        choices: slide.choices().told(),
    })
}

/// A block's centre is `factor * x + (factor - 1) / 2` in full-resolution pixels.
pub(crate) fn reduced_from_full(factor: usize) -> Affine2 {
    let f = factor as f64;
    let offset = -(f - 1.0) / (2.0 * f);
    Affine2 {
        linear: Mat2::diagonal(1.0 / f, 1.0 / f),
        offset: [offset, offset],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_found_again_at_its_centre() {
        let full = reduced_from_full(3).inverse().unwrap();
        assert!((full.apply([0.0, 0.0])[0] - 1.0).abs() < 1e-12);
        assert!((full.apply([2.0, 5.0])[1] - 16.0).abs() < 1e-12);
    }

    #[test]
    fn one_number_is_for_both_and_two_are_for_each() {
        assert_eq!(pair("--page", &[]).unwrap(), [None, None]);
        assert_eq!(pair("--page", &[2]).unwrap(), [Some(2), Some(2)]);
        assert_eq!(pair("--page", &[2, 0]).unwrap(), [Some(2), Some(0)]);
        assert!(pair("--page", &[1, 2, 3]).is_err());
    }
}
