//! How a frame lies against its reference.

/// A similarity about the middles of both images: frame from reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    /// `[[a, -b], [b, a]]`.
    pub(super) a: f32,
    pub(super) b: f32,
    pub(super) shift: [f32; 2],
}

impl Motion {
    pub(super) fn shift(shift: [f32; 2]) -> Self {
        Self {
            a: 1.0,
            b: 0.0,
            shift,
        }
    }

    pub(super) fn apply(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [
            self.a * x - self.b * y + self.shift[0],
            self.b * x + self.a * y + self.shift[1],
        ]
    }

    /// After the inverse of a small one, given by what it adds: `[da, db, dx, dy]`.
    pub(super) fn after_inverse(&self, [da, db, dx, dy]: [f32; 4]) -> Self {
        let (a, b) = (1.0 + da, db);
        let det = a * a + b * b;
        // Of [[a, -b], [b, a]] x + d.
        let (ia, ib) = (a / det, -b / det);
        let shift = [-(ia * dx - ib * dy), -(ib * dx + ia * dy)];
        Self {
            a: self.a * ia - self.b * ib,
            b: self.b * ia + self.a * ib,
            shift: self.apply(shift),
        }
    }

    /// In pixels `ratio` times as fine, about a middle from which the present one lies `off`.
    pub(super) fn finer(&self, ratio: f32, off: [f32; 2]) -> Self {
        let moved = Self {
            shift: self.shift.map(|s| s * ratio),
            ..*self
        };
        let turned = Self {
            shift: [0.0; 2],
            ..*self
        }
        .apply(off);
        Self {
            shift: [0, 1].map(|k| moved.shift[k] + off[k] - turned[k]),
            ..moved
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_after_the_inverse_of_one_undoes_it() {
        let motion = Motion {
            a: 0.99,
            b: 0.03,
            shift: [4.0, -7.0],
        };
        let small = Motion {
            a: 1.01,
            b: -0.02,
            shift: [0.3, 0.4],
        };
        let undone = motion.after_inverse([0.01, -0.02, 0.3, 0.4]);
        for p in [[0.0, 0.0], [100.0, -50.0]] {
            let (q, r) = (undone.apply(small.apply(p)), motion.apply(p));
            assert!((q[0] - r[0]).abs() < 1e-4 && (q[1] - r[1]).abs() < 1e-4);
        }
    }

    #[test]
    fn a_finer_motion_moves_the_same_point_about_another_middle() {
        let coarse = Motion {
            a: 1.002,
            b: 0.02,
            shift: [3.0, 1.0],
        };
        let off = [-0.5, -0.25];
        let fine = coarse.finer(2.0, off);
        // The same point, from the coarse middle and from the fine one.
        let p = [30.0, 20.0];
        let q = coarse.apply(p).map(|v| 2.0 * v);
        let r = fine.apply([2.0 * p[0] + off[0], 2.0 * p[1] + off[1]]);
        assert!((q[0] + off[0] - r[0]).abs() < 1e-4 && (q[1] + off[1] - r[1]).abs() < 1e-4);
    }
}
