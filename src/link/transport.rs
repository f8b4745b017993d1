//! The serial port: a real one or a pseudo-terminal, 8N1, raw, for one process alone.
//!
//! Linux raises DTR and RTS when a port is opened that nobody has open, and lowers them at the last close if HUPCL is set.
//! Many boards reset when DTR rises. So the port is opened once, HUPCL is cleared, and neither line is touched.

use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::fs::{FlockOperation, Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{ControlModes, InputModes, OptionalActions, Termios, isatty, tcgetattr, tcsetattr};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

use crate::config::{FlowControl, LinkConfig};

/// Further from the rate asked for, a receiver samples the last bit of a byte wrongly.
const RATE_TOLERANCE_PERCENT: u64 = 3;

/// A port that could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Nothing there.
    #[error("{}: no such port; is the device connected and switched on? (ls /dev/serial/by-id)", .0.display())]
    Missing(PathBuf),
    /// Another process has it.
    #[error("{}: in use by another program (find it with: fuser {})", .0.display(), .0.display())]
    InUse(PathBuf),
    /// Something else than a port.
    #[error("{}: not a serial port or pseudo-terminal", .0.display())]
    NotATerminal(PathBuf),
    /// Not for this user (EACCES): the file's owner, group and mode forbid it.
    #[error("{}: permission denied; add this user to the group dialout (usermod -aG dialout USER) and log in again", .0.display())]
    PermissionDenied(PathBuf),
    /// Not for this service (EPERM): the systemd unit or the container allows no device of this kind.
    #[error(
        "{}: the systemd unit does not allow devices of major number {major}; run `systemctl edit layerd`, add the lines \
         [Service] and DeviceAllow=char-{major} rw, and restart the service",
        path.display()
    )]
    Forbidden {
        /// The port.
        path: PathBuf,
        /// Its device's major number.
        major: u32,
    },
    /// The port does not do what the machine's file asks for.
    #[error("{}: the port does not take {key} = {wanted}{found}: correct `{key}` in the machine's file, or use another adapter", path.display())]
    Unsuited {
        /// The port.
        path: PathBuf,
        /// The key in the file.
        key: &'static str,
        /// What it says.
        wanted: String,
        /// What the port has instead, where it says so.
        found: String,
    },
    /// Anything else.
    #[error("{}: {reason}", path.display())]
    Other {
        /// The port.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
}

/// An open port. Dropping it closes it. Both halves work at the same time: a device that takes nothing must still be heard.
#[derive(Debug)]
pub struct SerialLine {
    /// From the device.
    pub reader: LineReader,
    /// To the device.
    pub writer: LineWriter,
}

/// The half that reads.
#[derive(Debug)]
pub struct LineReader(Arc<Port>);

/// The half that writes.
#[derive(Debug)]
pub struct LineWriter(Arc<Port>);

/// The open terminal, claimed for this process.
#[derive(Debug)]
struct Port(AsyncFd<OwnedFd>);

impl SerialLine {
    /// Opens the port; a symbolic link is followed anew each time. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`OpenError`] names the port and what to do.
    pub fn open(config: &LinkConfig) -> Result<Self, OpenError> {
        let terminal = open_terminal(&config.path)?;
        claim(&terminal).map_err(|errno| open_error(&config.path, 0, errno))?;
        set_up(&terminal, config)?;
        let port = Port::new(terminal).map_err(|error| other(&config.path, &error.to_string()))?;
        let port = Arc::new(port);
        Ok(Self { reader: LineReader(Arc::clone(&port)), writer: LineWriter(port) })
    }
}

impl Port {
    #[allow(
        deprecated,
        reason = "its successor is unsafe for what a port keeps: one descriptor, its own, as long as it lives"
    )]
    fn new(terminal: OwnedFd) -> io::Result<Self> {
        AsyncFd::new(terminal).map(Self)
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        // A pseudo-terminal lives on as long as its other end, and its claim with it.
        let _ = rustix::termios::ioctl_tiocnxcl(self.0.get_ref());
    }
}

impl LineReader {
    /// Reads what is there, at least one byte. Cancel safe.
    ///
    /// # Errors
    /// The port vanished or its other end closed; open it again.
    pub async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = |terminal: &OwnedFd| Ok(rustix::io::read(terminal, &mut *buffer)?);
        match self.0.0.async_io(Interest::READABLE, read).await? {
            0 => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the port was closed at its other end")),
            count => Ok(count),
        }
    }
}

impl LineWriter {
    /// Writes some of `bytes`, at least one. Cancel safe.
    ///
    /// # Errors
    /// The port vanished or its other end closed; open it again.
    pub async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let write = |terminal: &OwnedFd| Ok(rustix::io::write(terminal, bytes)?);
        self.0.0.async_io(Interest::WRITABLE, write).await
    }
}

/// Opens what is a terminal. Anything else is told before it is opened, since opening alone can do something: a watchdog begins
/// to count.
fn open_terminal(path: &Path) -> Result<OwnedFd, OpenError> {
    let metadata = std::fs::metadata(path).map_err(|error| match Errno::from_io_error(&error) {
        Some(errno) => open_error(path, 0, errno),
        None => other(path, &error.to_string()),
    })?;
    if !metadata.file_type().is_char_device() {
        return Err(OpenError::NotATerminal(path.into()));
    }
    // Without waiting for a carrier, and without taking the terminal over.
    let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let terminal = rustix::fs::open(path, flags, Mode::empty())
        .map_err(|errno| open_error(path, rustix::fs::major(metadata.rdev()), errno))?;
    if isatty(&terminal) { Ok(terminal) } else { Err(OpenError::NotATerminal(path.into())) }
}

/// Keeps other programs off the port: those that ask the kernel, and those that agree among each other.
fn claim(terminal: &OwnedFd) -> Result<(), Errno> {
    rustix::fs::flock(terminal, FlockOperation::NonBlockingLockExclusive)?;
    rustix::termios::ioctl_tiocexcl(terminal)
}

/// Raw, 8N1, at the configured rate, and without HUPCL.
fn set_up(terminal: &OwnedFd, config: &LinkConfig) -> Result<(), OpenError> {
    let path = &config.path;
    let failed = |errno: Errno| match errno {
        Errno::INVAL | Errno::RANGE => unsuited(path, "baud", config.baud.to_string(), String::new()),
        errno => open_error(path, 0, errno),
    };
    let mut modes = tcgetattr(terminal).map_err(failed)?;
    modes.make_raw();
    modes.control_modes |= ControlModes::CREAD | ControlModes::CLOCAL;
    modes.control_modes -= ControlModes::HUPCL | ControlModes::CSTOPB | ControlModes::CRTSCTS;
    modes.input_modes -= InputModes::IXON | InputModes::IXOFF | InputModes::IXANY;
    match config.flow_control {
        FlowControl::None => {}
        FlowControl::RtsCts => modes.control_modes |= ControlModes::CRTSCTS,
        FlowControl::XonXoff => modes.input_modes |= InputModes::IXON | InputModes::IXOFF,
    }
    modes.set_speed(config.baud).map_err(failed)?;
    tcsetattr(terminal, OptionalActions::Now, &modes).map_err(failed)?;
    // The call succeeds where a part of it was done.
    check_taken(&tcgetattr(terminal).map_err(failed)?, config)
}

fn check_taken(modes: &Termios, config: &LinkConfig) -> Result<(), OpenError> {
    let (path, baud, found) = (&config.path, config.baud, modes.output_speed());
    if u64::from(found.abs_diff(baud)) * 100 > u64::from(baud) * RATE_TOLERANCE_PERCENT {
        return Err(unsuited(path, "baud", baud.to_string(), format!(", but has {found}")));
    }
    if config.flow_control == FlowControl::RtsCts && !modes.control_modes.contains(ControlModes::CRTSCTS) {
        return Err(unsuited(path, "flow_control", "\"rts_cts\"".into(), String::new()));
    }
    Ok(())
}

fn open_error(path: &Path, major: u32, errno: Errno) -> OpenError {
    match errno {
        Errno::NOENT | Errno::NOTDIR | Errno::NXIO | Errno::NODEV | Errno::IO => OpenError::Missing(path.into()),
        Errno::BUSY | Errno::WOULDBLOCK => OpenError::InUse(path.into()),
        Errno::ACCESS => OpenError::PermissionDenied(path.into()),
        Errno::PERM => OpenError::Forbidden { path: path.into(), major },
        Errno::NOTTY => OpenError::NotATerminal(path.into()),
        errno => other(path, &io::Error::from(errno).to_string()),
    }
}

fn unsuited(path: &Path, key: &'static str, wanted: String, found: String) -> OpenError {
    OpenError::Unsuited { path: path.into(), key, wanted, found }
}

fn other(path: &Path, reason: &str) -> OpenError {
    OpenError::Other { path: path.into(), reason: reason.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Neither can be had from the system in a test that runs as root.
    #[test]
    fn what_the_unit_forbids_is_told_from_what_the_group_forbids() {
        let told = |errno| open_error(Path::new("/dev/ttyUSB0"), 188, errno).to_string();
        let unit = told(Errno::PERM);
        assert!(unit.contains("DeviceAllow=char-188 rw") && !unit.contains("dialout"), "{unit}");
        let group = told(Errno::ACCESS);
        assert!(group.contains("group dialout") && !group.contains("DeviceAllow"), "{group}");
    }
}
