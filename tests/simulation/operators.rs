//! Operators: those who give orders at random moments, and one who in the end sees to it that every job ends.
//!
//! All of them are careful in one thing: who starts a job while nothing prints takes off what hangs on a raised plate, and who confirms
//! that the plate is empty takes off what is on it, wherever it is. And who decides on a layer in doubt looks at the part first.

use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue};
use layerd::api::{InDoubt, JobView, NAME_HEADER};
use layerd::daemon::caller::Caller;
use layerd::daemon::handle::{Again, Answer, Handle, Order, OrderError};
use layerd::daemon::http::upload;
use layerd::job::{JobState, Spool};
use tokio::sync::Semaphore;

use crate::host::Shared;
use crate::parts::{Kind, spool};

/// What an operator asks for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Ask {
    Submit {
        part: usize,
    },
    Again(u32),
    Pause(u32),
    /// With what the operator says of a layer in doubt.
    Resume(u32, Option<(u32, InDoubt)>),
    Stop(u32),
    Abort(Option<u32>),
    Remove(u32),
    Raise,
}

/// An order that was given, and what came of it.
#[derive(Clone, Debug)]
pub(crate) struct Given {
    pub(crate) ask: Ask,
    /// When it was given.
    pub(crate) given_us: u64,
    pub(crate) answer: Result<Answer, OrderError>,
}

/// Answers that the world has not seen yet.
pub(crate) type Answers = Arc<Mutex<Vec<Given>>>;

/// What an operator decided, and what they saw when they did.
#[derive(Clone, Debug)]
pub(crate) struct Decided {
    /// Of the machine.
    pub(crate) kind: Kind,
    pub(crate) ask: Ask,
    pub(crate) given_us: u64,
    pub(crate) jobs_ended: u64,
}

/// Gives an order; its answer comes to `answers`.
pub(crate) async fn give(decided: Decided, handle: Handle, answers: Answers, shared: Arc<Shared>) {
    let Decided { kind, ask, given_us, jobs_ended } = decided;
    let answer = ordered(kind, &ask, jobs_ended, &handle).await;
    answers.lock().unwrap_or_else(PoisonError::into_inner).push(Given { ask, given_us, answer });
    shared.attention.notify_one();
}

async fn ordered(kind: Kind, ask: &Ask, jobs_ended: u64, handle: &Handle) -> Result<Answer, OrderError> {
    let order = match ask {
        Ask::Submit { part } => {
            let fit = {
                let snapshot = handle.snapshot();
                snapshot.check_queue(0)?;
                snapshot.fit.clone()
            };
            let place = Arc::new(Semaphore::new(1)).try_acquire_owned().expect("a place");
            let mut headers = HeaderMap::new();
            headers.insert(NAME_HEADER, HeaderValue::from_str(&part_name(*part)).expect("ASCII"));
            let mut body = Body::from(kind.parts()[*part].file.clone());
            let incoming = Spool::incoming_of(&spool());
            let received = upload::receive(&incoming, &headers, &mut body, jobs_ended, fit, place).await?;
            Order::Submit(received.0)
        }
        Ask::Again(id) => Order::Again(Again { id: id.to_string(), recipe_text: None, recipe_name: None, jobs_ended }),
        Ask::Pause(id) => Order::Pause(id.to_string()),
        Ask::Resume(id, in_doubt) => {
            Order::Resume { id: id.to_string(), in_doubt: in_doubt.map(|(_, choice)| choice), jobs_ended }
        }
        Ask::Stop(id) => Order::Stop(id.to_string()),
        Ask::Abort(id) => Order::Abort(id.map(|id| id.to_string())),
        Ask::Remove(id) => Order::Remove(id.to_string()),
        Ask::Raise => Order::Raise,
    };
    handle.order(order, Caller::default()).await
}

/// Whether a job waits until its operator has looked at plate and vat.
pub(crate) fn asks_for_empty_plate(job: &JobView) -> bool {
    job.reason.as_ref().is_some_and(|reason| reason.contains("take out what is there"))
}

/// Whether the job's journal could not be read when the daemon started.
pub(crate) fn is_unread(job: &JobView) -> bool {
    job.state == JobState::Interrupted
        && job.reason.as_ref().is_some_and(|reason| reason.contains("If its part is on the plate, take it off"))
}

/// A job's name says which part it is.
pub(crate) fn part_name(part: usize) -> String {
    format!("part-{part}")
}

/// Which part a job's name says.
pub(crate) fn part_of(name: &str) -> Option<usize> {
    name.strip_prefix("part-")?.parse().ok()
}

/// The number of a job.
pub(crate) fn number(job: &JobView) -> u32 {
    job.id.parse().expect("a number")
}
