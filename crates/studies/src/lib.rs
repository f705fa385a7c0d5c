//! Accuracy studies: what the documents claim, and the commands that measure it.
//!
//! Each study is an example of this crate: `cargo run --release -p scopeservo-studies --example NAME -- ARGS`.

#![warn(clippy::too_many_lines)]

pub mod accuracy;
pub mod bench;
pub mod crops;
pub mod page;
pub mod rounds;
pub mod warp;
pub mod worker;

use std::path::PathBuf;

/// The folder of real slides named by `SCOPESERVO_SPECIMENS`, if it is set and there.
pub fn specimens() -> Option<PathBuf> {
    let folder = PathBuf::from(std::env::var_os("SCOPESERVO_SPECIMENS")?);
    folder.is_dir().then_some(folder)
}

/// The value below which `share` of the values lie (nearest rank). NaN when there are none.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else {
        return f64::NAN;
    };
    sorted[((last as f64) * share).round() as usize]
}

#[cfg(test)]
mod tests {
    #[test]
    fn quantiles_are_values_of_the_list() {
        let v = [3.0, 1.0, 2.0];
        assert_eq!(super::quantile(&v, 0.5), 2.0);
        assert_eq!(super::quantile(&v, 1.0), 3.0);
        assert!(super::quantile(&[], 0.5).is_nan());
    }
}
