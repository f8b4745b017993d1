//! A pseudo-terminal under a name of its own: the simulated end of a serial line.

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// The device's end of a pseudo-terminal, and the symlink to the host's end; the symlink goes with it.
#[derive(Debug)]
pub(super) struct Pty {
    master: OwnedFd,
    /// Kept open: without any open host's end, reading the master would fail whenever a host closes the line.
    slave: OwnedFd,
    link: PathBuf,
    target: PathBuf,
}

impl Pty {
    /// Opens a pseudo-terminal in raw mode and points `link` at it, in one step if `link` is a symlink already.
    ///
    /// # Errors
    /// Where there is no pseudo-terminal left, or `link` is something else than a symlink or cannot be written.
    pub(super) fn open(link: &Path) -> io::Result<Self> {
        let named = |error: io::Error| {
            io::Error::new(error.kind(), format!("cannot put a pseudo-terminal at {}: {error}", link.display()))
        };
        Self::open_unnamed(link).map_err(named)
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

    /// Lets another host open the line, as a real port does once a host that had it for itself is gone. Here the host's end
    /// never closes, and a host that was killed does not give its claim up.
    pub(super) fn release(&self) {
        // Nothing hangs on it but that other host's patience.
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
