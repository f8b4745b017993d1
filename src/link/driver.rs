//! The task that connects a host session to its port: paces bytes, keeps timers, reopens the port and begins new sessions.
//! `tests/link_port.rs` runs it on a pseudo-terminal.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{Notify, mpsc};
use tokio::time::{Instant, sleep_until};

use layerd_wire::session::MAX_URGENTS;

use super::settings::{FlowControl, LinkSettings};
use crate::random;

use super::conversation::Conversation;
use super::grbl::GrblMachine;
use super::message::{HostMessage, Urgent};
use super::pacing::Pacing;
use super::session::{HELLO_REPEAT_US, Hindrance, HostEvent, HostSettings, SendError, Statistics};
use super::spacing::Spacing;
use super::transport::{OpenError, Ports, SerialLine};

/// Events that the owner has not taken. When the queue is full, credit holds the device back.
const EVENT_QUEUE: usize = 64;
/// Bytes read at once: the size of the system's terminal buffer.
const READ_BYTES: usize = 4096;

/// What the task reports to the owner of the line.
#[derive(Debug)]
pub enum LinkEvent {
    /// From the session.
    Session(HostEvent),
    /// The port could not be opened; it is tried again. Reported once for each reason.
    NotOpen(OpenError),
    /// The port failed and is reopened. A session is lost.
    PortFailed(io::Error),
    /// A message was not sent because it is longer than `Connected` allows: an error of the owner.
    NotSent(SendError),
}

/// The owner's handle of the line. Clones share the line.
#[derive(Clone, Debug)]
pub struct LinkHandle {
    messages: mpsc::Sender<(u32, HostMessage)>,
    urgents: mpsc::Sender<(u32, Urgent)>,
    shared: Arc<Shared>,
}

/// What handle and task share besides the queues.
#[derive(Debug, Default)]
struct Shared {
    statistics: Mutex<Statistics>,
    busy_share: Mutex<Option<f64>>,
    /// Session id, and what hinders it.
    hindrance: Mutex<(u32, Option<Hindrance>)>,
    /// Number of the newest urgent order that was queued. Locked while one is queued, so that they are queued in ascending order.
    last_urgent: Mutex<u32>,
    renew: Notify,
    give_up: Notify,
}

/// The line takes nothing now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the line takes nothing now")]
pub struct NoRoom;

impl LinkHandle {
    /// Waits until [`Self::try_send`] would take a message, or the task has ended. Cancel safe.
    pub async fn room(&self) {
        let _ = self.messages.reserve().await;
    }

    /// Queues a message for the session named by [`HostEvent::Connected`]. It is dropped if that session has ended. At most two
    /// windows and one message are queued.
    ///
    /// # Errors
    /// [`NoRoom`] if a message waits already or the task has ended.
    pub fn try_send(&self, session_id: u32, message: HostMessage) -> Result<(), NoRoom> {
        self.messages.try_send((session_id, message)).map_err(|_| NoRoom)
    }

    /// Sends an order that overtakes all messages. It is repeated, in new sessions too, until `UrgentDone` answers it. Returns its
    /// number, which the answer repeats. Numbers ascend from 1.
    ///
    /// # Errors
    /// [`NoRoom`] if too many wait already or the task has ended.
    pub fn urgent(&self, urgent: Urgent) -> Result<u32, NoRoom> {
        let mut last = self.shared.last_urgent.lock().unwrap_or_else(PoisonError::into_inner);
        let number = last.wrapping_add(1);
        self.urgents.try_send((number, urgent)).map_err(|_| NoRoom)?;
        *last = number;
        Ok(number)
    }

    /// Ends the present session and begins another, without a pause unless this is called too often. The end is not reported as
    /// [`HostEvent::Lost`].
    pub fn renew(&self) {
        self.shared.renew.notify_one();
    }

    /// Ends the present session because the device broke the protocol, or the owner lost track. The next one begins after a pause,
    /// as after a lost session; the pause grows from one such session to the next. The end is not reported as
    /// [`HostEvent::Lost`].
    pub fn give_up(&self) {
        self.shared.give_up.notify_one();
    }

    /// What keeps data of a session from getting through although the device is heard. Its text says what to do. A request
    /// without an answer may then not have reached the device.
    pub fn hindrance(&self, session_id: u32) -> Option<Hindrance> {
        let (of_session, hindrance) = *self.shared.hindrance.lock().unwrap_or_else(PoisonError::into_inner);
        hindrance.filter(|_| of_session == session_id)
    }

    /// Counts since the task began.
    pub fn statistics(&self) -> Statistics {
        *self.shared.statistics.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Share of the time with data to send during which the line was busy, 0 to 1; `None` before any data.
    pub fn busy_share(&self) -> Option<f64> {
        *self.shared.busy_share.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The task's end of the channels.
#[derive(Debug)]
pub struct LinkDriver {
    settings: LinkSettings,
    ports: Arc<dyn Ports>,
    start: Instant,
    session: Conversation,
    messages: mpsc::Receiver<(u32, HostMessage)>,
    urgents: mpsc::Receiver<(u32, Urgent)>,
    events: mpsc::Sender<LinkEvent>,
    shared: Arc<Shared>,
    /// Taken from its queue, waiting for room in the session's.
    waiting: Option<(u32, HostMessage)>,
    pacing: Pacing,
    spacing: Spacing,
}

/// Makes a line: its handle, its events, and its driver. [`LinkDriver::run`] moves the bytes. With `grbl`, the machine of a grbl
/// controller, lines of G-code are spoken.
pub fn link(
    settings: LinkSettings,
    grbl: Option<GrblMachine>,
    ports: Arc<dyn Ports>,
) -> (LinkHandle, mpsc::Receiver<LinkEvent>, LinkDriver) {
    let (message_sender, messages) = mpsc::channel(1);
    let (urgent_sender, urgents) = mpsc::channel(MAX_URGENTS);
    let (events, event_receiver) = mpsc::channel(EVENT_QUEUE);
    let shared = Arc::new(Shared::default());
    let handle = LinkHandle { messages: message_sender, urgents: urgent_sender, shared: Arc::clone(&shared) };
    let host_settings = HostSettings { baud: settings.baud, escaped: settings.flow_control == FlowControl::XonXoff };
    let driver = LinkDriver {
        pacing: Pacing::new(settings.baud),
        settings,
        ports,
        start: Instant::now(),
        session: Conversation::new(random_id(), random_id(), host_settings, grbl),
        messages,
        urgents,
        events,
        shared,
        waiting: None,
        spacing: Spacing::new(),
    };
    (handle, event_receiver, driver)
}

/// A random session id, so that it differs from those of earlier processes.
fn random_id() -> u32 {
    let bits = random::bits();
    (bits ^ (bits >> 32)) as u32
}

/// Why the inner loop ended.
enum Left {
    /// The session has ended, or was given up; the port is fine.
    Session,
    /// The owner wants a new session.
    Renewed,
    Port(io::Error),
    /// The configured path leads to another port now.
    Elsewhere,
    /// Every handle, or the receiver of events, was dropped.
    Owner,
}

impl LinkDriver {
    /// Runs until every [`LinkHandle`] or the receiver of events is dropped.
    pub async fn run(mut self) {
        let mut last_reason = String::new();
        loop {
            let line = match self.ports.open(&self.settings) {
                Ok(line) => line,
                Err(error) => {
                    let reason = error.to_string();
                    if reason != last_reason && self.events.send(LinkEvent::NotOpen(error)).await.is_err() {
                        return;
                    }
                    last_reason = reason;
                    if self.rest_after_failure().await {
                        return;
                    }
                    continue;
                }
            };
            last_reason.clear();
            self.pacing.reset();
            self.renew();
            let port = self.ports.at(&self.settings.path);
            match self.run_line(line, port).await {
                Left::Elsewhere => {}
                Left::Owner | Left::Session | Left::Renewed => return,
                Left::Port(error) => {
                    if self.events.send(LinkEvent::PortFailed(error)).await.is_err() || self.rest_after_failure().await
                    {
                        return;
                    }
                }
            }
        }
    }

    /// Runs sessions one after the other on the open port. Reopening the port would reset many boards.
    async fn run_line(&mut self, mut line: SerialLine, port: Option<u64>) -> Left {
        loop {
            self.forget_ends().await;
            match self.run_session(&mut line).await {
                Left::Session => {
                    if self.rest_after_failure().await {
                        return Left::Owner;
                    }
                    if self.ports.at(&self.settings.path).is_some_and(|now| port != Some(now)) {
                        return Left::Elsewhere;
                    }
                    self.renew();
                }
                Left::Renewed => {
                    let pause_us = self.spacing.renewed(self.now_us());
                    if self.rest(pause_us).await {
                        return Left::Owner;
                    }
                    self.renew();
                }
                left => return left,
            }
        }
    }

    /// Clears orders to end the session: it has ended, and they must not end the next one.
    async fn forget_ends(&self) {
        for order in [&self.shared.renew, &self.shared.give_up] {
            tokio::select! {
                biased;
                () = order.notified() => {}
                () = std::future::ready(()) => {}
            }
        }
    }

    fn renew(&mut self) {
        let now_us = self.now_us();
        self.session.renew(random_id(), now_us);
    }

    fn now_us(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    async fn rest_after_failure(&mut self) -> bool {
        let pause_us = self.spacing.failed(self.now_us());
        // Light, or an order to end it, does not wait for a long pause.
        let limit_us = if self.session.is_pressing() { HELLO_REPEAT_US } else { u64::MAX };
        self.rest(pause_us.min(limit_us)).await
    }

    /// Waits before the next try. Returns `true` when the owner is gone. Messages of the old session are dropped. An urgent order is
    /// kept and ends the pause: only a new session can carry it.
    async fn rest(&mut self, pause_us: u64) -> bool {
        self.waiting = None;
        if pause_us == 0 {
            return false;
        }
        let mut end = Instant::now() + Duration::from_micros(pause_us);
        loop {
            tokio::select! {
                biased;
                () = sleep_until(end) => return self.events.is_closed(),
                message = self.messages.recv() => if message.is_none() {
                    return true;
                },
                urgent = self.urgents.recv() => match urgent {
                    Some((number, urgent)) => {
                        self.session.send_urgent(number, urgent, self.now_us());
                        end = Instant::now();
                    }
                    None => return true,
                },
            }
        }
    }

    async fn run_session(&mut self, line: &mut SerialLine) -> Left {
        let mut input = [0_u8; READ_BYTES];
        // The frame being written, and how much of it is written.
        let (mut output, mut written) = (Vec::new(), 0);
        let mut event = None;
        loop {
            let now_us = self.now_us();
            self.session.handle_timeout(now_us);
            if event.is_none() {
                event = self.queue_waiting().or_else(|| self.session.event().map(LinkEvent::Session));
            }
            if matches!(event, Some(LinkEvent::Session(HostEvent::Connected { .. }))) {
                self.spacing.connected(now_us);
            }
            if event.is_none() && self.session.next_timeout_us().is_none() {
                return Left::Session;
            }
            if written == output.len() && now_us >= self.pacing.free_us() {
                output = self.session.transmit(now_us).unwrap_or_default();
                written = 0;
            }
            let writing = written < output.len();
            self.share_counts(writing, now_us);
            let wake = self.wake(writing, now_us);
            tokio::select! {
                biased;
                urgent = self.urgents.recv() => match urgent {
                    Some((number, urgent)) => self.session.send_urgent(number, urgent, self.now_us()),
                    None => return Left::Owner,
                },
                () = self.shared.renew.notified() => return Left::Renewed,
                () = self.shared.give_up.notified() => return Left::Session,
                count = line.writer.write(&output[written..]), if writing => match count {
                    Ok(count) => {
                        written += count;
                        self.pacing.sent(count, now_us);
                    }
                    Err(error) => return Left::Port(error),
                },
                count = line.reader.read(&mut input) => match count {
                    Ok(count) => self.session.receive(&input[..count], self.now_us()),
                    Err(error) => return Left::Port(error),
                },
                permit = self.events.reserve(), if event.is_some() => match permit {
                    Ok(permit) => if let Some(event) = event.take() { permit.send(event); },
                    Err(_) => return Left::Owner,
                },
                message = self.messages.recv(), if self.waiting.is_none() => match message {
                    Some(message) => self.waiting = Some(message),
                    None => return Left::Owner,
                },
                () = sleep_until(wake) => {}
            }
        }
    }

    /// When the loop of [`Self::run_session`] must run again if nothing else happens.
    fn wake(&self, writing: bool, now_us: u64) -> Instant {
        let timeout_us = self.session.next_timeout_us().unwrap_or(u64::MAX);
        let line_free_us = self.pacing.free_us();
        let wake_us = match (writing, now_us < line_free_us) {
            // No frame can go out yet, so only the dead-man timer matters: checking it each millisecond is enough.
            (true, _) => timeout_us.max(now_us + 1_000),
            // Data may wait without a timer.
            (false, true) => line_free_us,
            (false, false) => timeout_us,
        };
        self.start + Duration::from_micros(wake_us.min(now_us + 1_000_000))
    }

    fn share_counts(&mut self, writing: bool, now_us: u64) {
        self.pacing.count(writing || self.waiting.is_some() || self.session.has_unsent(), now_us);
        *self.shared.statistics.lock().unwrap_or_else(PoisonError::into_inner) = self.session.statistics();
        *self.shared.busy_share.lock().unwrap_or_else(PoisonError::into_inner) = self.pacing.busy_share();
        let hindrance = (self.session.session_id(), self.session.hindrance());
        *self.shared.hindrance.lock().unwrap_or_else(PoisonError::into_inner) = hindrance;
    }

    /// Passes the waiting message to the session. A message for another session is dropped.
    fn queue_waiting(&mut self) -> Option<LinkEvent> {
        let (session_id, message) = self.waiting.take()?;
        if session_id != self.session.session_id() {
            return None;
        }
        match self.session.send(&message) {
            Err(SendError::Full) => {
                self.waiting = Some((session_id, message));
                None
            }
            Err(error @ SendError::TooLarge { .. }) => Some(LinkEvent::NotSent(error)),
            Err(SendError::NotConnected) | Ok(()) => None,
        }
    }
}
