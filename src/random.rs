//! Random numbers for names of sessions and of jobs. Not for secrets. Keys of jobs and ids of sessions are made with it.

use std::hash::{BuildHasher, Hasher, RandomState};

/// 64 random bits.
pub(crate) fn bits() -> u64 {
    // The standard library seeds these from random numbers of the system.
    RandomState::new().build_hasher().finish()
}
