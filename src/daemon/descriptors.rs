//! File descriptors: there are enough for everything at once, or the daemon does not start.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use super::server;

/// What the daemon holds besides connections, at most at once: its lock, port, listeners and runtimes (30), the files of two
/// uploads, the part that is printed and the one that is checked, journals that are read or written by orders that wait (16),
/// and as many again in reserve: without one of these a print ends.
const OWN: u64 = 128;

/// Descriptors that must be there.
pub(super) const NEEDED: u64 = OWN + server::MAX_DESCRIPTORS;

/// Raises the limit as far as this process may.
///
/// # Errors
/// It may not have as many as it needs; the text says what to do.
pub(super) fn reserve() -> Result<(), String> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current.is_some_and(|current| current < maximum.unwrap_or(NEEDED).max(NEEDED)) {
        // Where that is forbidden, the limit that stands may be enough.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    }
    match getrlimit(Resource::Nofile).current {
        Some(current) if current < NEEDED => Err(too_few(current)),
        _ => Ok(()),
    }
}

/// The same as a question, without changing anything.
///
/// # Errors
/// As [`reserve`].
pub(super) fn check() -> Result<(), String> {
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
