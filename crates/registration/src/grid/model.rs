//! Where a grid's cells are seen: an affine map, a tilted field, radial distortion.

use scopeservo_geometry::{Mat2, Vec2};

/// Unknowns: the map row by row, the offset, distortion, and the field's tilt.
pub(super) const UNKNOWNS: usize = 9;
pub(super) const DISTORTION: usize = 6;
pub(super) const KEYSTONE: [usize; 2] = [7, 8];

/// The map of a grid into the image, about its centre; see [`super::Grid`] for the letters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    pub(super) pixel_from_lattice: Mat2,
    pub(super) offset_px: Vec2,
    pub(super) distortion: f64,
    pub(super) keystone: Vec2,
    /// Distance of the image's corner from its centre, px.
    pub(super) corner_px: f64,
}

impl Model {
    /// An affine one.
    pub(super) fn affine(pixel_from_lattice: Mat2, offset_px: Vec2, corner_px: f64) -> Self {
        Self {
            pixel_from_lattice,
            offset_px,
            distortion: 0.0,
            keystone: [0.0; 2],
            corner_px,
        }
    }

    /// Where a cell is seen, px from the image's centre.
    pub(super) fn seen(&self, n: Vec2) -> Vec2 {
        let [x, y] = self.pixel_from_lattice * n;
        let [x, y] = [x + self.offset_px[0], y + self.offset_px[1]].map(|v| v / self.corner_px);
        let far = 1.0 + self.keystone[0] * x + self.keystone[1] * y;
        let [x, y] = [x / far, y / far];
        let bend = 1.0 + self.distortion * (x * x + y * y);
        [x, y].map(|v| v * bend * self.corner_px)
    }

    /// Pixels per period around a cell.
    pub(super) fn local(&self, n: Vec2) -> Mat2 {
        const STEP: f64 = 1e-3;
        let along = |d: Vec2| {
            let [a, b] = [1.0, -1.0].map(|s| self.seen([n[0] + s * d[0], n[1] + s * d[1]]));
            [0, 1].map(|k| (a[k] - b[k]) / (2.0 * STEP))
        };
        let (u, v) = (along([STEP, 0.0]), along([0.0, STEP]));
        Mat2([[u[0], v[0]], [u[1], v[1]]])
    }

    /// With one unknown changed.
    pub(super) fn moved(mut self, unknown: usize, by: f64) -> Self {
        match unknown {
            0..4 => self.pixel_from_lattice.0[unknown / 2][unknown % 2] += by,
            4..6 => self.offset_px[unknown - 4] += by,
            DISTORTION => self.distortion += by,
            _ => self.keystone[unknown - KEYSTONE[0]] += by,
        }
        self
    }
}
