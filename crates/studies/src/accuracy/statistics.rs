//! Paired comparisons of two methods on the same pairs.

/// Probability of at least `losses` among the pairs on which the two methods differ, were a loss as likely as a win:
/// the exact one-sided McNemar test (a sign test).
pub fn chance_of_losses(losses: usize, wins: usize) -> f64 {
    let n = losses + wins;
    let ln_choose =
        |k: usize| -> f64 { (1..=k).map(|i| ((n - k + i) as f64 / i as f64).ln()).sum() };
    let ln_half = -(n as f64) * std::f64::consts::LN_2;
    let tail: f64 = (losses..=n).map(|k| (ln_choose(k) + ln_half).exp()).sum();
    tail.min(1.0)
}

/// Probabilities corrected for their number (Holm 1979): below a level, the chance of any false alarm among them is below
/// that level, however they depend on each other.
pub fn holm(chances: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..chances.len()).collect();
    order.sort_by(|&i, &j| chances[i].total_cmp(&chances[j]));
    let mut corrected = vec![1.0; chances.len()];
    let mut least = 0.0_f64;
    for (rank, &i) in order.iter().enumerate() {
        least = least.max(chances[i] * (chances.len() - rank) as f64);
        corrected[i] = least.min(1.0);
    }
    corrected
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sign_test_counts_coin_throws() {
        assert_eq!(chance_of_losses(0, 0), 1.0);
        assert!((chance_of_losses(5, 0) - 1.0 / 32.0).abs() < 1e-12);
        assert!((chance_of_losses(8, 2) - 56.0 / 1024.0).abs() < 1e-12);
        assert!((chance_of_losses(0, 7) - 1.0).abs() < 1e-12);
        assert!((chance_of_losses(75, 75) - 0.5325).abs() < 1e-3);
    }

    #[test]
    fn holm_multiplies_the_least_by_their_number() {
        let corrected = holm(&[0.01, 0.04, 0.03, 0.005]);
        for (c, expected) in corrected.iter().zip([0.03, 0.06, 0.06, 0.02]) {
            assert!((c - expected).abs() < 1e-12, "{corrected:?}");
        }
        assert!(holm(&[]).is_empty());
        assert_eq!(holm(&[0.9, 0.8]), [1.0, 1.0]);
    }
}
