//! A pseudo-terminal with a symlink as its name: the simulated end of a serial line.
//! [`run`](fn@super::run) uses it; so does `tests/device_pty.rs`.

use std::fmt::Write as _;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use sha2::{Digest, Sha256};

use crate::output::directory_of;

/// Claims the name of a line for one simulated device while its process lives, even while its line is away for a while.
#[derive(Debug)]
pub(super) struct Claim {
    /// Bound to an abstract socket name, which the kernel frees however the process ends. Nobody connects to it.
    _name: UnixListener,
}

impl Claim {
    /// Claims `link`. Different paths to the same directory count as one.
    ///
    /// # Errors
    /// Another simulated device serves it, or its directory is not there.
    pub(super) fn new(link: &Path) -> io::Result<Self> {
        let directory = std::fs::metadata(directory_of(link)).map_err(|error| named(link, &error))?;
        let file = link.file_name().ok_or_else(|| named(link, &io::Error::other("it names no file")))?;
        let mut name = format!("layerd-simulate:{:x}:{:x}:", directory.dev(), directory.ino());
        // Hashed, because the length of such a name is limited.
        for byte in Sha256::digest(file.as_encoded_bytes()).iter().take(16) {
            let _ = write!(name, "{byte:02x}");
        }
        let bound = SocketAddr::from_abstract_name(name).and_then(|address| UnixListener::bind_addr(&address));
        bound.map(|name| Self { _name: name }).map_err(|error| match error.kind() {
            io::ErrorKind::AddrInUse => io::Error::new(
                io::ErrorKind::AddrInUse,
                format!(
                    "another simulated device serves {} already: end it first, or give this one another --link",
                    link.display()
                ),
            ),
            _ => named(link, &error),
        })
    }
}

fn named(link: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("cannot put a pseudo-terminal at {}: {error}", link.display()))
}

/// The device's end of a pseudo-terminal, and the symlink to the host's end; the symlink goes with it.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    /// Kept open: without any open host's end, reading the master would fail whenever a host closes the line.
    slave: OwnedFd,
    link: PathBuf,
    target: PathBuf,
}

impl Pty {
    /// Opens a pseudo-terminal in raw mode and points the symlink `link` at it. An existing symlink is replaced atomically.
    ///
    /// # Errors
    /// No pseudo-terminal is left, or `link` is not a symlink or cannot be written.
    pub fn open(link: &Path) -> io::Result<Self> {
        Self::open_unnamed(link).map_err(|error| named(link, &error))
    }

    fn open_unnamed(link: &Path) -> io::Result<Self> {
        if std::fs::symlink_metadata(link).is_ok_and(|found| !found.file_type().is_symlink()) {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, "there is a file of that name; remove it first"));
        }
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        let slave = rustix::fs::open(&*name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        let mut modes = tcgetattr(&slave)?;
        modes.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &modes)?;
        let flags = rustix::fs::fcntl_getfl(&master)?;
        rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;

        let target = PathBuf::from(String::from_utf8_lossy(name.to_bytes()).into_owned());
        let mut part = link.as_os_str().to_owned();
        part.push(".part");
        // Left over from a process that was killed between the two steps.
        let _ = std::fs::remove_file(&part);
        std::os::unix::fs::symlink(&target, &part)?;
        std::fs::rename(&part, link)?;
        Ok(Self { master, slave, link: link.into(), target })
    }

    /// Lets another host open the line. A real port becomes free when a host with exclusive access is killed; here the host's end
    /// never closes, so the claim must be cleared.
    pub fn release(&self) {
        // Best effort: on failure the other host only waits longer.
        let _ = rustix::termios::ioctl_tiocnxcl(&self.slave);
    }
}

/// The device's end, not blocking.
impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }
}

impl AsRawFd for Pty {
    fn as_raw_fd(&self) -> RawFd {
        self.master.as_raw_fd()
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        // Another simulation may have taken the name over.
        if std::fs::read_link(&self.link).is_ok_and(|target| target == self.target) {
            let _ = std::fs::remove_file(&self.link);
        }
    }
}
