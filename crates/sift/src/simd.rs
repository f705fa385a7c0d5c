//! Instruction sets, and tokens that prove the processor has them.
//!
//! Kernels are generic over [`fearless_simd::Simd`]; [`at_level!`] runs one with the token's instructions enabled. Everything
//! that a kernel calls must be `#[inline(always)]` down to the vector operations, or the compiler forgets which instructions it
//! may use.

use fearless_simd::{f32x8, prelude::*};

use crate::{Level, SiftError};

/// Proof that this processor has the instructions of a [`Level`]: it can only be made where they are there.
#[derive(Debug, Clone, Copy)]
pub struct Simd(pub(crate) Token);

#[derive(Debug, Clone, Copy)]
pub(crate) enum Token {
    Scalar(fearless_simd::Fallback),
    #[cfg(target_arch = "x86_64")]
    Avx2(fearless_simd::x86::Avx2),
    #[cfg(target_arch = "x86_64")]
    Avx512(fearless_simd::x86::Avx512),
    #[cfg(target_arch = "aarch64")]
    Neon(fearless_simd::aarch64::Neon),
}

impl Simd {
    /// The best level that this processor has.
    #[must_use]
    pub fn best() -> Self {
        [Level::Avx512, Level::Avx2, Level::Neon]
            .into_iter()
            .find_map(|level| Self::at(level).ok())
            .unwrap_or(Self(Token::Scalar(fearless_simd::Fallback::new())))
    }

    /// The token of `level`.
    ///
    /// # Errors
    /// [`SiftError::LevelUnavailable`] when this processor lacks it.
    pub fn at(level: Level) -> Result<Self, SiftError> {
        let has = fearless_simd::Level::new();
        let token = match level {
            Level::Scalar => Some(Token::Scalar(fearless_simd::Fallback::new())),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => has.as_avx2().map(Token::Avx2),
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => has.as_avx512().map(Token::Avx512),
            #[cfg(target_arch = "aarch64")]
            Level::Neon => has.as_neon().map(Token::Neon),
            _ => None,
        };
        let _ = has;
        token.map(Self).ok_or(SiftError::LevelUnavailable { level })
    }

    /// Every level that this processor has, the slowest first.
    pub fn available() -> impl Iterator<Item = Self> {
        Level::ALL.into_iter().filter_map(|l| Self::at(l).ok())
    }

    /// Which instruction set this is the proof of.
    #[must_use]
    pub fn level(self) -> Level {
        match self.0 {
            Token::Scalar(_) => Level::Scalar,
            #[cfg(target_arch = "x86_64")]
            Token::Avx2(_) => Level::Avx2,
            #[cfg(target_arch = "x86_64")]
            Token::Avx512(_) => Level::Avx512,
            #[cfg(target_arch = "aarch64")]
            Token::Neon(_) => Level::Neon,
        }
    }
}

/// `at_level!(simd, s => body)`: evaluates `body` with `s` bound to the token behind `simd` and its instructions enabled.
macro_rules! at_level {
    ($simd:expr, $s:ident => $body:expr) => {{
        use fearless_simd::Simd as _;
        match $simd.0 {
            $crate::simd::Token::Scalar($s) => $s.vectorize(
                #[inline(always)]
                || $body,
            ),
            #[cfg(target_arch = "x86_64")]
            $crate::simd::Token::Avx2($s) => $s.vectorize(
                #[inline(always)]
                || $body,
            ),
            #[cfg(target_arch = "x86_64")]
            $crate::simd::Token::Avx512($s) => $s.vectorize(
                #[inline(always)]
                || $body,
            ),
            #[cfg(target_arch = "aarch64")]
            $crate::simd::Token::Neon($s) => $s.vectorize(
                #[inline(always)]
                || $body,
            ),
        }
    }};
}
pub(crate) use at_level;

/// Sum of the lanes, in the same order at every level.
#[inline(always)]
pub(crate) fn sum<S: fearless_simd::Simd>(v: f32x8<S>) -> f32 {
    let v = v.to_array();
    ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_level_is_the_last_available_one() {
        let levels: Vec<Level> = Simd::available().map(Simd::level).collect();
        assert_eq!(levels[0], Level::Scalar);
        assert_eq!(*levels.last().unwrap(), Simd::best().level());
        for level in Level::ALL {
            match Simd::at(level) {
                Ok(simd) => assert_eq!(simd.level(), level),
                Err(e) => assert!(e.to_string().contains(&level.to_string())),
            }
        }
    }
}
