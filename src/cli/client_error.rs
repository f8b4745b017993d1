//! Why a request to the daemon failed. Each text says what to do. `tests/cli.rs` and `tests/operator` show the texts.

use std::path::{Path, PathBuf};

use crate::config::DEFAULT_SOCKET;
use crate::daemon::http::socket::MAX_PATH_BYTES;

/// Why a request to the daemon failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No process listens on the socket.
    #[error("no layerd answers at {}: {}, or {}", socket.display(), start_text(socket), other_text(socket))]
    NoDaemon {
        /// The socket.
        socket: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// This user may not open the socket.
    #[error("the control socket {} may not be opened: join its group (usermod -aG layerd USER) or use sudo", socket.display())]
    NotAllowed {
        /// The socket.
        socket: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The socket's path is too long.
    #[error(
        "the path of the control socket, {}, has {} bytes, but the system allows {MAX_PATH_BYTES}: set `socket` in \
         layerd.toml to a shorter path, and --socket or LAYERD_SOCKET to the same",
        socket.display(), socket.as_os_str().len()
    )]
    SocketPath {
        /// The socket.
        socket: PathBuf,
    },
    /// A process listens on the socket, but did not answer in time.
    #[error(
        "layerd at {} did not answer within {waited_s} s: it is stopped or hangs.{consequence} {}; after a new start a print \
         under way can be resumed",
        socket.display(), restart_text(socket)
    )]
    Silent {
        /// The socket.
        socket: PathBuf,
        /// Time limit that has passed, seconds.
        waited_s: u64,
        /// What this means for the request; begins with a space, or is empty.
        consequence: &'static str,
    },
    /// The daemon refused; the text is its own.
    #[error("{message}")]
    Refused {
        /// HTTP status.
        status: u16,
        /// What is wrong and what to do.
        message: String,
    },
    /// The connection broke, or the answer is not understood.
    #[error("the daemon broke off: {0}")]
    Broken(String),
    /// The build file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Part {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// How to start the daemon of this socket. The default socket belongs to the service.
pub(super) fn start_text(socket: &Path) -> &'static str {
    if socket == Path::new(DEFAULT_SOCKET) {
        "start it (systemctl start layerd)"
    } else {
        "start it (layerd --config FILE)"
    }
}

/// How to name the socket of another daemon. The default socket means that none was named.
fn other_text(socket: &Path) -> &'static str {
    if socket == Path::new(DEFAULT_SOCKET) {
        "name the socket of one that was started by hand (`export LAYERD_SOCKET=PATH`, where PATH is its `socket` in layerd.toml)"
    } else {
        "name the socket of another one (--socket PATH or LAYERD_SOCKET=PATH)"
    }
}

/// Where to look for the reason when a daemon hangs, and how to restart it.
fn restart_text(socket: &Path) -> &'static str {
    if socket == Path::new(DEFAULT_SOCKET) {
        "Its log may tell why (journalctl -u layerd). Start it again with `systemctl restart layerd`"
    } else {
        "Its log may tell why. End it, and start it again with `layerd --config FILE`"
    }
}

impl ClientError {
    /// [`ClientError::Broken`] with the text of another error.
    pub(super) fn broken(error: impl std::fmt::Display) -> Self {
        Self::Broken(error.to_string())
    }
}
