//! Why an order is not carried out. `docs/control-api.md` lists the statuses; `tests/control_api` tests them.

use crate::job::ResumeError;

/// Why an order is not carried out.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct OrderError {
    /// HTTP status: 400 bad input, 404 no such job, 409 wrong state, 422 the job cannot be printed, 500, 503, 507.
    pub status: u16,
    /// What is wrong and what to do.
    pub message: String,
}

impl OrderError {
    /// An error with this status and text.
    pub fn new(status: u16, message: impl Into<String>) -> Self {
        Self { status, message: message.into() }
    }
}

/// The refusal to resume a job; puts the job's number into the text.
pub(crate) fn refused(id: u32, error: &ResumeError) -> OrderError {
    OrderError::new(409, error.to_string().replace("JOB", &id.to_string()))
}

pub(crate) fn no_such_job(id: &str) -> OrderError {
    OrderError::new(404, format!("there is no job `{id}`; `layerctl jobs` lists them"))
}
