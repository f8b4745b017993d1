//! The state that follows from a journal's records, and where an engine takes over the job.
//!
//! ```
//! use layerd::job::{History, Record, ResumeChoice};
//!
//! let records = [
//!     Record::Accepted { key: 7, layer_count: 100, name: "cube".into() },
//!     Record::Started { exposure: 0 },
//!     Record::Commanded { exposure: 0, boot_id: 1 },
//!     Record::Confirmed { exposure: 0 },
//! ];
//! let history = History::replay(&records)?;
//! let start = history.start(ResumeChoice::None)?;
//! assert_eq!(start.next_exposure, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use serde::Serialize;

use super::{EndOrder, JobState, Record, Trace, Unconfirmed};
use crate::device::Passes;
use crate::link::message::ExposureId;

/// The state that follows from a journal's records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct History {
    /// Identifies the job's exposures.
    pub key: u64,
    /// Name of the part.
    pub name: String,
    /// The exposures of its layers.
    pub passes: Passes,
    /// The state without an engine: a job that was active is [`JobState::Interrupted`].
    pub state: JobState,
    /// The first exposure not known to be done.
    pub next_exposure: u32,
    /// The first vector of [`History::next_exposure`] that is not marked.
    pub next_vector: u32,
    /// [`History::next_exposure`] was commanded; only the device knows the outcome.
    pub unconfirmed: Option<Unconfirmed>,
    /// [`History::next_exposure`] was commanded, and not even the device knows the outcome. Says what is known; the operator must
    /// decide.
    pub in_doubt: Option<String>,
    /// Why the job ended; empty if it has not.
    pub reason: String,
    /// The operator's order to end the job. The job never prints again.
    pub ordered: Option<EndOrder>,
    /// Boot id of the device on whose empty plate the job began ([`Record::PlateClear`]).
    pub plate_clear_on: Option<u32>,
    /// Exposures of unknown jobs that the operator has confirmed ([`Record::PlateClear`]).
    pub traces: Vec<Trace>,
    /// What the device had exposed last, of another job, before this job's first layer ([`Record::LastExposed`]).
    pub exposed_before: Option<ExposureId>,
    /// The job ended with its machine parked, so that the part is safe.
    pub parked: bool,
    /// What was dropped at the journal's end because it was damaged; the reader of the file sets it.
    pub dropped: Option<String>,
    /// A layer was commanded, and it is not certain that it had no light.
    lit: bool,
    /// The device confirmed a layer.
    confirmed: bool,
}

/// The operator's decision about a layer in doubt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ResumeChoice {
    /// No decision.
    #[default]
    None,
    /// It had enough light: go on with the next layer.
    AssumeExposed,
    /// It had too little light: expose it again.
    Repeat,
}

/// Where an engine takes over a job.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StartPoint {
    /// The first exposure not known to be done.
    pub next_exposure: u32,
    /// It was commanded: the device must be asked first.
    pub unconfirmed: Option<Unconfirmed>,
    /// It is in doubt. The choice decides, unless the device knows the outcome.
    pub in_doubt: bool,
    /// The operator's decision.
    pub choice: ResumeChoice,
    /// [`History::touched`].
    pub touched: bool,
    /// The device confirmed a layer of this job. Until it prints another job, its last exposure belongs to this one.
    pub confirmed: bool,
    /// [`History::exposed_before`].
    pub exposed_before: Option<ExposureId>,
    /// [`History::next_vector`].
    pub from_vector: u32,
}

/// Why a job cannot be resumed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ResumeError {
    /// The job is over.
    #[error("the job is {0} and cannot be resumed; start the part again instead")]
    Over(JobState),
    /// The operator ordered its end.
    #[error(
        "the job was ordered to {} and cannot be resumed; `layerctl {} JOB` ends it now; start the part again instead", .0.verb(), .0.verb()
    )]
    Ordered(EndOrder),
    /// A layer is in doubt and the operator has not decided.
    #[error(
        "{exposure} is in doubt: {why}. Look at the part, then run `layerctl resume JOB --in-doubt exposed` to go on \
         with {next}, or `layerctl resume JOB --in-doubt repeat` to expose {exposure} again"
    )]
    InDoubt {
        /// The layer, in words.
        exposure: String,
        /// What would follow it, in words.
        next: String,
        /// What is known.
        why: String,
    },
    /// The operator spoke of a layer that is not in doubt.
    #[error("no layer is in doubt: what comes before {next} is exposed, and {next} is not; resume without --in-doubt")]
    NoDoubt {
        /// What is to be exposed next, in words.
        next: String,
    },
}

/// Records that contradict each other: the file is not a journal this program wrote.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("record {index} of the journal contradicts those before it: {what}")]
pub struct Contradiction {
    /// The record, from 0.
    pub index: usize,
    /// How.
    pub what: String,
}

impl History {
    /// Computes the state from a journal's records.
    ///
    /// # Errors
    /// [`Contradiction`] if they cannot all be true.
    pub fn replay<'a>(records: impl IntoIterator<Item = &'a Record>) -> Result<Self, Contradiction> {
        let mut records = records.into_iter();
        let Some(Record::Accepted { key, layer_count, name }) = records.next() else {
            return Err(Contradiction { index: 0, what: "a journal begins with the job's acceptance".into() });
        };
        let mut history = Self {
            key: *key,
            name: name.clone(),
            passes: Passes::single(*layer_count),
            state: JobState::Queued,
            next_exposure: 0,
            next_vector: 0,
            unconfirmed: None,
            in_doubt: None,
            reason: String::new(),
            ordered: None,
            plate_clear_on: None,
            traces: Vec::new(),
            exposed_before: None,
            parked: false,
            dropped: None,
            lit: false,
            confirmed: false,
        };
        for (position, record) in records.enumerate() {
            history.apply(record).map_err(|what| Contradiction { index: position + 1, what })?;
        }
        if history.state.is_active() || (history.state == JobState::Queued && history.ordered.is_some()) {
            history.state = JobState::Interrupted;
            history.reason = "the daemon ended without warning (crash or lost power): `layerctl resume` goes on, `layerctl abort` ends the job".into();
        }
        Ok(history)
    }

    /// Where an engine takes over the job.
    ///
    /// # Errors
    /// [`ResumeError`] if the job is over or was ordered to end, or if a layer is in doubt and `choice` does not decide it.
    pub fn start(&self, choice: ResumeChoice) -> Result<StartPoint, ResumeError> {
        if self.state.is_final() {
            return Err(ResumeError::Over(self.state));
        }
        if let Some(order) = self.ordered {
            return Err(ResumeError::Ordered(order));
        }
        match (&self.in_doubt, choice) {
            (Some(why), ResumeChoice::None) => {
                let [exposure, next] = [0, 1].map(|on| self.passes.text(self.next_exposure + on));
                Err(ResumeError::InDoubt { exposure, next, why: why.clone() })
            }
            (None, ResumeChoice::AssumeExposed | ResumeChoice::Repeat) if self.unconfirmed.is_none() => {
                Err(ResumeError::NoDoubt { next: self.passes.text(self.next_exposure) })
            }
            _ => Ok(self.start_point(choice)),
        }
    }

    /// Where an engine takes over the job only to end it. A layer in doubt stays in doubt.
    ///
    /// # Errors
    /// [`ResumeError::Over`].
    pub fn start_to_end(&self) -> Result<StartPoint, ResumeError> {
        if self.state.is_final() {
            return Err(ResumeError::Over(self.state));
        }
        Ok(self.start_point(ResumeChoice::None))
    }

    fn start_point(&self, choice: ResumeChoice) -> StartPoint {
        StartPoint {
            next_exposure: self.next_exposure,
            unconfirmed: self.unconfirmed,
            in_doubt: self.in_doubt.is_some(),
            choice,
            touched: self.touched(),
            confirmed: self.confirmed,
            exposed_before: self.exposed_before,
            from_vector: self.next_vector,
        }
    }

    /// Whether the job may have had light, so that a part may hang on the plate.
    pub fn touched(&self) -> bool {
        self.lit || self.unconfirmed.is_some()
    }

    fn apply(&mut self, record: &Record) -> Result<(), String> {
        if self.state.is_final() {
            return Err(format!("the job was {} already", self.state));
        }
        match record {
            Record::Accepted { .. } => return Err("the job is accepted twice".into()),
            Record::Started { exposure } => {
                self.expect_next(*exposure)?;
                self.state = JobState::Printing;
                self.parked = false;
                self.reason.clear();
            }
            Record::Commanded { exposure, boot_id } => {
                self.expect_next(*exposure)?;
                if self.in_doubt.is_some() || self.unconfirmed.is_some() {
                    return Err(format!("exposure {exposure} is commanded twice"));
                }
                self.unconfirmed = Some(Unconfirmed { exposure: *exposure, boot_id: *boot_id });
            }
            Record::Confirmed { exposure } => {
                self.expect_commanded(*exposure)?;
                (self.lit, self.confirmed) = (true, true);
                self.close(true);
            }
            Record::NotExposed { exposure } => {
                self.expect_commanded(*exposure)?;
                self.lit = true;
                self.close(false);
            }
            Record::PartlyMarked { exposure, next_vector } => {
                self.expect_commanded(*exposure)?;
                self.lit = true;
                self.close(false);
                self.next_vector = *next_vector;
            }
            Record::Withdrawn { exposure } => {
                self.expect_commanded(*exposure)?;
                self.close(false);
            }
            Record::InDoubt { exposure, why } => {
                self.expect_commanded(*exposure)?;
                self.unconfirmed = None;
                self.lit = true;
                self.in_doubt = Some(why.clone());
            }
            Record::Decided { exposure, exposed } => {
                self.expect_commanded(*exposure)?;
                self.lit = true;
                self.close(*exposed);
            }
            Record::Paused => self.state = JobState::Paused,
            Record::Resumed => self.state = JobState::Printing,
            Record::LightOff | Record::Dropped { .. } => {}
            // An abort outranks a stop, whatever the order.
            Record::Ordered(order) => {
                self.ordered = self.ordered.filter(|known| *known == EndOrder::Abort).or(Some(*order));
            }
            Record::PlateClear { boot_id, traces } => {
                self.plate_clear_on = Some(*boot_id);
                let new = traces.iter().filter(|trace| !self.traces.contains(trace)).copied().collect::<Vec<_>>();
                self.traces.extend(new);
            }
            Record::LastExposed { job, layer } => {
                self.exposed_before = Some(ExposureId::first_pass(*job, *layer));
            }
            Record::LastExposedPass { job, layer, pass } => {
                self.exposed_before = Some(ExposureId { job: *job, layer: *layer, pass: *pass });
            }
            Record::Passes(passes) => {
                if self.state != JobState::Queued {
                    return Err("its exposures are told after it began".into());
                }
                passes.check(self.passes.layer_count())?;
                self.passes = passes.clone();
            }
            Record::Parked => self.parked = true,
            Record::Ended { state, reason } => {
                self.state = *state;
                self.reason.clone_from(reason);
            }
        }
        Ok(())
    }

    /// Ends what is open about the next layer, and goes on to the one after it if it is exposed.
    fn close(&mut self, exposed: bool) {
        self.unconfirmed = None;
        self.in_doubt = None;
        if exposed {
            self.next_exposure += 1;
            self.next_vector = 0;
        }
    }

    fn expect_next(&self, exposure: u32) -> Result<(), String> {
        let (next, count) = (self.next_exposure, self.passes.exposure_count());
        if exposure == next && exposure <= count {
            return Ok(());
        }
        Err(format!("exposure {exposure}, where exposure {next} is next in a job of {count}"))
    }

    fn expect_commanded(&self, exposure: u32) -> Result<(), String> {
        self.expect_next(exposure)?;
        if self.unconfirmed.is_none() && self.in_doubt.is_none() {
            return Err(format!("exposure {exposure} was not commanded"));
        }
        Ok(())
    }
}
