//! What the daemon takes from the system under it: files, the wall clock, random numbers, and threads that may wait for a disk.
//!
//! A simulation of a whole printer replaces all of it for the thread that it runs in: see [`install`] and `tests/simulation/`.
//! Time for decisions is not here: it is tokio's clock, which a simulation pauses and moves on. The port is not here either: the
//! daemon is given its [`Ports`](crate::link::Ports).

mod files;
mod work;

use std::cell::RefCell;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::rc::Rc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

pub use self::files::{Disk, DiskFile, FileKind, How, Metadata};
pub(crate) use self::work::spawn_blocking;

/// The system under the daemon.
pub trait System {
    /// Wall clock, milliseconds since 1970.
    fn unix_ms(&self) -> u64;

    /// 64 random bits.
    fn random_bits(&self) -> u64;

    /// The files.
    fn disk(&self) -> &dyn Disk;

    /// Runs work that may block, on another thread or later.
    fn spawn_blocking(&self, work: Box<dyn FnOnce() + Send>);

    /// Lets other threads have the processor for this time. Called by work that may block.
    fn rest(&self, time: Duration);
}

thread_local! {
    static INSTALLED: RefCell<Option<Rc<dyn System>>> = const { RefCell::new(None) };
}

/// Replaces the operating system for the calling thread, until the result is dropped.
pub fn install(system: Rc<dyn System>) -> Installed {
    Installed { before: INSTALLED.replace(Some(system)) }
}

/// Puts back what was there before when dropped.
pub struct Installed {
    before: Option<Rc<dyn System>>,
}

impl Drop for Installed {
    fn drop(&mut self) {
        INSTALLED.set(self.before.take());
    }
}

/// Calls `act` with the system of this thread.
pub(crate) fn with<R>(act: impl FnOnce(&dyn System) -> R) -> R {
    // Cloned, so that what `act` calls may come back here.
    match INSTALLED.with_borrow(Clone::clone) {
        Some(system) => act(&*system),
        None => act(&OperatingSystem),
    }
}

/// Wall clock, milliseconds since 1970; 0 if it is set to an earlier time. For people: no decision depends on it.
pub(crate) fn unix_ms() -> u64 {
    with(|system| system.unix_ms())
}

/// 64 random bits.
pub(crate) fn random_bits() -> u64 {
    with(|system| system.random_bits())
}

/// Lets other threads have the processor for this time.
pub(crate) fn rest(time: Duration) {
    with(|system| system.rest(time));
}

/// The operating system.
struct OperatingSystem;

impl System for OperatingSystem {
    fn unix_ms(&self) -> u64 {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
    }

    fn random_bits(&self) -> u64 {
        // The standard library seeds these from random numbers of the system.
        RandomState::new().build_hasher().finish()
    }

    fn disk(&self) -> &dyn Disk {
        &files::RealDisk
    }

    fn spawn_blocking(&self, work: Box<dyn FnOnce() + Send>) {
        tokio::task::spawn_blocking(work);
    }

    fn rest(&self, time: Duration) {
        std::thread::sleep(time);
    }
}
