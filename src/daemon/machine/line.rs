//! The printer's end of the line to the device. `printer/session.rs` takes its events.

use std::sync::Arc;

use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use crate::config::Machine;
use crate::link::Ports;
use crate::link::driver::{LinkEvent, LinkHandle, link};
use crate::link::message::{HostMessage, Urgent};
use crate::link::session::{Hindrance, HostEvent, LostReason, Statistics};

/// Events from the line, and messages to it.
pub(crate) struct LineHandle {
    handle: LinkHandle,
    events: mpsc::Receiver<LinkEvent>,
    task: JoinHandle<()>,
    session_id: Option<u32>,
    piece_bytes: usize,
    /// Number of the newest urgent frame.
    last_urgent: u32,
    /// What kept data from getting through when the last session was ended from here, until the next one begins.
    hindered: Option<Hindrance>,
}

impl LineHandle {
    /// Starts the task that opens the port and keeps a session with the device until [`LineHandle::close`].
    pub(crate) fn start(machine: &Machine, ports: Arc<dyn Ports>) -> Self {
        let (handle, events, driver) = link(machine.link().clone(), machine.grbl(), ports);
        Self {
            handle,
            events,
            task: tokio::spawn(driver.run()),
            session_id: None,
            piece_bytes: 0,
            last_urgent: 0,
            hindered: None,
        }
    }

    /// The next event of the line. Cancel-safe.
    pub(crate) async fn next_event(&mut self) -> Option<LinkEvent> {
        let event = self.events.recv().await;
        match &event {
            Some(LinkEvent::Session(HostEvent::Connected { session_id, largest_layer_data_bytes, .. })) => {
                self.session_id = Some(*session_id);
                self.piece_bytes = *largest_layer_data_bytes;
                self.hindered = None;
            }
            Some(LinkEvent::Session(HostEvent::Message(_) | HostEvent::UrgentDone { .. })) => {}
            _ => self.session_id = None,
        }
        event
    }

    /// Waits until [`LineHandle::send`] has room for a message. The future does not borrow `self`.
    pub(crate) fn room(&self) -> impl Future<Output = ()> + use<> {
        let handle = self.handle.clone();
        async move { handle.room().await }
    }

    /// Sends a message in the present session. Without a session the message is dropped; without room (see [`LineHandle::room`]) too,
    /// with an error in the log.
    pub(crate) fn send(&self, message: HostMessage) {
        if let Some(session_id) = self.session_id
            && self.handle.try_send(session_id, message).is_err()
        {
            tracing::error!("a message found no room on the line");
        }
    }

    /// Sends an urgent frame ahead of everything else. Returns its number, which the device's answer repeats. If too many are
    /// unanswered, returns the newest one's.
    pub(crate) fn urgent(&mut self, urgent: Urgent) -> u32 {
        if let Ok(number) = self.handle.urgent(urgent) {
            self.last_urgent = number;
        }
        self.last_urgent
    }

    /// Why a session ended, as operators read it. A device that was heard a moment ago is switched on: what kept data from getting
    /// through then also keeps a new session from beginning.
    pub(crate) fn lost_text(&self, reason: LostReason) -> String {
        match (reason, self.hindered) {
            (LostReason::NoAnswer { garbage_frames: 0 }, Some(hindrance)) => {
                format!("{hindrance}; a new session has no answer either")
            }
            _ => reason.to_string(),
        }
    }

    /// Ends the session and begins a new one at once.
    pub(crate) fn reconnect(&mut self) {
        self.hindered = self.hindrance().or(self.hindered);
        self.session_id = None;
        self.handle.renew();
    }

    /// Ends a session that cannot go on; the next begins after a pause.
    pub(crate) fn give_up(&mut self) {
        self.hindered = self.hindrance().or(self.hindered);
        self.session_id = None;
        self.handle.give_up();
    }

    /// Best size of a piece of layer data, bytes.
    pub(crate) fn piece_bytes(&self) -> usize {
        self.piece_bytes
    }

    /// What keeps data from getting through in the present session.
    pub(crate) fn hindrance(&self) -> Option<Hindrance> {
        self.handle.hindrance(self.session_id?)
    }

    /// What the line carried since the start.
    pub(crate) fn statistics(&self) -> Statistics {
        self.handle.statistics()
    }

    /// Share of the time with data to send in which the line was busy, 0 to 1.
    pub(crate) fn busy_share(&self) -> Option<f64> {
        self.handle.busy_share()
    }

    /// Ends the task.
    pub(crate) async fn close(self) {
        drop(self.handle);
        drop(self.events);
        // Without handle and receiver it ends by itself. A panic in it was reported when it happened.
        let _ = self.task.await;
    }
}
