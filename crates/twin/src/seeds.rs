//! Independent random streams from one seed.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

pub(crate) const STAGE: u64 = 1;
pub(crate) const NOSEPIECE: u64 = 2;
pub(crate) const SENSOR: u64 = 3;
pub(crate) const PIXELS: u64 = 4;
pub(crate) const SLIDE: u64 = 5;
pub(crate) const LATTICE: u64 = 6;
pub(crate) const LATTICE_CELL: u64 = 7;
pub(crate) const LATTICE_NUMBER: u64 = 8;
pub(crate) const SPARSE: u64 = 9;

/// The generator number `n` of a stream. Neighbouring numbers give unrelated sequences.
pub(crate) fn rng(seed: u64, stream: u64, n: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(mix(mix(mix(seed) ^ stream) ^ n))
}

/// The finaliser of SplitMix64: a bijection that scatters every bit.
fn mix(v: u64) -> u64 {
    let v = v.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    v ^ (v >> 31)
}
