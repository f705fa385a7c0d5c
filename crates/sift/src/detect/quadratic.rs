//! The quadratic through a neighbourhood: where it is extreme, how high, and whether that is a blob.

/// Values of a 3 x 3 x 3 neighbourhood, indexed by layer, row, column.
pub(super) type Cube = [[[f64; 3]; 3]; 3];

/// Value, gradient and Hessian (in x, y, s) of the quadratic at the centre of a neighbourhood, by central differences.
pub(super) struct Quadratic {
    pub(super) value: f64,
    gradient: [f64; 3],
    xx: f64,
    yy: f64,
    ss: f64,
    xy: f64,
    xs: f64,
    ys: f64,
}

impl Quadratic {
    pub(super) fn of(d: &Cube) -> Self {
        let c = d[1][1][1];
        let cross = |pp: f64, pm: f64, mp: f64, mm: f64| 0.25 * (pp - pm - mp + mm);
        Self {
            value: c,
            gradient: [
                0.5 * (d[1][1][2] - d[1][1][0]),
                0.5 * (d[1][2][1] - d[1][0][1]),
                0.5 * (d[2][1][1] - d[0][1][1]),
            ],
            xx: d[1][1][2] + d[1][1][0] - 2.0 * c,
            yy: d[1][2][1] + d[1][0][1] - 2.0 * c,
            ss: d[2][1][1] + d[0][1][1] - 2.0 * c,
            xy: cross(d[1][2][2], d[1][2][0], d[1][0][2], d[1][0][0]),
            xs: cross(d[2][1][2], d[2][1][0], d[0][1][2], d[0][1][0]),
            ys: cross(d[2][2][1], d[2][0][1], d[0][2][1], d[0][0][1]),
        }
    }

    /// `-H^-1 g`, or `None` when the Hessian is singular.
    pub(super) fn offset(&self) -> Option<[f64; 3]> {
        let Self {
            xx,
            yy,
            ss,
            xy,
            xs,
            ys,
            ..
        } = *self;
        let [gx, gy, gs] = self.gradient;
        let (a, b, c) = (yy * ss - ys * ys, xs * ys - xy * ss, xy * ys - xs * yy);
        let det = xx * a + xy * b + xs * c;
        let (d, e, f) = (xx * ss - xs * xs, xy * xs - xx * ys, xx * yy - xy * xy);
        let offset = [
            -(a * gx + b * gy + c * gs) / det,
            -(b * gx + d * gy + e * gs) / det,
            -(c * gx + e * gy + f * gs) / det,
        ];
        offset.iter().all(|v| v.is_finite()).then_some(offset)
    }

    /// Value of the quadratic at its extremum.
    pub(super) fn peak(&self, offset: &[f64; 3]) -> f64 {
        self.value + 0.5 * (0..3).map(|i| self.gradient[i] * offset[i]).sum::<f64>()
    }

    /// Ratio of principal curvatures below r: `tr^2 / det < (r + 1)^2 / r` (section 4.1).
    pub(super) fn is_blob(&self, edge_ratio: f64) -> bool {
        let (trace, det) = (self.xx + self.yy, self.xx * self.yy - self.xy * self.xy);
        det > 0.0 && trace * trace * edge_ratio < (edge_ratio + 1.0).powi(2) * det
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadratic_finds_its_own_extremum() {
        let truth = [0.3, -0.2, 0.4];
        let f = |x: f64, y: f64, s: f64| {
            let (x, y, s) = (x - truth[0], y - truth[1], s - truth[2]);
            5.0 - (2.0 * x * x + 1.5 * y * y + s * s + 0.5 * x * y - 0.3 * x * s + 0.2 * y * s)
        };
        let d: Cube = std::array::from_fn(|s| {
            std::array::from_fn(|j| {
                std::array::from_fn(|i| f(i as f64 - 1.0, j as f64 - 1.0, s as f64 - 1.0))
            })
        });
        let fit = Quadratic::of(&d);
        let offset = fit.offset().unwrap();
        for (o, t) in offset.iter().zip(truth) {
            assert!((o - t).abs() < 1e-12);
        }
        assert!((fit.peak(&offset) - 5.0).abs() < 1e-12);
    }

    #[test]
    fn edge_test_is_the_ratio_of_curvatures() {
        for (ratio, is_blob) in [(9.9, true), (10.1, false), (-1.0, false)] {
            let d: Cube = std::array::from_fn(|_| {
                std::array::from_fn(|j| {
                    std::array::from_fn(|i| {
                        -(ratio * (i as f64 - 1.0).powi(2)) - (j as f64 - 1.0).powi(2)
                    })
                })
            });
            assert_eq!(Quadratic::of(&d).is_blob(10.0), is_blob, "{ratio}");
        }
    }
}
