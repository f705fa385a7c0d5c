//! How the grey values of one image become those of another: any rising curve, by medians, so that up to half may be covered.

/// Levels of equally many pixels.
const LEVELS: usize = 24;
/// Fewer pixels than this for each tell nothing.
const LEAST: usize = 20;

/// A rising curve through knots, straight between them and beyond.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tone {
    /// From, to, and the slope there.
    knots: Vec<[f32; 3]>,
}

impl Tone {
    /// Of pairs of values of the same places; they are brought into order. `None` where they are too few or all alike.
    pub(super) fn of(pairs: &mut [[f32; 2]]) -> Option<Self> {
        if pairs.len() < LEVELS * LEAST {
            return None;
        }
        pairs.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let each = pairs.len().div_ceil(LEVELS);
        let medians: Vec<[f32; 2]> = pairs
            .chunks_mut(each)
            .map(|level| {
                let from = level[level.len() / 2][0];
                let middle = level.len() / 2;
                let to = level
                    .select_nth_unstable_by(middle, |a, b| a[1].total_cmp(&b[1]))
                    .1[1];
                [from, to]
            })
            .collect();
        let mut knots = rising(&medians);
        knots.dedup_by(|b, a| b[0] - a[0] <= 1e-6 * (1.0 + a[0].abs()));
        (knots.len() >= 3).then(|| Self {
            knots: with_slopes(&knots),
        })
    }

    /// Value and slope.
    pub(super) fn at(&self, value: f32) -> [f32; 2] {
        let last = self.knots.len() - 2;
        let k = self.knots.partition_point(|knot| knot[0] <= value);
        let k = k.saturating_sub(1).min(last);
        let ([x0, y0, s0], [x1, y1, s1]) = (self.knots[k], self.knots[k + 1]);
        let share = (value - x0) / (x1 - x0);
        let slope = s0 + (s1 - s0) * share.clamp(0.0, 1.0);
        [y0 + (y1 - y0) * share, slope]
    }
}

/// What does not rise is levelled with its neighbours (pool adjacent violators).
fn rising(medians: &[[f32; 2]]) -> Vec<[f32; 2]> {
    // Sum and number of the values that were put together.
    let mut pools: Vec<(f32, usize)> = Vec::new();
    for &[_, to] in medians {
        pools.push((to, 1));
        while let [.., (a, n), (b, m)] = pools[..] {
            if a / n as f32 <= b / m as f32 {
                break;
            }
            pools.pop();
            *pools.last_mut().expect("two were seen") = (a + b, n + m);
        }
    }
    let levels = pools
        .iter()
        .flat_map(|&(sum, n)| std::iter::repeat_n(sum / n as f32, n));
    medians
        .iter()
        .zip(levels)
        .map(|(m, to)| [m[0], to])
        .collect()
}

/// At each knot the slope across both its neighbours.
fn with_slopes(knots: &[[f32; 2]]) -> Vec<[f32; 3]> {
    let last = knots.len() - 1;
    (0..knots.len())
        .map(|k| {
            let (a, b) = (knots[k.saturating_sub(1)], knots[(k + 1).min(last)]);
            [knots[k][0], knots[k][1], (b[1] - a[1]) / (b[0] - a[0])]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_found_though_a_third_is_covered_and_it_never_falls() {
        let gamma = |v: f32| v.powf(1.8);
        let mut pairs: Vec<[f32; 2]> = (0..6000)
            .map(|i| {
                let v = (i * 37 % 6000) as f32 / 6000.0;
                [v, if i % 3 == 0 { 0.02 } else { gamma(v) }]
            })
            .collect();
        let tone = Tone::of(&mut pairs).unwrap();
        let mut before = f32::NEG_INFINITY;
        for i in 5..95 {
            let v = i as f32 / 100.0;
            let [to, slope] = tone.at(v);
            assert!((to - gamma(v)).abs() < 0.06, "{v}: {to}");
            assert!(slope >= 0.0 && to >= before);
            before = to;
        }
        assert_eq!(Tone::of(&mut pairs[..100]), None);
        assert_eq!(Tone::of(&mut vec![[0.5, 0.5]; 6000]), None);
    }
}
