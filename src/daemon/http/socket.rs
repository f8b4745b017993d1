//! The control sockets in the file system: their paths, and what can be wrong with them.
//! `tests/check_start.rs` and `tests/signals.rs` show what can be wrong.

use std::ffi::OsString;
use std::io::ErrorKind;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{Access, access};
use tokio::net::{UnixListener, UnixStream};

use crate::output::directory_of;

/// Longest path of a Unix socket, bytes: `sun_path` holds 108 with the zero at its end.
pub(crate) const MAX_PATH_BYTES: usize = 107;
/// Suffix of the socket for aborts.
const ABORT_SUFFIX: &str = ".abort";

/// Why a socket cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// A process serves this socket.
    #[error("another layerd already serves {}: stop it first, or give this one another `socket`", .0.display())]
    AlreadyRunning(PathBuf),
    /// Something else is in the way.
    #[error("{} exists and is not a socket: remove it, or give layerd another `socket`", .0.display())]
    NotASocket(PathBuf),
    /// The path is longer than a socket's may be.
    #[error(
        "the control socket {} has a path of {} bytes; at most {} are possible: give layerd a shorter `socket`",
        path.display(), path.as_os_str().len(), MAX_PATH_BYTES - ABORT_SUFFIX.len()
    )]
    PathTooLong {
        /// The socket.
        path: PathBuf,
    },
    /// Its directory does not exist.
    #[error("the control socket's directory {} does not exist: make it, or give layerd another `socket`", .0.display())]
    NoDirectory(PathBuf),
    /// This user may not write in its directory.
    #[error(
        "this user may not make the control socket in {}: give the directory to the user layerd runs as, or give layerd \
         another `socket`", .0.display()
    )]
    NotWritable(PathBuf),
    /// The system refused.
    #[error("cannot serve the control socket {}: {source}", path.display())]
    Io {
        /// The socket.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// The socket for aborts that belongs to a control socket: beside it, `control.sock.abort`.
pub fn abort_path(socket: &Path) -> PathBuf {
    let mut path = socket.as_os_str().to_owned();
    path.push(ABORT_SUFFIX);
    path.into()
}

/// Checks that a control socket could be made at `socket`, without making it. A socket that is being served is no error.
///
/// # Errors
/// [`BindError`] says what is in the way.
pub(crate) fn check(socket: &Path) -> Result<(), BindError> {
    if abort_path(socket).as_os_str().len() > MAX_PATH_BYTES {
        return Err(BindError::PathTooLong { path: socket.into() });
    }
    let directory = directory_of(socket);
    if !directory.is_dir() {
        return Err(BindError::NoDirectory(directory.into()));
    }
    match access(directory, Access::WRITE_OK | Access::EXEC_OK) {
        Ok(()) => {}
        Err(rustix::io::Errno::ACCESS | rustix::io::Errno::ROFS) => {
            return Err(BindError::NotWritable(directory.into()));
        }
        Err(error) => return Err(BindError::Io { path: socket.into(), source: error.into() }),
    }
    for path in [socket.to_path_buf(), abort_path(socket)] {
        match std::fs::symlink_metadata(&path) {
            Ok(found) if !found.file_type().is_socket() => return Err(BindError::NotASocket(path)),
            Err(source) if source.kind() != ErrorKind::NotFound => return Err(BindError::Io { path, source }),
            _ => {}
        }
    }
    Ok(())
}

/// Opens the control socket and the one for aborts, with mode 0660. Replaces sockets that no process serves.
///
/// # Errors
/// [`BindError`] says what is in the way.
pub async fn bind(socket: &Path) -> Result<[UnixListener; 2], BindError> {
    check(socket)?;
    let aborts = abort_path(socket);
    for path in [socket, &aborts] {
        match UnixStream::connect(path).await {
            // `WouldBlock`: its queue is full, so a process serves it.
            Ok(_) => return Err(BindError::AlreadyRunning(path.into())),
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Err(BindError::AlreadyRunning(path.into())),
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
                tracing::info!(socket = %path.display(), "replacing a socket that nobody serves");
            }
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(source) => return Err(BindError::Io { path: path.into(), source }),
        }
    }
    Ok([listen(socket)?, listen(&aborts)?])
}

fn listen(path: &Path) -> Result<UnixListener, BindError> {
    let io = |source| BindError::Io { path: path.into(), source };
    // Made under a passing name, then renamed when its mode is set: the socket is never open to all and never missing. The
    // passing name goes through /proc/self/fd, as beside a long path it would exceed the limit of a socket's path.
    let directory = std::fs::File::open(directory_of(path)).map_err(io)?;
    let mut name = OsString::from(".layerd-");
    name.push(std::process::id().to_string());
    let new = PathBuf::from(format!("/proc/self/fd/{}", directory.as_raw_fd())).join(&name);
    let _ = std::fs::remove_file(&new);
    let listener = UnixListener::bind(&new).map_err(io)?;
    let named = std::fs::set_permissions(&new, std::fs::Permissions::from_mode(0o660))
        .and_then(|()| std::fs::rename(&new, path));
    named.map_err(|source| {
        let _ = std::fs::remove_file(&new);
        io(source)
    })?;
    Ok(listener)
}
