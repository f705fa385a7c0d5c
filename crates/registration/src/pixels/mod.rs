//! Two images pixel by pixel, when it is known roughly where one lies in the other: a better transform ([`refine`]), and evidence for or
//! against one that does not stand on features ([`weigh`]).
//!
//! Places are pixels, integer coordinates pixel centres; `target_from_view` takes a pixel of the view to the target's. All work is done on
//! the grid of the coarser image, in square blocks. The finer one is blurred to what the coarser one's pixels see, and where one of them is out of
//! focus the other is blurred to match. Within each block gain and offset are free, so that shading and soft shadows are no difference, and what
//! does not follow is weighed down pixel by pixel or left out with its block.
//!
//! The refinement is the inverse compositional one (Baker, Matthews, IJCV 2004) for a similarity, on top of the transform that it starts from:
//! gradients are those of the fixed image, and what is found is composed inversely. Its covariance is that of leaving out each block in turn.

mod blocks;
mod evidence;
mod fit;
mod matched;
mod refine;
mod sharpness;
mod surface;
mod tone;

use scopeservo_features::{GrayImage, Mask};

pub use evidence::{Evidence, Judgement, weigh};
pub use refine::{Abstained, Refined, refine};
pub use sharpness::{Sharpness, sharpness};

/// Two images, and what of them counts; all of it where nothing is said.
#[derive(Debug, Clone, Copy)]
pub struct Pictures<'a> {
    /// What the transform is from.
    pub view: &'a GrayImage,
    /// And what to.
    pub target: &'a GrayImage,
    /// What counts of the view: not what is fixed to the camera.
    pub of_view: Option<&'a Mask>,
    /// What counts of the target.
    pub of_target: Option<&'a Mask>,
}
