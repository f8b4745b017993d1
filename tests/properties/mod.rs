//! How many cases a property is tried with, and which.

use std::env;

use proptest::test_runner::{Config, RngSeed};

/// `usual` cases, the same in every run, so that a failure belongs to the change that is tested. `PROPTEST_CASES` and
/// `PROPTEST_RNG_SEED` search further.
pub(crate) fn cases(usual: u32) -> Config {
    let given = Config { failure_persistence: None, ..Config::default() };
    let cases = if env::var_os("PROPTEST_CASES").is_some() { given.cases } else { usual };
    let rng_seed = match given.rng_seed {
        RngSeed::Random => RngSeed::Fixed(1),
        fixed => fixed,
    };
    Config { cases, rng_seed, ..given }
}
