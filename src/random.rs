//! Random numbers for names: of sessions and of jobs. Not for secrets.

use std::hash::{BuildHasher, Hasher, RandomState};

/// 64 random bits.
pub(crate) fn bits() -> u64 {
    // The standard library seeds each of these from the system's random numbers.
    RandomState::new().build_hasher().finish()
}
