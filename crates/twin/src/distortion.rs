//! Radial distortion: what would lie at r from the middle of the image is seen at `r' = r (1 + k (r / r_corner)^2)`.
//!
//! The specimen is read where each sample really looks, and blurred afterwards: the blur is then as wide everywhere, where distortion would
//! stretch it by 3 k at the corner, and a thing's middle moves by `6 k r sigma^2 / r_corner^2` at most: 5e-5 px for 0.3 % and a blur of 1 px.

/// The distortion of one objective on a grid of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Distortion {
    /// The middle of the image, samples.
    centre: [f64; 2],
    /// k over the square of the corner's distance, per square sample.
    per_sq: f64,
}

impl Distortion {
    /// `at_corner` is k; `corner` the distance of the image's corner from its `centre`, samples. `None` where there is no distortion.
    pub(crate) fn new(at_corner: f64, centre: [f64; 2], corner: f64) -> Option<Self> {
        (at_corner != 0.0).then(|| Self {
            centre,
            per_sq: at_corner / (corner * corner),
        })
    }

    /// Where a sample would look without distortion.
    pub(crate) fn ideal(&self, seen: [f64; 2]) -> [f64; 2] {
        let [x, y] = [seen[0] - self.centre[0], seen[1] - self.centre[1]];
        let bend = self.per_sq * (x * x + y * y);
        // r / r' = s, of `s + bend s^3 = 1`. Four steps of Newton's are exact for any distortion that the configuration takes.
        let mut s = 1.0;
        for _ in 0..4 {
            s -= (s + bend * s * s * s - 1.0) / (1.0 + 3.0 * bend * s * s);
        }
        [self.centre[0] + s * x, self.centre[1] + s * y]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_is_seen_farther_out_by_the_distortion_and_the_middle_stays() {
        let (centre, corner) = ([319.5, 239.5], 399.4);
        assert_eq!(Distortion::new(0.0, centre, corner), None);
        for k in [0.003, -0.003, 0.05, -0.05] {
            let distortion = Distortion::new(k, centre, corner).unwrap();
            assert_eq!(distortion.ideal(centre), centre);
            // Beyond the corner as well: the border around the image is rendered, too.
            for share in [0.3, 1.0, 1.6] {
                let r = share * corner;
                let seen = r * (1.0 + k * share * share);
                let ideal = distortion.ideal([centre[0] + 0.6 * seen, centre[1] - 0.8 * seen]);
                let off = (ideal[0] - centre[0] - 0.6 * r).hypot(ideal[1] - centre[1] + 0.8 * r);
                assert!(off < 1e-6, "{k} {share}: {off}");
            }
        }
    }
}
