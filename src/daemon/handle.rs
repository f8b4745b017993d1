//! Between the server and the printer: orders one way, a snapshot and events the other. Every queue is bounded.

use tokio::sync::{broadcast, mpsc, oneshot, watch};

use super::api::{BudgetView, DeviceView, Event, InDoubt, JobView, LineView, LinkView, Status};
use crate::job::JobState;

/// Orders that wait for the printer. People and scripts send a few a second at most; more means that nobody answers.
const WAITING_ORDERS: usize = 16;
/// Aborts have a queue of their own, so that no other order can stand before one.
const WAITING_ABORTS: usize = 4;
/// Events a slow subscriber may be behind before it is told to read everything again.
const EVENTS_KEPT: usize = 256;

/// What the printer tells of itself; [`Status`], job list and device view are parts of it.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Name of the machine.
    pub machine: String,
    /// The line.
    pub link: LinkView,
    /// The device.
    pub device: DeviceView,
    /// The memory budget.
    pub budget: BudgetView,
    /// What the line carried.
    pub line: LineView,
    /// Jobs that have ended since the daemon started. Whoever looked at the plate before one more did has not seen its part.
    pub jobs_ended: u64,
    /// Every job that is remembered, in the order of their acceptance. The printer bounds their number.
    pub jobs: Vec<JobView>,
}

impl Snapshot {
    /// Everything at a glance.
    pub fn status(&self) -> Status {
        let queued = |job: &&JobView| job.state == JobState::Queued;
        Status {
            version: env!("CARGO_PKG_VERSION").into(),
            machine: self.machine.clone(),
            link: self.link.clone(),
            misfit: self.device.misfit.clone().filter(|_| self.device.connected),
            active: self.active().cloned(),
            queue: self.jobs.iter().filter(queued).cloned().collect(),
            last: self.last().cloned(),
            budget: self.budget,
            line: self.line.clone(),
        }
    }

    /// The job that holds the machine: the one that prints, or an interrupted one whose part is on the plate.
    pub fn active(&self) -> Option<&JobView> {
        let prints = self.jobs.iter().find(|job| job.state.is_active());
        prints.or_else(|| self.jobs.iter().find(|job| job.state == JobState::Interrupted))
    }

    /// The job that ended last; of those whose end nobody knows the newest, where there is no other.
    fn last(&self) -> Option<&JobView> {
        // Of equals the last one is taken.
        self.jobs.iter().filter(|job| job.state.is_final()).max_by_key(|job| job.ended_ms)
    }

    /// The job of that id.
    pub fn job(&self, id: &str) -> Option<&JobView> {
        self.jobs.iter().find(|job| job.id == id)
    }
}

/// What the operator orders.
#[derive(Debug)]
pub enum Command {
    /// Take a new job.
    Submit(Submission),
    /// Lift clear after the layer under way, and wait.
    Pause(String),
    /// Go on, or print an interrupted job further.
    Resume {
        /// The job.
        id: String,
        /// What the operator says of a layer in doubt.
        in_doubt: Option<InDoubt>,
    },
    /// End after the layer under way.
    Stop(String),
    /// Light off now, then lift clear; without an id the active job.
    Abort(Option<String>),
}

/// A new job.
#[derive(Debug)]
pub struct Submission {
    /// The build file, whole and flushed, in the spool's `incoming`; removed when dropped, so whoever takes the job renames it
    /// (`TempPath::persist`).
    pub part: tempfile::TempPath,
    /// For people.
    pub name: String,
    /// The recipe's TOML text; `None` for the daemon's default recipe.
    pub recipe_text: Option<String>,
    /// For people: where the recipe came from.
    pub recipe_name: Option<String>,
    /// [`Snapshot::jobs_ended`] when the operator asked.
    pub jobs_ended: u64,
}

/// Why an order is not carried out.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct CommandError {
    /// HTTP status: 400 bad input, 404 no such job, 409 wrong state, 422 the job cannot be printed, 500, 503, 507.
    pub status: u16,
    /// What is wrong and what to do.
    pub message: String,
}

impl CommandError {
    /// An error with this status and text.
    pub fn new(status: u16, message: impl Into<String>) -> Self {
        Self { status, message: message.into() }
    }
}

/// An order and where its answer goes.
#[derive(Debug)]
pub struct Order {
    /// What to do.
    pub command: Command,
    /// Takes the answer: the job as it is once the order is accepted. Nobody may be listening any more.
    pub reply: oneshot::Sender<Result<JobView, CommandError>>,
}

/// The server's end.
#[derive(Clone, Debug)]
pub struct Handle {
    orders: mpsc::Sender<Order>,
    aborts: mpsc::Sender<Order>,
    snapshot: watch::Receiver<Snapshot>,
    events: broadcast::Sender<Event>,
}

/// The printer's end.
#[derive(Debug)]
pub struct Desk {
    /// Orders, aborts first.
    pub orders: Orders,
    /// Where the printer writes what it tells of itself (`send_modify`).
    pub snapshot: watch::Sender<Snapshot>,
    /// News for subscribers; sending fails where there are none, which is no error.
    pub events: broadcast::Sender<Event>,
}

/// The printer's queue of orders.
#[derive(Debug)]
pub struct Orders {
    orders: mpsc::Receiver<Order>,
    aborts: mpsc::Receiver<Order>,
}

/// Both ends.
pub fn channel(first: Snapshot) -> (Handle, Desk) {
    let (order_sender, orders) = mpsc::channel(WAITING_ORDERS);
    let (abort_sender, aborts) = mpsc::channel(WAITING_ABORTS);
    let (snapshot_sender, snapshot) = watch::channel(first);
    let (events, _) = broadcast::channel(EVENTS_KEPT);
    let handle = Handle { orders: order_sender, aborts: abort_sender, snapshot, events: events.clone() };
    (handle, Desk { orders: Orders { orders, aborts }, snapshot: snapshot_sender, events })
}

impl Orders {
    /// The next order, an abort before any other; `None` when the server is gone. Cancel-safe.
    pub async fn next(&mut self) -> Option<Order> {
        tokio::select! {
            biased;
            Some(order) = self.aborts.recv() => Some(order),
            Some(order) = self.orders.recv() => Some(order),
            else => None,
        }
    }
}

impl Handle {
    /// Gives an order and waits for its answer.
    ///
    /// # Errors
    /// What the printer says, or 503 where it takes no orders.
    pub async fn order(&self, command: Command) -> Result<JobView, CommandError> {
        let queue = if matches!(command, Command::Abort(_)) { &self.aborts } else { &self.orders };
        let (reply, answer) = oneshot::channel();
        queue.try_send(Order { command, reply }).map_err(|refused| match refused {
            mpsc::error::TrySendError::Full(_) => CommandError::new(503, "too many orders wait already; try again"),
            mpsc::error::TrySendError::Closed(_) => CommandError::new(503, "the daemon is shutting down"),
        })?;
        answer.await.unwrap_or_else(|_| Err(CommandError::new(503, "the daemon is shutting down")))
    }

    /// What the printer told last.
    pub fn snapshot(&self) -> watch::Ref<'_, Snapshot> {
        self.snapshot.borrow()
    }

    /// News from now on.
    pub fn subscribe(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }
}
