//! The instruction sets by name.

use std::fmt;

/// The instruction sets that kernels are compiled for.
///
/// Every level gives the same bits on any number of threads. Levels differ in how they round: against [`Scalar`](Self::Scalar),
/// at least 99.5 % of the features are the same within 0.01 pixels of the image, 1 % of sigma, 0.01 rad and 8 of each component
/// of the descriptor, and at least 99.5 % of the matches join the same features (`tests/levels.rs`). Matching alone is exact at
/// every level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Level {
    /// No vector instructions are asked for; the oracle of the other levels.
    Scalar,
    /// x86-64-v3: AVX2 and FMA.
    Avx2,
    /// AVX-512 as since Ice Lake and Zen 4, with VNNI.
    Avx512,
    /// 64-bit ARM.
    Neon,
}

impl Level {
    /// All of them, whether this processor has them or not.
    pub const ALL: [Self; 4] = [Self::Scalar, Self::Avx2, Self::Avx512, Self::Neon];
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
            Self::Neon => "neon",
        })
    }
}
