//! The task that joins a host session to its port: paces bytes, keeps timers, opens the port again and begins new sessions.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{Notify, mpsc};
use tokio::time::{Instant, sleep_until};

use crate::config::{FlowControl, LinkConfig};
use crate::random;

use super::message::{HostMessage, Urgent};
use super::session::{HostEvent, HostSession, HostSettings, SendError, Statistics, line_time_us};
use super::transport::{OpenError, SerialLine};

/// Line time of the bytes given to the kernel ahead: an urgent frame waits behind them, and the line must not run dry while
/// the host is busy.
const BACKLOG_US: u64 = 10_000;
/// Pauses between tries to open the port or to be accepted: soon at first, then seldom enough not to fill a log.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// Events the owner has not taken. When full, the device is held back by its credit.
const EVENT_QUEUE: usize = 64;
/// More than an operator can press in the time in which the line answers.
const URGENT_QUEUE: usize = 16;
/// Bytes read at once: the system's own buffer for a terminal.
const READ_BYTES: usize = 4096;

/// What the owner of a line hears.
#[derive(Debug)]
pub enum LinkEvent {
    /// From the session.
    Session(HostEvent),
    /// The port could not be opened; it is tried again. Told once for each reason.
    NotOpen(OpenError),
    /// The port failed and is opened again; the session, if there was one, is lost.
    PortFailed(io::Error),
    /// A message was not sent: it is longer than `Connected` allows. A fault of the owner.
    NotSent(SendError),
}

/// Where the owner puts in messages. Cloning shares the line.
#[derive(Clone, Debug)]
pub struct LinkHandle {
    messages: mpsc::Sender<(u32, HostMessage)>,
    urgents: mpsc::Sender<Urgent>,
    shared: Arc<Shared>,
}

/// What the task tells besides events.
#[derive(Debug, Default)]
struct Shared {
    statistics: Mutex<Statistics>,
    renew: Notify,
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

    /// Queues a message for the session named by [`HostEvent::Connected`]; once that session has ended it is dropped. At most
    /// two windows and one message are ever queued.
    ///
    /// # Errors
    /// [`NoRoom`] where a message waits already or the task has ended.
    pub fn try_send(&self, session_id: u32, message: HostMessage) -> Result<(), NoRoom> {
        self.messages.try_send((session_id, message)).map_err(|_| NoRoom)
    }

    /// Sends something that overtakes all messages; over new sessions too, until it is answered by `UrgentDone`. Urgent frames
    /// are numbered from 1 in the order of these calls.
    ///
    /// # Errors
    /// [`NoRoom`] where too many wait already or the task has ended.
    pub fn urgent(&self, urgent: Urgent) -> Result<(), NoRoom> {
        self.urgents.try_send(urgent).map_err(|_| NoRoom)
    }

    /// Ends the present session and begins another at once. There is no [`HostEvent::Lost`] for the one that ends.
    pub fn renew(&self) {
        self.shared.renew.notify_one();
    }

    /// Counts since the task began.
    pub fn statistics(&self) -> Statistics {
        *self.shared.statistics.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The task's own end of the channels.
#[derive(Debug)]
pub struct LinkDriver {
    config: LinkConfig,
    start: Instant,
    session: HostSession,
    messages: mpsc::Receiver<(u32, HostMessage)>,
    urgents: mpsc::Receiver<Urgent>,
    events: mpsc::Sender<LinkEvent>,
    shared: Arc<Shared>,
    /// Taken from its queue, waiting for room in the session's.
    waiting: Option<(u32, HostMessage)>,
    pause: Duration,
}

/// Makes a line: the handle, its events, and the driver whose [`LinkDriver::run`] moves the bytes.
pub fn link(config: LinkConfig) -> (LinkHandle, mpsc::Receiver<LinkEvent>, LinkDriver) {
    let (message_sender, messages) = mpsc::channel(1);
    let (urgent_sender, urgents) = mpsc::channel(URGENT_QUEUE);
    let (events, event_receiver) = mpsc::channel(EVENT_QUEUE);
    let shared = Arc::new(Shared::default());
    let handle = LinkHandle { messages: message_sender, urgents: urgent_sender, shared: Arc::clone(&shared) };
    let settings = HostSettings { baud: config.baud, escaped: config.flow_control == FlowControl::XonXoff };
    let driver = LinkDriver {
        config,
        start: Instant::now(),
        session: HostSession::new(random_id(), settings, 0),
        messages,
        urgents,
        events,
        shared,
        waiting: None,
        pause: FIRST_PAUSE,
    };
    (handle, event_receiver, driver)
}

/// A session id that no earlier process used, in all likelihood.
fn random_id() -> u32 {
    let bits = random::bits();
    (bits ^ (bits >> 32)) as u32
}

/// Why the inner loop came back.
enum Left {
    /// The session has ended; the port is fine.
    Session,
    /// The owner wants a new session.
    Renewed,
    Port(io::Error),
    /// Every handle, or the receiver of events, was dropped.
    Owner,
}

impl LinkDriver {
    /// Runs until every [`LinkHandle`] or the receiver of events is dropped.
    pub async fn run(mut self) {
        let mut last_reason = String::new();
        loop {
            let line = match SerialLine::open(&self.config) {
                Ok(line) => line,
                Err(error) => {
                    let reason = error.to_string();
                    if reason != last_reason && self.events.send(LinkEvent::NotOpen(error)).await.is_err() {
                        return;
                    }
                    last_reason = reason;
                    if self.rest().await {
                        return;
                    }
                    continue;
                }
            };
            last_reason.clear();
            self.renew();
            match self.run_line(line).await {
                Left::Owner | Left::Session | Left::Renewed => return,
                Left::Port(error) => {
                    if self.events.send(LinkEvent::PortFailed(error)).await.is_err() || self.rest().await {
                        return;
                    }
                }
            }
        }
    }

    /// Sessions one after the other on an open port. Opening anew would reset many boards.
    async fn run_line(&mut self, mut line: SerialLine) -> Left {
        loop {
            match self.run_session(&mut line).await {
                Left::Session => {
                    if self.rest().await {
                        return Left::Owner;
                    }
                    self.renew();
                }
                Left::Renewed => {
                    self.waiting = None;
                    self.renew();
                }
                left => return left,
            }
        }
    }

    fn renew(&mut self) {
        self.session = self.session.successor(random_id(), self.now_us());
    }

    fn now_us(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    fn instant(&self, at_us: u64) -> Instant {
        self.start + Duration::from_micros(at_us)
    }

    /// Waits before the next try, each time longer; `true` when the owner has gone. Messages of the old session are void,
    /// urgent frames are kept.
    async fn rest(&mut self) -> bool {
        self.waiting = None;
        let end = Instant::now() + self.pause;
        self.pause = (2 * self.pause).min(LONGEST_PAUSE);
        loop {
            tokio::select! {
                () = sleep_until(end) => return self.events.is_closed(),
                message = self.messages.recv() => if message.is_none() {
                    return true;
                },
                urgent = self.urgents.recv() => match urgent {
                    Some(urgent) => { self.session.send_urgent(urgent, self.now_us()); }
                    None => return true,
                },
            }
        }
    }

    async fn run_session(&mut self, line: &mut SerialLine) -> Left {
        let mut input = [0_u8; READ_BYTES];
        // The rest of the frame being written, and until when the line is busy with what the kernel has.
        let (mut output, mut written) = (Vec::new(), 0);
        let mut busy_until_us = 0_u64;
        let mut event = None;
        loop {
            let now_us = self.now_us();
            self.session.handle_timeout(now_us);
            if event.is_none() {
                event = self.queue_waiting().or_else(|| self.session.event().map(LinkEvent::Session));
            }
            if matches!(event, Some(LinkEvent::Session(HostEvent::Connected { .. }))) {
                self.pause = FIRST_PAUSE;
            }
            *self.shared.statistics.lock().unwrap_or_else(PoisonError::into_inner) = self.session.statistics();
            if event.is_none() && self.session.next_timeout_us().is_none() {
                return Left::Session;
            }
            let line_free_us = busy_until_us.saturating_sub(BACKLOG_US);
            if written == output.len() && now_us >= line_free_us {
                output = self.session.transmit(now_us).unwrap_or_default();
                written = 0;
            }
            let writing = written < output.len();
            let timeout_us = self.session.next_timeout_us().unwrap_or(u64::MAX);
            let wake_us = match (writing, now_us < line_free_us) {
                // Timers of frames that cannot go out yet are of no use; only the dead-man is, and a millisecond is soon enough.
                (true, _) => timeout_us.max(now_us + 1_000),
                // Data may wait that no timer knows of.
                (false, true) => line_free_us,
                (false, false) => timeout_us,
            };
            let wake = self.instant(wake_us.min(now_us + 1_000_000));
            tokio::select! {
                biased;
                urgent = self.urgents.recv() => match urgent {
                    Some(urgent) => { self.session.send_urgent(urgent, self.now_us()); }
                    None => return Left::Owner,
                },
                () = self.shared.renew.notified() => return Left::Renewed,
                count = line.writer.write(&output[written..]), if writing => match count {
                    Ok(count) => {
                        written += count;
                        busy_until_us = busy_until_us.max(now_us) + line_time_us(count, self.config.baud);
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

    /// Gives the session the message that waits; one for another session is void.
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
