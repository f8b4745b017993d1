//! What the line carries: the framed protocol, or lines for a grbl controller. [`driver`](super::driver) runs either on a port.

use layerd_wire::session::{SendError, Statistics};

use super::grbl::{GrblMachine, GrblSession};
use super::message::{HostMessage, Urgent};
use super::session::{Hindrance, HostEvent, HostSession, HostSettings};

/// A session of either kind.
#[derive(Debug)]
pub(super) enum Conversation {
    Framed(Box<HostSession>),
    Grbl(Box<GrblSession>),
}

/// The same call of a session of either kind.
macro_rules! either {
    ($conversation:expr, $session:ident => $call:expr) => {
        match $conversation {
            Conversation::Framed($session) => $call,
            Conversation::Grbl($session) => $call,
        }
    };
}

impl Conversation {
    /// Begins with a hello, or by listening to the controller of `grbl`. The ids are random.
    pub(super) fn new(session_id: u32, boot_id: u32, settings: HostSettings, grbl: Option<GrblMachine>) -> Self {
        match grbl {
            None => Self::Framed(Box::new(HostSession::new(session_id, settings, 0))),
            Some(machine) => Self::Grbl(Box::new(GrblSession::new(session_id, boot_id, machine, 0))),
        }
    }

    /// Begins the next session.
    pub(super) fn renew(&mut self, session_id: u32, now_us: u64) {
        match self {
            Self::Framed(session) => **session = session.successor(session_id, now_us),
            Self::Grbl(session) => session.begin(session_id, now_us),
        }
    }

    pub(super) fn receive(&mut self, bytes: &[u8], now_us: u64) {
        either!(self, session => session.receive(bytes, now_us));
    }

    pub(super) fn transmit(&mut self, now_us: u64) -> Option<Vec<u8>> {
        either!(self, session => session.transmit(now_us))
    }

    pub(super) fn next_timeout_us(&self) -> Option<u64> {
        either!(self, session => session.next_timeout_us())
    }

    pub(super) fn handle_timeout(&mut self, now_us: u64) {
        either!(self, session => session.handle_timeout(now_us));
    }

    pub(super) fn event(&mut self) -> Option<HostEvent> {
        either!(self, session => session.event())
    }

    pub(super) fn send(&mut self, message: &HostMessage) -> Result<(), SendError> {
        either!(self, session => session.send(message))
    }

    pub(super) fn send_urgent(&mut self, number: u32, urgent: Urgent, now_us: u64) {
        either!(self, session => session.send_urgent(number, urgent, now_us));
    }

    pub(super) fn is_pressing(&self) -> bool {
        either!(self, session => session.is_pressing())
    }

    pub(super) fn session_id(&self) -> u32 {
        either!(self, session => session.session_id())
    }

    pub(super) fn has_unsent(&self) -> bool {
        either!(self, session => session.has_unsent())
    }

    pub(super) fn statistics(&self) -> Statistics {
        either!(self, session => session.statistics())
    }

    /// A grbl controller acknowledges no bytes; a session with one that takes no lines ends.
    pub(super) fn hindrance(&self) -> Option<Hindrance> {
        match self {
            Self::Framed(session) => session.hindrance(),
            Self::Grbl(_) => None,
        }
    }
}
