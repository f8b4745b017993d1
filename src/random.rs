//! Random numbers, not for secrets: unpredictable ones for keys of jobs and ids of sessions, and repeatable ones (SplitMix64).
//! `device/sim/fault.rs` and `buildfile/generate/grid.rs` take those.

use crate::system;

/// 64 random bits.
pub(crate) fn bits() -> u64 {
    system::random_bits()
}

/// What SplitMix64 adds to its state from one number to the next.
const SPLIT_MIX_STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// The number of SplitMix64 (Steele, Lea & Flood 2014) that follows a state: the same on every machine.
pub(crate) fn mix(state: u64) -> u64 {
    let mut mixed = state.wrapping_add(SPLIT_MIX_STEP);
    mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ mixed >> 31
}

/// The sequence of SplitMix64: the same seed gives the same numbers on every machine.
#[derive(Clone, Debug)]
pub(crate) struct SplitMix(u64);

impl SplitMix {
    /// The sequence of a seed.
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The next 64 bits.
    pub(crate) fn next_u64(&mut self) -> u64 {
        let bits = mix(self.0);
        self.0 = self.0.wrapping_add(SPLIT_MIX_STEP);
        bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_mix_gives_the_published_numbers() {
        let mut numbers = SplitMix::new(1_234_567);
        let first = [(); 3].map(|()| numbers.next_u64());
        assert_eq!(first, [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]);
        assert_eq!(mix(1_234_567), first[0]);
    }
}
