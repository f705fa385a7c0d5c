//! Dot products of bytes, four components at a time: the one step of matching that every instruction set does in its own way.
//!
//! A lane of 32 bits holds four components of one descriptor. All rely on the bounds of [`Descriptor`](crate::Descriptor):
//! components of at most 127 are the same signed and unsigned, and a dot product, or the part of it in any lane, is below 2^16.

use fearless_simd::Simd;

/// Lane-wise sums of products, with the instructions that `Self` proves.
pub(super) trait Dots: Copy + Send + Sync {
    /// Instruction set of all other steps.
    type S: Simd;
    /// Running sums for a vector of descriptors.
    type Sum: Copy;

    fn simd(self) -> Self::S;

    /// Calls `f` with the instructions enabled.
    fn run<R>(self, f: impl FnOnce() -> R) -> R;

    fn zero(self) -> Self::Sum;

    /// Adds the products of four components of each lane.
    fn add(self, sum: Self::Sum, a: Lanes<Self>, b: Lanes<Self>) -> Self::Sum;

    /// The dot products times 2^16, modulo 2^32.
    fn total_shl_16(self, sum: Self::Sum) -> Lanes<Self>;
}

/// One 32-bit lane per descriptor.
pub(super) type Lanes<D> = <<D as Dots>::S as Simd>::i32s;

/// From two 16-bit partial sums per lane: their sum in the upper half.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
macro_rules! halves_shl_16 {
    ($halves:expr) => {{
        let halves = $halves;
        (halves << 16) + (halves & (-1 << 16))
    }};
}

#[cfg(target_arch = "x86_64")]
pub(super) use x86::AvxVnni;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use fearless_simd::prelude::*;
    use fearless_simd::x86::{Avx2, Avx512};
    use fearless_simd::{Simd, i32x8, i32x16, kernel};

    use super::Dots;

    kernel!(
        // Two products of at most 127^2 fit 15 bits, so `maddubs` does not saturate; the 16-bit sums may pass for negative, but
        // lose nothing.
        #[inline(always)]
        fn add_avx2(_s: Avx2, sum: __m256i, a: __m256i, b: __m256i) -> __m256i {
            _mm256_add_epi16(sum, _mm256_maddubs_epi16(a, b))
        }
    );

    impl Dots for Avx2 {
        type S = Self;
        type Sum = i32x8<Self>;

        #[inline(always)]
        fn simd(self) -> Self {
            self
        }

        #[inline(always)]
        fn run<R>(self, f: impl FnOnce() -> R) -> R {
            self.vectorize(f)
        }

        #[inline(always)]
        fn zero(self) -> i32x8<Self> {
            i32x8::splat(self, 0)
        }

        #[inline(always)]
        fn add(self, sum: i32x8<Self>, a: i32x8<Self>, b: i32x8<Self>) -> i32x8<Self> {
            add_avx2(self, sum.into(), a.into(), b.into()).simd_into(self)
        }

        #[inline(always)]
        fn total_shl_16(self, sum: i32x8<Self>) -> i32x8<Self> {
            halves_shl_16!(sum)
        }
    }

    /// AVX2 with the byte products of AVX-VNNI, as in client processors since Alder Lake.
    #[derive(Debug, Clone, Copy)]
    pub(in super::super) struct AvxVnni(Avx2);

    impl AvxVnni {
        /// Whether this processor has them.
        pub(in super::super) fn detect(avx2: Avx2) -> Option<Self> {
            is_x86_feature_detected!("avxvnni").then_some(Self(avx2))
        }
    }

    #[target_feature(
        enable = "avx2,avxvnni,bmi1,bmi2,cmpxchg16b,f16c,fma,fxsr,lzcnt,movbe,popcnt,xsave"
    )]
    fn with_avx_vnni<R>(f: impl FnOnce() -> R) -> R {
        f()
    }

    impl Dots for AvxVnni {
        type S = Avx2;
        type Sum = i32x8<Avx2>;

        #[inline(always)]
        fn simd(self) -> Avx2 {
            self.0
        }

        #[inline(always)]
        #[expect(unsafe_code, reason = "there is no ready-made token for AVX-VNNI")]
        fn run<R>(self, f: impl FnOnce() -> R) -> R {
            // SAFETY: `detect` made `self` where there is AVX-VNNI, from the token that proves all the rest.
            unsafe { with_avx_vnni(f) }
        }

        #[inline(always)]
        fn zero(self) -> i32x8<Avx2> {
            i32x8::splat(self.0, 0)
        }

        #[inline(always)]
        #[expect(unsafe_code, reason = "there is no ready-made token for AVX-VNNI")]
        fn add(self, sum: i32x8<Avx2>, a: i32x8<Avx2>, b: i32x8<Avx2>) -> i32x8<Avx2> {
            // SAFETY: `detect` made `self` where there is AVX-VNNI.
            unsafe { _mm256_dpbusd_avx_epi32(sum.into(), a.into(), b.into()) }.simd_into(self.0)
        }

        #[inline(always)]
        fn total_shl_16(self, sum: i32x8<Avx2>) -> i32x8<Avx2> {
            sum << 16
        }
    }

    kernel!(
        #[inline(always)]
        fn add_avx512(_s: Avx512, sum: __m512i, a: __m512i, b: __m512i) -> __m512i {
            _mm512_dpbusd_epi32(sum, a, b)
        }
    );

    kernel!(
        // Unlike `<<` on the vector, Miri knows this one.
        #[inline(always)]
        fn shl_16_avx512(_s: Avx512, sum: __m512i) -> __m512i {
            _mm512_slli_epi32::<16>(sum)
        }
    );

    impl Dots for Avx512 {
        type S = Self;
        type Sum = i32x16<Self>;

        #[inline(always)]
        fn simd(self) -> Self {
            self
        }

        #[inline(always)]
        fn run<R>(self, f: impl FnOnce() -> R) -> R {
            self.vectorize(f)
        }

        #[inline(always)]
        fn zero(self) -> i32x16<Self> {
            i32x16::splat(self, 0)
        }

        #[inline(always)]
        fn add(self, sum: i32x16<Self>, a: i32x16<Self>, b: i32x16<Self>) -> i32x16<Self> {
            add_avx512(self, sum.into(), a.into(), b.into()).simd_into(self)
        }

        #[inline(always)]
        fn total_shl_16(self, sum: i32x16<Self>) -> i32x16<Self> {
            shl_16_avx512(self, sum.into()).simd_into(self)
        }
    }
}

#[cfg(target_arch = "aarch64")]
mod arm {
    use std::arch::aarch64::*;

    use fearless_simd::aarch64::Neon;
    use fearless_simd::prelude::*;
    use fearless_simd::{Simd, i32x4, kernel};

    use super::Dots;

    /// One 16-bit sum per component and descriptor: those of the first two descriptors, and of the others.
    type Sums = (uint16x8_t, uint16x8_t);

    kernel!(
        #[inline(always)]
        fn add_neon(_s: Neon, sum: Sums, a: int32x4_t, b: int32x4_t) -> Sums {
            let (a, b) = (vreinterpretq_u8_s32(a), vreinterpretq_u8_s32(b));
            (
                vmlal_u8(sum.0, vget_low_u8(a), vget_low_u8(b)),
                vmlal_high_u8(sum.1, a, b),
            )
        }
    );

    kernel!(
        #[inline(always)]
        fn pairs_neon(_s: Neon, sum: Sums) -> int32x4_t {
            vreinterpretq_s32_u16(vpaddq_u16(sum.0, sum.1))
        }
    );

    kernel!(
        #[inline(always)]
        fn zero_neon(_s: Neon) -> Sums {
            (vdupq_n_u16(0), vdupq_n_u16(0))
        }
    );

    impl Dots for Neon {
        type S = Self;
        type Sum = Sums;

        #[inline(always)]
        fn simd(self) -> Self {
            self
        }

        #[inline(always)]
        fn run<R>(self, f: impl FnOnce() -> R) -> R {
            self.vectorize(f)
        }

        #[inline(always)]
        fn zero(self) -> Sums {
            zero_neon(self)
        }

        #[inline(always)]
        fn add(self, sum: Sums, a: i32x4<Self>, b: i32x4<Self>) -> Sums {
            add_neon(self, sum, a.into(), b.into())
        }

        #[inline(always)]
        fn total_shl_16(self, sum: Sums) -> i32x4<Self> {
            let halves: i32x4<Self> = pairs_neon(self, sum).simd_into(self);
            halves_shl_16!(halves)
        }
    }
}
