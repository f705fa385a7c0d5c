//! What the pixels of a frame said, to be told.

use scopeservo_registration::NotFound;
use scopeservo_registration::pixels::{Abstained, Evidence, Judgement, Sharpness};
use serde::{Deserialize, Serialize};

/// What the pixels of a frame said.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PixelsSeen {
    /// Blocks of pixels that the refined transform stands on; `None` where it is the features'.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refined_blocks: Option<usize>,
    /// Why it was not refined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub abstained: Option<Abstained>,
    /// Near the goal, whether blocks of pixels lie where the transform puts them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub evidence: Option<Evidence>,
    /// How sharp the view is beside the target; `None` where that could not be told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sharpness: Option<Sharpness>,
}

impl PixelsSeen {
    /// Why the view is not to be taken for the target.
    pub(crate) fn contradiction(&self) -> Option<NotFound> {
        let evidence = self.evidence.as_ref()?;
        let &Evidence { asked, agree, .. } = evidence;
        let contradicts = evidence.judgement == Judgement::Contradicts;
        contradicts.then_some(NotFound::PixelsDisagree { asked, agree })
    }
}
