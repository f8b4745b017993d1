//! Orders that keys give, and the notes on their results. The unit tests in `view` press keys.

use crate::api::{JobView, ResumeBody};
use crate::cli::client::Client;
use crate::cli::client_error::ClientError;
use crate::cli::commands::{absence, answer};
use crate::cli::patience::BY_HAND;
use crate::job::JobState;

/// A job's id and state at one moment.
pub(super) type JobThen = (String, JobState);

/// An order for a job; without an id, for the job that holds the machine.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Order {
    pub(super) id: Option<String>,
    pub(super) order: &'static str,
}

impl Order {
    /// Gives the order; returns a note on the result.
    pub(super) async fn give(self, client: &Client) -> (String, Option<JobThen>) {
        let given = match (self.id, self.order) {
            (None, _) => client.abort_active().await,
            (Some(id), "resume") => client.resume(&id, ResumeBody::default()).await,
            (Some(id), order) => client.order(&id, order).await,
        };
        match given {
            Ok(job) => {
                let absence = absence(client, &job).await;
                (taken(self.order, &job, absence.as_deref()), Some((job.id, job.state)))
            }
            Err(error) => (not_taken(self.order, &error), None),
        }
    }
}

/// Note on an order that was accepted, with its warning.
fn taken(order: &str, job: &JobView, absence: Option<&str>) -> String {
    let answer = answer(order, job, absence);
    job.warning.as_ref().map_or_else(|| answer.clone(), |warning| format!("{answer}. WARNING: {warning}"))
}

/// Note on an order that was not accepted. It is short, as there may be little room. For an abort that did not reach the daemon, it
/// first says what to do by hand.
fn not_taken(order: &str, error: &ClientError) -> String {
    let why = match error {
        ClientError::Refused { status: 404 | 409, .. } => return error.to_string(),
        ClientError::Silent { waited_s, .. } => {
            format!("layerd did not answer within {waited_s} s; it may still carry the order out if it goes on")
        }
        ClientError::NoDaemon { .. } => "no layerd answers, so the order was not given".into(),
        error => error.to_string(),
    };
    if order == "abort" { format!("{BY_HAND}: {why}") } else { why }
}

#[cfg(test)]
mod tests {
    use super::super::view::tests::view;
    use super::*;

    #[test]
    fn an_order_that_is_not_on_disk_says_so() {
        let mut job = view().reading.status.active.unwrap();
        job.state = JobState::Aborting;
        assert!(!taken("abort", &job, None).contains("WARNING"));
        job.warning = Some("the order is carried out, but its record could not be written".into());
        let text = taken("abort", &job, None);
        assert!(
            text.contains("job 7 (part.layerd) is being aborted") && text.contains("WARNING: the order is carried out"),
            "{text}"
        );
    }

    #[tokio::test]
    async fn an_abort_that_nobody_takes_says_what_to_do_by_hand() {
        let client = Client::new("/nonexistent/control.sock");
        let (told, _) = Order { id: None, order: "abort" }.give(&client).await;
        assert!(told.starts_with(BY_HAND) && !told.contains("control.sock"), "{told}");
        assert!(
            told.starts_with("If there is light or the plate moves, switch the printer off at the mains"),
            "{told}"
        );
    }
}
