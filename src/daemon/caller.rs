//! Who gives an order, as the kernel tells it of the other end of a Unix socket (`SO_PEERCRED`).

use std::fmt;
use std::io::Read;

use tokio::net::UnixStream;

/// `/etc/passwd` is read no further.
const LARGEST_USERS_BYTES: u64 = 1 << 20;

/// The process at the other end of a control connection, as it was when it connected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Caller {
    /// Its user; `None` where the system does not tell.
    pub uid: Option<u32>,
    /// Its number; `None` where the system does not tell, or the process lives in another namespace.
    pub pid: Option<i32>,
}

impl Caller {
    /// Who has connected.
    pub(super) fn of(stream: &UnixStream) -> Self {
        let Ok(credentials) = stream.peer_cred() else { return Self::default() };
        Self { uid: Some(credentials.uid()), pid: credentials.pid().filter(|pid| *pid > 0) }
    }
}

/// `uid 1000 (anna), pid 4242`.
impl fmt::Display for Caller {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.uid {
            Some(uid) => match user_name(uid) {
                Some(name) => write!(f, "uid {uid} ({name})")?,
                None => write!(f, "uid {uid}")?,
            },
            None => f.write_str("an unknown user")?,
        }
        self.pid.map_or(Ok(()), |pid| write!(f, ", pid {pid}"))
    }
}

/// A user's name, as far as `/etc/passwd` knows it: other sources may take long to ask.
fn user_name(uid: u32) -> Option<String> {
    let mut users = String::new();
    std::fs::File::open("/etc/passwd").ok()?.take(LARGEST_USERS_BYTES).read_to_string(&mut users).ok()?;
    users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let (name, number) = (fields.next()?, fields.nth(1)?);
        (number.parse() == Ok(uid)).then(|| name.to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_caller_is_told_by_number_and_name() {
        assert_eq!(Caller { uid: Some(0), pid: Some(7) }.to_string(), "uid 0 (root), pid 7");
        assert_eq!(Caller { uid: Some(4_000_000_000), pid: None }.to_string(), "uid 4000000000");
        assert_eq!(Caller::default().to_string(), "an unknown user");
    }
}
