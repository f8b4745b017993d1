//! File descriptors: the daemon does not start unless it has enough for everything at once. `tests/check_start.rs` tests it.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::daemon::http::server;

/// Descriptors besides connections: lock, port, listeners and runtimes (30), two uploads, the part that is printed, the part that
/// is checked, and journals for waiting orders (16); and more than as many again in reserve, as a print ends without them.
const OWN: u64 = 128;

/// Descriptors that the daemon needs.
pub(crate) const NEEDED: u64 = OWN + server::MAX_DESCRIPTORS;

/// Raises the limit as far as this process may.
///
/// # Errors
/// The limit is too low; the text says what to do.
pub(crate) fn reserve() -> Result<(), String> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current.is_some_and(|current| current < maximum.unwrap_or(NEEDED).max(NEEDED)) {
        // If that is forbidden, the present limit may still be enough.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    }
    match getrlimit(Resource::Nofile).current {
        Some(current) if current < NEEDED => Err(too_few(current)),
        _ => Ok(()),
    }
}

/// Checks the same without changing anything.
///
/// # Errors
/// As [`reserve`].
pub(crate) fn check() -> Result<(), String> {
    match getrlimit(Resource::Nofile).maximum {
        Some(maximum) if maximum < NEEDED => Err(too_few(maximum)),
        _ => Ok(()),
    }
}

fn too_few(limit: u64) -> String {
    format!(
        "this process may open {limit} files, layerd needs {NEEDED}: raise the limit (ulimit -n {NEEDED}, or \
         LimitNOFILE={NEEDED} in the service's unit)"
    )
}
