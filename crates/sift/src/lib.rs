//! SIFT features: detect, orient, describe, match. Knows no microscope and no geometry.
