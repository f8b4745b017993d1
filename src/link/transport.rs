//! The serial port or pseudo-terminal: 8N1, raw, exclusive to one process.
//!
//! Linux raises DTR and RTS at the first open of a port, and lowers them at the last close if HUPCL is set. Many boards reset
//! when DTR rises. So the port is opened once, HUPCL is cleared, and neither line is touched. [`driver`](super::driver) opens it.

use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::sys::termios::{ControlFlags, InputFlags, SetArg, tcgetattr, tcsetattr};
use serialport::{ErrorKind, SerialPort};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio_serial::{SerialPortBuilderExt, SerialStream};

use super::settings::{FlowControl, LinkSettings};
use crate::text::shell_word;

/// Tolerance of the line rate. Beyond it, a receiver samples the last bit of a byte wrongly.
const RATE_TOLERANCE_PERCENT: u64 = 3;

/// EHWPOISON, the highest error number of Linux.
const LAST_ERRNO: i32 = 133;

/// A port that could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Nothing there.
    #[error("{}: no such port; is the device connected and switched on? (ls /dev/serial/by-id)", .0.display())]
    Missing(PathBuf),
    /// Another process has it.
    #[error("{}: in use by another program (find it with: fuser {})", .0.display(), shell_word(&.0.to_string_lossy()))]
    InUse(PathBuf),
    /// Not a port.
    #[error("{}: not a serial port or pseudo-terminal", .0.display())]
    NotATerminal(PathBuf),
    /// The file's owner, group and mode forbid it (EACCES).
    #[error("{}: permission denied; {remedy}", path.display())]
    PermissionDenied {
        /// The port.
        path: PathBuf,
        /// What to do about it.
        remedy: String,
    },
    /// The systemd unit or the container forbids devices of this kind (EPERM).
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
    /// The port does not support a setting of the machine file.
    #[error("{}: the port does not take {key} = {wanted}{found}: correct `{key}` in the machine's file, or use another adapter", path.display())]
    Unsuited {
        /// The port.
        path: PathBuf,
        /// The key in the file.
        key: &'static str,
        /// The value in the file.
        wanted: String,
        /// What the port has instead, if it says so.
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

/// Where ports come from: the operating system, or a simulation.
pub trait Ports: std::fmt::Debug + Send + Sync {
    /// Opens the port that the settings name; a symbolic link is followed anew each time. Called inside a tokio runtime.
    ///
    /// # Errors
    /// [`OpenError`] names the port and what to do.
    fn open(&self, settings: &LinkSettings) -> Result<SerialLine, OpenError>;

    /// Device number of the port that a path leads to now, through symbolic links; `None` if there is none.
    fn at(&self, path: &Path) -> Option<u64>;
}

/// The ports of the operating system.
#[derive(Clone, Copy, Debug)]
pub struct SystemPorts;

impl Ports for SystemPorts {
    fn open(&self, settings: &LinkSettings) -> Result<SerialLine, OpenError> {
        SerialLine::open(settings)
    }

    fn at(&self, path: &Path) -> Option<u64> {
        std::fs::metadata(path).ok().map(|metadata| metadata.rdev())
    }
}

/// An open port. Dropping it closes it. Both halves work at the same time: a device that accepts no data must still be heard.
pub struct SerialLine {
    /// From the device.
    pub reader: LineReader,
    /// To the device.
    pub writer: LineWriter,
}

impl std::fmt::Debug for SerialLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SerialLine")
    }
}

/// The half that reads.
pub struct LineReader(Box<dyn AsyncRead + Send + Unpin>);

/// The half that writes.
pub struct LineWriter(Box<dyn AsyncWrite + Send + Unpin>);

impl SerialLine {
    /// Opens the port; a symbolic link is followed anew each time. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`OpenError`] names the port and what to do.
    pub fn open(config: &LinkSettings) -> Result<Self, OpenError> {
        let path = &config.path;
        let major = major_of_device(path)?;
        let name = path.to_str().ok_or_else(|| other(path, "the path is not UTF-8"))?;
        // The library claims the port with TIOCEXCL, then with flock, and releases both when the port is dropped. TIOCEXCL does not
        // stop root. If flock then refuses root, the library also clears the TIOCEXCL of the other program.
        let builder = serialport::new(name, config.baud).flow_control(match config.flow_control {
            FlowControl::None => serialport::FlowControl::None,
            FlowControl::RtsCts => serialport::FlowControl::Hardware,
            FlowControl::XonXoff => serialport::FlowControl::Software,
        });
        let stream = builder.open_native_async().map_err(|error| port_error(config, major, &error))?;
        clear_modes(&stream).map_err(|errno| open_error(path, major, errno))?;
        // Setup succeeds even if the port takes only some of the settings.
        let baud = stream.baud_rate().map_err(|error| port_error(config, major, &error))?;
        let flow_control = stream.flow_control().map_err(|error| port_error(config, major, &error))?;
        check_taken(config, baud, flow_control)?;
        let (reader, writer) = tokio::io::split(stream);
        Ok(Self::new(reader, writer))
    }

    /// A line of two streams.
    pub fn new(
        reader: impl AsyncRead + Send + Unpin + 'static,
        writer: impl AsyncWrite + Send + Unpin + 'static,
    ) -> Self {
        Self { reader: LineReader(Box::new(reader)), writer: LineWriter(Box::new(writer)) }
    }
}

impl LineReader {
    /// Reads the available bytes, at least one. Cancel safe.
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
    /// Writes some of `bytes`, at least one. Cancel safe.
    ///
    /// # Errors
    /// The port vanished or its other end closed; open it again.
    pub async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes).await
    }
}

/// The major number of the character device at `path`. Anything else is refused before it is opened, because opening alone can have
/// effects: it wakes the reader of a named pipe.
fn major_of_device(path: &Path) -> Result<u32, OpenError> {
    let metadata = std::fs::metadata(path).map_err(|error| match error.raw_os_error() {
        Some(number) => open_error(path, 0, Errno::from_i32(number)),
        None => other(path, &error.to_string()),
    })?;
    if metadata.file_type().is_char_device() {
        Ok(rustix::fs::major(metadata.rdev()))
    } else {
        Err(OpenError::NotATerminal(path.into()))
    }
}

/// Clears modes that the library leaves as an earlier program set them: HUPCL, and IXANY, with which any byte ends an XOFF.
fn clear_modes(stream: &SerialStream) -> Result<(), Errno> {
    let mut modes = tcgetattr(stream.as_raw_fd())?;
    modes.control_flags -= ControlFlags::HUPCL;
    modes.input_flags -= InputFlags::IXANY;
    tcsetattr(stream.as_raw_fd(), SetArg::TCSANOW, &modes)
}

/// Compares the settings of the port with those of the machine file.
fn check_taken(config: &LinkSettings, baud: u32, flow_control: serialport::FlowControl) -> Result<(), OpenError> {
    let (path, wanted) = (&config.path, config.baud);
    if u64::from(baud.abs_diff(wanted)) * 100 > u64::from(wanted) * RATE_TOLERANCE_PERCENT {
        return Err(unsuited(path, "baud", wanted.to_string(), format!(", but has {baud}")));
    }
    if config.flow_control == FlowControl::RtsCts && flow_control != serialport::FlowControl::Hardware {
        return Err(unsuited(path, "flow_control", "\"rts_cts\"".into(), String::new()));
    }
    Ok(())
}

/// What an error of the serial library means.
fn port_error(config: &LinkSettings, major: u32, error: &serialport::Error) -> OpenError {
    let path = &config.path;
    match error.kind() {
        // The library's error for EBUSY and for a lock that another program holds.
        ErrorKind::NoDevice => return OpenError::InUse(path.clone()),
        ErrorKind::InvalidInput => return unsuited(path, "baud", config.baud.to_string(), String::new()),
        _ => {}
    }
    // The kind is `Unknown` for most errors; only the text identifies them.
    match (1..=LAST_ERRNO).map(Errno::from_i32).find(|errno| errno.desc() == error.description) {
        // Some devices (hidraw, evdev) answer a terminal's ioctl with this. A terminal never does so for a rate.
        Some(Errno::EINVAL) => OpenError::NotATerminal(path.clone()),
        Some(errno) => open_error(path, major, errno),
        None => other(path, &error.description),
    }
}

fn open_error(path: &Path, major: u32, errno: Errno) -> OpenError {
    match errno {
        Errno::ENOENT | Errno::ENOTDIR | Errno::ENXIO | Errno::ENODEV | Errno::EIO => OpenError::Missing(path.into()),
        Errno::EBUSY | Errno::EWOULDBLOCK => OpenError::InUse(path.into()),
        Errno::EACCES => denied(path),
        Errno::EPERM => OpenError::Forbidden { path: path.into(), major },
        Errno::ENOTTY => OpenError::NotATerminal(path.into()),
        errno => other(path, &io::Error::from(errno).to_string()),
    }
}

/// A port that this user may not open.
pub(crate) fn denied(path: &Path) -> OpenError {
    let port = std::fs::metadata(path).ok().filter(|metadata| metadata.file_type().is_char_device());
    let groups = std::fs::read_to_string("/etc/group").unwrap_or_default();
    let group = port.and_then(|metadata| {
        let takes_group = metadata.mode() & 0o060 == 0o060 && !is_pseudo_terminal(rustix::fs::major(metadata.rdev()));
        takes_group.then(|| group_name(&groups, metadata.gid())).flatten()
    });
    OpenError::PermissionDenied { path: path.into(), remedy: remedy(path, group.as_deref()) }
}

/// Membership helps only in a group that is made for ports. A pseudo-terminal belongs to the user who opened it.
fn remedy(path: &Path, group: Option<&str>) -> String {
    match group {
        Some(group) => format!("add this user to the group {group} (usermod -aG {group} USER) and log in again"),
        None => format!(
            "let the user layerd runs as read and write it, or run layerd as its owner (ls -lL {} shows owner, group and mode)",
            shell_word(&path.to_string_lossy())
        ),
    }
}

/// Whether a major number is that of a pseudo-terminal on Linux.
fn is_pseudo_terminal(major: u32) -> bool {
    (136..=143).contains(&major)
}

/// The name of a group in the text of `/etc/group`; `None` for root's group, which nobody should join.
fn group_name(groups: &str, gid: u32) -> Option<String> {
    let is_it = |line: &&str| gid != 0 && line.split(':').nth(2).is_some_and(|field| field.parse() == Ok(gid));
    groups.lines().find(is_it)?.split(':').next().map(str::to_owned)
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
    use crate::link::Protocol;

    /// The message for an error number that the library reports. A test that runs as root cannot provoke most of them.
    fn told(errno: Errno) -> String {
        let config = LinkSettings {
            path: "/dev/ttyUSB0".into(),
            baud: 250_000,
            flow_control: FlowControl::RtsCts,
            protocol: Protocol::Layerd,
        };
        port_error(&config, 188, &serialport::Error::from(errno)).to_string()
    }

    #[test]
    fn what_the_unit_forbids_is_told_from_what_the_group_forbids() {
        let unit = told(Errno::EPERM);
        assert!(unit.contains("DeviceAllow=char-188 rw") && !unit.contains("dialout"), "{unit}");
        let denied = told(Errno::EACCES);
        assert!(denied.contains("permission denied") && !denied.contains("DeviceAllow"), "{denied}");
    }

    #[test]
    fn a_group_is_named_only_where_joining_it_helps() {
        let groups = "root:x:0:\ntty:x:5:\ndialout:x:20:ann,ben\n";
        assert_eq!(group_name(groups, 20).as_deref(), Some("dialout"));
        assert_eq!((group_name(groups, 0), group_name(groups, 21)), (None, None));
        let told = remedy(Path::new("/dev/ttyUSB0"), Some("dialout"));
        assert!(told.contains("usermod -aG dialout USER"), "{told}");
        let pair = rustix::pty::openpt(rustix::pty::OpenptFlags::RDWR | rustix::pty::OpenptFlags::NOCTTY).unwrap();
        let pseudo_terminal = rustix::pty::ptsname(&pair, Vec::new()).unwrap().into_string().unwrap();
        let file = tempfile::NamedTempFile::with_prefix("a port").unwrap();
        for path in [Path::new(&pseudo_terminal), file.path()] {
            let told = denied(path).to_string();
            assert!(told.contains("run layerd as its owner") && !told.contains("usermod"), "{told}");
        }
        assert!(denied(file.path()).to_string().contains("ls -lL '/"), "a path with a space is quoted");
    }

    #[test]
    fn errors_of_the_serial_library_keep_their_meaning() {
        for errno in [Errno::ENOENT, Errno::ENXIO, Errno::ENODEV, Errno::EIO] {
            assert!(told(errno).contains("no such port"), "{errno}");
        }
        for errno in [Errno::ENOTTY, Errno::EINVAL] {
            assert!(told(errno).contains("not a serial port"), "{errno}");
        }
        assert!(told(Errno::EBUSY).contains("in use by another program"));
        assert!(told(Errno::EMFILE).contains("os error 24"), "{}", told(Errno::EMFILE));
    }

    #[test]
    fn a_port_that_takes_only_a_part_is_refused() {
        use serialport::FlowControl::{Hardware, None};
        let config = LinkSettings {
            path: "/dev/ttyUSB0".into(),
            baud: 250_000,
            flow_control: FlowControl::RtsCts,
            protocol: Protocol::Layerd,
        };
        let refused = |baud, flow_control| check_taken(&config, baud, flow_control).expect_err("refused").to_string();
        assert!(check_taken(&config, 257_500, Hardware).is_ok() && check_taken(&config, 242_500, Hardware).is_ok());
        assert!(refused(9600, Hardware).contains("does not take baud = 250000, but has 9600"));
        assert!(refused(257_501, Hardware).contains("but has 257501"));
        assert!(refused(250_000, None).contains("does not take flow_control = \"rts_cts\""));
    }
}
