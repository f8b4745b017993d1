//! Who gives an order: the process at the other end of a Unix socket, as the kernel reports it (`SO_PEERCRED`).
//! `tests/daemon_log.rs` shows it in the log.

use std::fmt;

use tokio::net::UnixStream;

/// The process at the other end of a control connection, as it was when it connected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Caller {
    /// Its user id; `None` if the system does not report it.
    pub uid: Option<u32>,
    /// Its process id; `None` if the system does not report it or the process lives in another namespace.
    pub pid: Option<i32>,
}

impl Caller {
    /// The process that opened this connection.
    pub(crate) fn of(stream: &UnixStream) -> Self {
        let Ok(credentials) = stream.peer_cred() else { return Self::default() };
        Self { uid: Some(credentials.uid()), pid: credentials.pid().filter(|pid| *pid > 0) }
    }
}

/// `uid 1000, pid 4242`. Numbers only: looking up the user's name reads a disk, and a disk that hangs would delay an abort.
impl fmt::Display for Caller {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.uid {
            Some(uid) => write!(f, "uid {uid}")?,
            None => f.write_str("an unknown user")?,
        }
        self.pid.map_or(Ok(()), |pid| write!(f, ", pid {pid}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_caller_is_shown_by_its_numbers() {
        assert_eq!(Caller { uid: Some(1000), pid: Some(7) }.to_string(), "uid 1000, pid 7");
        assert_eq!(Caller { uid: Some(0), pid: None }.to_string(), "uid 0");
        assert_eq!(Caller::default().to_string(), "an unknown user");
    }
}
