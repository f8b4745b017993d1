//! How long `layerctl` waits for the daemon's answer, and what it tells the operator meanwhile.
//! `tests/operator` tests it on a daemon that hangs.

use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::timeout;

use super::client_error::ClientError;

/// After this time the operator is told what the command waits for. A daemon that runs answers within milliseconds.
pub(super) const TELL_AFTER: Duration = Duration::from_secs(2);

/// What to do about light and movement if the daemon cannot be told to end them.
pub(super) const BY_HAND: &str =
    "If there is light or the plate moves, switch the printer off at the mains or pull its plug";

/// What is being waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wait {
    /// An answer from memory.
    Query,
    /// An answer from memory that an order needs first. As long as for the order.
    LookUp,
    /// An order. Longer than a query, as the daemon carries it out as soon as it goes on.
    Order,
    /// An abort. The longest: until it is answered, it is unknown whether the machine is dark.
    Abort,
    /// Room for the next bytes of a build file. A busy disk may take seconds.
    Upload,
}

impl Wait {
    /// The time limit; longer than [`TELL_AFTER`].
    fn limit(self) -> Duration {
        Duration::from_secs(match self {
            Self::Query => 5,
            Self::LookUp | Self::Order | Self::Upload => 30,
            Self::Abort => 60,
        })
    }

    /// The text after [`TELL_AFTER`].
    fn told(self, socket: &Path) -> String {
        let (socket, told_s, more_s) = (socket.display(), TELL_AFTER.as_secs(), (self.limit() - TELL_AFTER).as_secs());
        let what = match self {
            Self::Query => format!("waiting {more_s} s more"),
            Self::LookUp => {
                format!("waiting up to {more_s} s more before the order can be given; it is not given yet")
            }
            Self::Order => format!("waiting up to {more_s} s more for it to take the order"),
            Self::Upload => format!("waiting up to {more_s} s more for it to take the build file"),
            // What to do comes first, and the socket is left out: there may be little room.
            Self::Abort => {
                return format!(
                    "{BY_HAND}. Do not wait for this command: layerd has not answered for {told_s} s; waiting up to {more_s} \
                     s more for it to take the abort"
                );
            }
        };
        format!("layerd at {socket} has not answered for {told_s} s: {what}")
    }

    /// What a missing answer means for the request.
    fn consequence(self) -> &'static str {
        match self {
            Self::Query => "",
            Self::LookUp => " The order was NOT given.",
            Self::Order | Self::Abort => {
                " The order may still be carried out if it goes on: look at `layerctl status` then."
            }
            Self::Upload => " `layerctl jobs` tells later whether it took the job.",
        }
    }
}

/// Takes the texts for the operator while a request waits.
#[derive(Clone)]
pub(super) struct Listener(Arc<dyn Fn(&str) + Send + Sync>);

impl Listener {
    /// Calls `hear` with each text.
    pub(super) fn new(hear: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self(Arc::new(hear))
    }

    /// Passes on one text.
    pub(super) fn tell(&self, text: &str) {
        (self.0)(text);
    }

    /// Waits for `work`, reports the wait after [`TELL_AFTER`], and gives up at the limit of `wait`.
    ///
    /// # Errors
    /// [`ClientError::Silent`], or an error of `work`.
    pub(super) async fn patiently<T>(
        &self,
        wait: Wait,
        socket: &Path,
        work: impl Future<Output = Result<T, ClientError>>,
    ) -> Result<T, ClientError> {
        tokio::pin!(work);
        if let Ok(done) = timeout(TELL_AFTER, &mut work).await {
            return done;
        }
        self.tell(&wait.told(socket));
        let silent = |_| ClientError::Silent {
            socket: socket.into(),
            waited_s: wait.limit().as_secs(),
            consequence: wait.consequence(),
        };
        timeout(wait.limit() - TELL_AFTER, work).await.map_err(silent)?
    }
}

impl fmt::Debug for Listener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Listener")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_wait_says_what_for_and_how_long() {
        for (wait, words) in [
            (Wait::Query, "waiting 3 s more"),
            (Wait::LookUp, "28 s more before the order can be given"),
            (Wait::Order, "28 s more for it to take the order"),
            (Wait::Upload, "the build file"),
        ] {
            let told = wait.told(Path::new("/run/x.sock"));
            assert!(told.contains(words) && told.contains("/run/x.sock has not answered for 2 s"), "{told}");
        }
        let told = Wait::Abort.told(Path::new("/run/x.sock"));
        assert!(told.starts_with(BY_HAND) && told.contains("for 2 s") && !told.contains("x.sock"), "{told}");
        let error = ClientError::Silent {
            socket: "/run/x.sock".into(),
            waited_s: Wait::LookUp.limit().as_secs(),
            consequence: Wait::LookUp.consequence(),
        };
        let told = error.to_string();
        assert!(told.contains("within 30 s") && told.contains("The order was NOT given"), "{told}");
    }
}
