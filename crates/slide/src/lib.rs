//! Image files as slides: PNG, JPEG, TIFF, tiled and pyramidal TIFF, SVS, read by regions.
