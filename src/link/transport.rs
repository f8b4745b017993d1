//! The serial port: a real one or a pseudo-terminal, 8N1, raw, for one process alone.

use std::io;
use std::path::{Path, PathBuf};

use serialport::ErrorKind;
use tokio::io::{AsyncReadExt, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio_serial::{SerialPortBuilderExt, SerialStream};

use crate::config::{FlowControl, LinkConfig};

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
    /// Not for this user.
    #[error("{}: permission denied; add this user to the group dialout (usermod -aG dialout USER) and log in again", .0.display())]
    PermissionDenied(PathBuf),
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
pub struct LineReader(ReadHalf<SerialStream>);

/// The half that writes.
#[derive(Debug)]
pub struct LineWriter(WriteHalf<SerialStream>);

impl SerialLine {
    /// Opens the port; a symbolic link is followed anew each time. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`OpenError`] names the port and what to do.
    pub fn open(config: &LinkConfig) -> Result<Self, OpenError> {
        let path = &config.path;
        check_terminal(path)?;
        let flow_control = match config.flow_control {
            FlowControl::None => serialport::FlowControl::None,
            FlowControl::RtsCts => serialport::FlowControl::Hardware,
            FlowControl::XonXoff => serialport::FlowControl::Software,
        };
        let name = path.to_str().ok_or_else(|| other(path, "the path is not UTF-8"))?;
        let stream = serialport::new(name, config.baud).flow_control(flow_control).open_native_async();
        let stream = stream.map_err(|error| match error.kind() {
            ErrorKind::NoDevice => OpenError::InUse(path.clone()),
            ErrorKind::Io(io::ErrorKind::NotFound) => OpenError::Missing(path.clone()),
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => OpenError::PermissionDenied(path.clone()),
            _ => other(path, &error.description),
        })?;
        let (reader, writer) = tokio::io::split(stream);
        Ok(Self { reader: LineReader(reader), writer: LineWriter(writer) })
    }
}

impl LineReader {
    /// Reads what is there, at least one byte.
    ///
    /// # Errors
    /// The port vanished or its other end closed; open it again.
    pub async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.0.read(buffer).await? {
            0 => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the port was closed at its other end")),
            count => Ok(count),
        }
    }
}

impl LineWriter {
    /// Writes some of `bytes`, at least one.
    ///
    /// # Errors
    /// The port vanished or its other end closed; open it again.
    pub async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes).await
    }
}

/// The serial library calls much of what can be wrong by one name; this tells it apart before.
fn check_terminal(path: &Path) -> Result<(), OpenError> {
    use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
    // Without waiting for a carrier, and without taking the terminal over.
    let flags = libc::O_NONBLOCK | libc::O_NOCTTY;
    match std::fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(OpenError::Missing(path.into())),
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
            return Err(OpenError::PermissionDenied(path.into()));
        }
        Err(error) => return Err(other(path, &error.to_string())),
        Ok(metadata) if !metadata.file_type().is_char_device() => return Err(OpenError::NotATerminal(path.into())),
        Ok(_) => {}
    }
    let file = std::fs::OpenOptions::new().read(true).write(true).custom_flags(flags).open(path);
    let file = file.map_err(|error| match error.raw_os_error() {
        Some(libc::EBUSY) => OpenError::InUse(path.into()),
        Some(libc::EACCES | libc::EPERM) => OpenError::PermissionDenied(path.into()),
        Some(libc::ENOENT | libc::ENXIO | libc::ENODEV | libc::EIO) => OpenError::Missing(path.into()),
        _ => other(path, &error.to_string()),
    })?;
    if rustix::termios::isatty(&file) { Ok(()) } else { Err(OpenError::NotATerminal(path.into())) }
}

fn other(path: &Path, reason: &str) -> OpenError {
    OpenError::Other { path: path.into(), reason: reason.to_owned() }
}
