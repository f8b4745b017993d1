//! Errors of a conversation with the daemon, and what each text tells the operator to do.

use std::path::{Path, PathBuf};

use crate::config::DEFAULT_SOCKET;
use crate::daemon::socket::MAX_PATH_BYTES;

/// Why the daemon could not be asked.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// Nobody listens.
    #[error(
        "no layerd answers at {}: {}, or name the socket of another one (--socket PATH or LAYERD_SOCKET=PATH)",
        socket.display(), start_text(socket)
    )]
    NoDaemon {
        /// The socket.
        socket: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The socket may not be opened.
    #[error("the control socket {} may not be opened: join its group (usermod -aG layerd USER) or use sudo", socket.display())]
    NotAllowed {
        /// The socket.
        socket: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The socket's path cannot be used.
    #[error(
        "the path of the control socket, {}, has {} bytes, but the system allows {MAX_PATH_BYTES}: set `socket` in \
         layerd.toml to a shorter path, and --socket or LAYERD_SOCKET to the same",
        socket.display(), socket.as_os_str().len()
    )]
    SocketPath {
        /// The socket.
        socket: PathBuf,
    },
    /// Somebody listens and does not answer.
    #[error(
        "layerd at {} did not answer within {waited_s} s: it is stopped or hangs.{consequence} {}; after a new start a print \
         under way can be resumed",
        socket.display(), restart_text(socket)
    )]
    Silent {
        /// The socket.
        socket: PathBuf,
        /// How long it was waited for.
        waited_s: u64,
        /// What this means for what was asked, with a space in front; may be empty.
        consequence: &'static str,
    },
    /// The daemon says no; the text is its own.
    #[error("{message}")]
    Refused {
        /// HTTP status.
        status: u16,
        /// What is wrong and what to do.
        message: String,
    },
    /// The conversation broke off.
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

/// How the daemon of a socket is started: the service has the usual one.
pub(super) fn start_text(socket: &Path) -> &'static str {
    if socket == Path::new(DEFAULT_SOCKET) {
        "start it (systemctl start layerd)"
    } else {
        "start it (layerd --config FILE)"
    }
}

/// Where a daemon that hangs may tell why, and how it is started anew.
fn restart_text(socket: &Path) -> &'static str {
    if socket == Path::new(DEFAULT_SOCKET) {
        "Its log may tell why (journalctl -u layerd). Start it anew with `systemctl restart layerd`"
    } else {
        "Its log may tell why. End it, and start it anew with `layerd --config FILE`"
    }
}

impl ClientError {
    /// [`ClientError::Broken`] with the text of another error.
    pub(super) fn broken(error: impl std::fmt::Display) -> Self {
        Self::Broken(error.to_string())
    }
}
