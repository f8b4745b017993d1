//! What server and printer share: orders go to the printer, a snapshot and events come back. Every queue is bounded.
//! `tests/control_api` and `tests/abort_crowd.rs` test the bounds.

use serde::Serialize;
use tokio::sync::{broadcast, mpsc, oneshot, watch};

use crate::api::{BudgetView, DeviceView, Event, InDoubt, JobView, LineView, LinkView, RaiseView, RemovedView, Status};
use crate::daemon::caller::Caller;
pub use crate::daemon::error::OrderError;
use crate::daemon::fit::Fit;
use crate::disk::TempPath;
use crate::job::JobState;
use crate::system::spawn_blocking;
use crate::text::short_name;

/// Orders that wait for the printer. People and scripts send a few a second; a full queue means that the printer hangs.
const MAX_WAITING_ORDERS: usize = 16;
/// Aborts that wait for the printer, in a queue of their own: no other order delays one. When it is full, further aborts wait for
/// room, at most one for each connection. The printer takes aborts first and needs microseconds for each.
const MAX_WAITING_ABORTS: usize = 4;
/// Jobs that wait for the machine. Each holds a part in the spool. This is two months of daily prints; more would come from a
/// script that runs wild.
pub const MAX_QUEUED_JOBS: usize = 64;
/// Events that are kept for a slow subscriber. One that falls further behind gets [`Event::Lagged`].
const MAX_EVENTS_KEPT: usize = 256;

/// State of the printer as the API shows it. [`Status`], job list and device view are made from it.
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
    /// Jobs that have ended since the daemon started. If this changed after an operator looked at the plate, another part may
    /// hang on it.
    pub jobs_ended: u64,
    /// What new jobs are checked against; `None` until the printer's first update.
    pub fit: Option<Fit>,
    /// All known jobs, the oldest first. The printer bounds their number.
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
            stays_lit: self.device.stays_lit.clone(),
            active: self.active().cloned(),
            queue: self.jobs.iter().filter(queued).cloned().collect(),
            last: self.last().cloned(),
            budget: self.budget,
            line: self.line.clone(),
        }
    }

    /// The job that holds the machine: the one that prints, else the interrupted one whose part is on the plate.
    pub fn active(&self) -> Option<&JobView> {
        let prints = self.jobs.iter().find(|job| job.state.is_active());
        prints.or_else(|| self.jobs.iter().find(|job| job.state == JobState::Interrupted))
    }

    /// Checks that the queue has room for one more job besides `coming` others that are being uploaded.
    ///
    /// # Errors
    /// 503 if it has none.
    pub fn check_queue(&self, coming: usize) -> Result<(), OrderError> {
        let queued = self.jobs.iter().filter(|job| job.state == JobState::Queued).count();
        if queued + coming < MAX_QUEUED_JOBS {
            return Ok(());
        }
        let text = format!(
            "the queue is full: {queued} jobs wait, at most {MAX_QUEUED_JOBS} may; let one be printed, or stop one \
             (layerctl jobs, layerctl stop JOB)"
        );
        Err(OrderError::new(503, text))
    }

    /// The job that ended last. If the end of no job is known, the newest one that is over.
    fn last(&self) -> Option<&JobView> {
        // `max_by_key` returns the last of equals.
        self.jobs.iter().filter(|job| job.state.is_final()).max_by_key(|job| job.ended_ms)
    }

    /// The job with this id.
    pub fn job(&self, id: &str) -> Option<&JobView> {
        self.jobs.iter().find(|job| job.id == id)
    }
}

/// What the operator orders.
#[derive(Debug)]
pub enum Order {
    /// Take a new job.
    Submit(Submission),
    /// Take a new job with the part of one that is over.
    Again(Again),
    /// Lift clear after the layer under way, and wait.
    Pause(String),
    /// Resume a paused or interrupted job, or confirm that the plate is empty for a queued one.
    Resume {
        /// The job.
        id: String,
        /// What the operator says of a layer in doubt.
        in_doubt: Option<InDoubt>,
        /// [`Snapshot::jobs_ended`] when the request arrived.
        jobs_ended: u64,
    },
    /// End after the layer under way.
    Stop(String),
    /// Light off now, then lift clear; without an id the active job.
    Abort(Option<String>),
    /// Delete a job that is over.
    Remove(String),
    /// Lift the plate clear while no job runs.
    Raise,
}

/// Answer to an order. Its JSON form is that of the content.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Answer {
    /// The job as it is once the order is accepted.
    Job(Box<JobView>),
    /// The move of the plate.
    Raise(RaiseView),
    /// The job that was removed.
    Removed(RemovedView),
}

impl From<JobView> for Answer {
    fn from(job: JobView) -> Self {
        Self::Job(Box::new(job))
    }
}

/// The order as the log shows it.
impl std::fmt::Display for Order {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Submit(new) => write!(f, "start {}", short_name(&new.name)),
            Self::Again(again) => write!(f, "start the part of job {} again", short_name(&again.id)),
            Self::Pause(id) => write!(f, "pause job {}", short_name(id)),
            Self::Resume { id, in_doubt: None, .. } => write!(f, "resume job {}", short_name(id)),
            Self::Resume { id, in_doubt: Some(InDoubt::Exposed), .. } => {
                write!(f, "resume job {}, the layer in doubt was exposed", short_name(id))
            }
            Self::Resume { id, in_doubt: Some(InDoubt::Repeat), .. } => {
                write!(f, "resume job {}, expose the layer in doubt again", short_name(id))
            }
            Self::Stop(id) => write!(f, "stop job {}", short_name(id)),
            Self::Abort(Some(id)) => write!(f, "abort job {}", short_name(id)),
            Self::Abort(None) => f.write_str("abort"),
            Self::Remove(id) => write!(f, "remove job {}", short_name(id)),
            Self::Raise => f.write_str("raise the plate"),
        }
    }
}

/// A new job.
#[derive(Debug)]
pub struct Submission {
    /// The build file, complete and flushed, in the spool's `incoming`. It is deleted when dropped; accepting the job renames it.
    pub part: TempPath,
    /// For people.
    pub name: String,
    /// The recipe's TOML text; `None` for the daemon's default recipe.
    pub recipe_text: Option<String>,
    /// For people: where the recipe came from.
    pub recipe_name: Option<String>,
    /// [`Snapshot::jobs_ended`] when the operator asked.
    pub jobs_ended: u64,
}

impl Submission {
    /// Deletes a new job that was refused, with its file, on a thread that may wait for the disk.
    pub(crate) fn discard(self) {
        spawn_blocking(move || drop(self));
    }
}

/// A new job with the part of one that is over.
#[derive(Debug)]
pub struct Again {
    /// The job that is over.
    pub id: String,
    /// The recipe's TOML text; `None` for that job's recipe.
    pub recipe_text: Option<String>,
    /// For people: where the recipe came from.
    pub recipe_name: Option<String>,
    /// [`Snapshot::jobs_ended`] when the operator asked.
    pub jobs_ended: u64,
}

/// Where an order's answer goes.
pub(crate) type Reply = oneshot::Sender<Result<Answer, OrderError>>;

/// An order and where its answer goes.
#[derive(Debug)]
pub struct Ticket {
    /// What to do.
    pub order: Order,
    /// Takes the answer. The receiver may be gone.
    pub reply: oneshot::Sender<Result<Answer, OrderError>>,
}

/// The server's end.
#[derive(Clone, Debug)]
pub struct Handle {
    orders: mpsc::Sender<Ticket>,
    aborts: mpsc::Sender<Ticket>,
    snapshot: watch::Receiver<Snapshot>,
    events: broadcast::Sender<Event>,
}

/// The printer's end.
#[derive(Debug)]
pub struct Desk {
    /// Orders, aborts first.
    pub orders: Orders,
    /// The state that the printer publishes (`send_modify`).
    pub snapshot: watch::Sender<Snapshot>,
    /// Events for subscribers. Sending fails when there are none, which is no error.
    pub events: broadcast::Sender<Event>,
}

/// The printer's queue of orders.
#[derive(Debug)]
pub struct Orders {
    orders: mpsc::Receiver<Ticket>,
    aborts: mpsc::Receiver<Ticket>,
}

/// Both ends.
pub fn channel(first: Snapshot) -> (Handle, Desk) {
    let (order_sender, orders) = mpsc::channel(MAX_WAITING_ORDERS);
    let (abort_sender, aborts) = mpsc::channel(MAX_WAITING_ABORTS);
    let (snapshot_sender, snapshot) = watch::channel(first);
    let (events, _) = broadcast::channel(MAX_EVENTS_KEPT);
    let handle = Handle { orders: order_sender, aborts: abort_sender, snapshot, events: events.clone() };
    (handle, Desk { orders: Orders { orders, aborts }, snapshot: snapshot_sender, events })
}

impl Orders {
    /// The next order, an abort before any other; `None` when the server is gone. Cancel-safe.
    pub async fn next(&mut self) -> Option<Ticket> {
        tokio::select! {
            biased;
            Some(order) = self.aborts.recv() => Some(order),
            Some(order) = self.orders.recv() => Some(order),
            else => None,
        }
    }
}

impl Handle {
    /// Gives an order and waits for its answer. The log says who gave it.
    ///
    /// # Errors
    /// The printer's refusal, or 503 if it takes no orders.
    pub async fn order(&self, order: Order, caller: Caller) -> Result<Answer, OrderError> {
        let what = order.to_string();
        tracing::info!("order by {caller}: {what}");
        let answer = self.give(order).await;
        match &answer {
            Ok(Answer::Job(job)) => {
                tracing::info!("order by {caller}: {what}: accepted, job {} is {}", job.id, job.state);
            }
            Ok(Answer::Raise(_) | Answer::Removed(_)) => tracing::info!("order by {caller}: {what}: accepted"),
            Err(error) => tracing::info!("order by {caller}: {what}: refused: {error}"),
        }
        answer
    }

    async fn give(&self, order: Order) -> Result<Answer, OrderError> {
        let ending = || OrderError::new(503, "the daemon is shutting down");
        let (reply, answer) = oneshot::channel();
        if matches!(order, Order::Abort(_)) {
            self.aborts.send(Ticket { order, reply }).await.map_err(|_| ending())?;
        } else {
            self.orders.try_send(Ticket { order, reply }).map_err(|refused| {
                let (ticket, error) = match refused {
                    mpsc::error::TrySendError::Full(ticket) => {
                        (ticket, OrderError::new(503, "too many orders wait already; try again"))
                    }
                    mpsc::error::TrySendError::Closed(ticket) => (ticket, ending()),
                };
                if let Order::Submit(submission) = ticket.order {
                    submission.discard();
                }
                error
            })?;
        }
        answer.await.unwrap_or_else(|_| Err(ending()))
    }

    /// The printer's latest state.
    pub fn snapshot(&self) -> watch::Ref<'_, Snapshot> {
        self.snapshot.borrow()
    }

    /// Events from now on.
    pub fn subscribe(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }
}
