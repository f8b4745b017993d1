//! The records of a journal, and the state that follows from them.

use bincode::{Decode, Encode};
use serde::Serialize;

use super::JobState;

/// One fact. A record that announces an act is on disk before the act begins.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub enum Record {
    /// The job was accepted. Always the first record.
    Accepted {
        /// Identifies the job's exposures to the device: random, never 0.
        key: u64,
        /// Number of layers.
        layer_count: u32,
        /// Name of the part, for people.
        name: String,
    },
    /// An engine took over the job. The layers from this one on are still to be exposed.
    Started {
        /// The next layer.
        layer: u32,
    },
    /// This layer's exposure is about to be commanded.
    Commanded {
        /// The layer.
        layer: u32,
        /// [`crate::link::message::DeviceState::boot_id`] of the device it is commanded to.
        boot_id: u32,
    },
    /// The device exposed the layer for its whole time.
    Confirmed {
        /// The layer.
        layer: u32,
    },
    /// The layer was commanded, and by the device's word not exposed. Whether it had light rests on that word alone.
    NotExposed {
        /// The layer.
        layer: u32,
    },
    /// The layer was commanded, and it is unknown how much light it had.
    InDoubt {
        /// The layer.
        layer: u32,
        /// What is known.
        why: String,
    },
    /// The operator settled a layer in doubt.
    Decided {
        /// The layer.
        layer: u32,
        /// Whether it counts as exposed; otherwise it is exposed again.
        exposed: bool,
    },
    /// The plate rests clear of the resin.
    Paused,
    /// Printing goes on after a pause.
    Resumed,
    /// The device confirmed that its light is off after an abort.
    LightOff,
    /// The engine has ended the job.
    Ended {
        /// The last state.
        state: JobState,
        /// Why.
        reason: String,
    },
    /// The operator ordered the end of the job. It never prints again, not even after a restart.
    Ordered(EndOrder),
    /// Written before the first downward move of a job without light: the plate is empty, or the operator confirmed that it is.
    PlateClear {
        /// [`crate::link::message::DeviceState::boot_id`] of the device.
        boot_id: u32,
        /// Exposures shown by that device and unknown to this spool. The operator has confirmed them.
        traces: Vec<Trace>,
    },
    /// The plate rests clear of the resin. Written before [`Record::Ended`].
    Lifted,
    /// The layer was to be commanded, but the order never left the host: it certainly had no light.
    Withdrawn {
        /// The layer.
        layer: u32,
    },
}

impl Record {
    /// Whether the record tells of an end, or of something that has already happened. Such a record may use the reserved space of
    /// the journal; a record that begins something may not.
    pub fn is_last(&self) -> bool {
        match self {
            Self::Accepted { .. }
            | Self::Started { .. }
            | Self::Commanded { .. }
            | Self::Paused
            | Self::Resumed
            | Self::PlateClear { .. } => false,
            Self::Confirmed { .. }
            | Self::NotExposed { .. }
            | Self::Withdrawn { .. }
            | Self::InDoubt { .. }
            | Self::Decided { .. }
            | Self::LightOff
            | Self::Ordered(_)
            | Self::Lifted
            | Self::Ended { .. } => true,
        }
    }
}

/// How the operator ordered a job to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub enum EndOrder {
    /// After the layer under way.
    Stop,
    /// At once; the light goes off first.
    Abort,
}

impl EndOrder {
    /// The order as the operator types it.
    pub fn verb(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Abort => "abort",
        }
    }
}

/// A trace of an exposure in a device's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Encode, Decode)]
pub enum Trace {
    /// It had light: exposed, cut short, or still under way.
    Lit {
        /// Key of the job.
        job: u64,
        /// The layer.
        layer: u32,
    },
    /// It is in one of the device's slots.
    Held {
        /// Key of the job.
        job: u64,
        /// The layer.
        layer: u32,
    },
}

/// A layer that was commanded and neither confirmed nor denied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unconfirmed {
    /// The layer.
    pub layer: u32,
    /// Boot id of the device that it was commanded to.
    pub boot_id: u32,
}

/// The state that follows from a journal's records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct History {
    /// Identifies the job's exposures.
    pub key: u64,
    /// Name of the part.
    pub name: String,
    /// Number of layers.
    pub layer_count: u32,
    /// The state without an engine: a job that was active is [`JobState::Interrupted`].
    pub state: JobState,
    /// The first layer not known to be exposed.
    pub next_layer: u32,
    /// [`History::next_layer`] was commanded; only the device knows the outcome.
    pub unconfirmed: Option<Unconfirmed>,
    /// [`History::next_layer`] was commanded, and not even the device knows the outcome. Says what is known; the operator must
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
    /// The job ended with its plate clear of the resin.
    pub lifted: bool,
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
    /// The first layer not known to be exposed.
    pub next_layer: u32,
    /// That layer was commanded: the device must be asked first.
    pub unconfirmed: Option<Unconfirmed>,
    /// That layer is in doubt. The choice decides, unless the device knows the outcome.
    pub in_doubt: bool,
    /// The operator's decision.
    pub choice: ResumeChoice,
    /// [`History::touched`].
    pub touched: bool,
    /// The device confirmed a layer of this job. Until it prints another job, its last exposure belongs to this one.
    pub confirmed: bool,
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
        "layer {layer} is in doubt: {why}. Look at the part, then run `layerctl resume JOB --in-doubt exposed` to go on \
         with layer {}, or `layerctl resume JOB --in-doubt repeat` to expose layer {layer} again", layer + 1
    )]
    InDoubt {
        /// The layer.
        layer: u32,
        /// What is known.
        why: String,
    },
    /// The operator spoke of a layer that is not in doubt.
    #[error(
        "no layer is in doubt: the layers below {next_layer} are exposed, and layer {next_layer} is not; resume without \
         --in-doubt"
    )]
    NoDoubt {
        /// The first layer not exposed.
        next_layer: u32,
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
            layer_count: *layer_count,
            state: JobState::Queued,
            next_layer: 0,
            unconfirmed: None,
            in_doubt: None,
            reason: String::new(),
            ordered: None,
            plate_clear_on: None,
            traces: Vec::new(),
            lifted: false,
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
            (Some(why), ResumeChoice::None) => Err(ResumeError::InDoubt { layer: self.next_layer, why: why.clone() }),
            (None, ResumeChoice::AssumeExposed | ResumeChoice::Repeat) if self.unconfirmed.is_none() => {
                Err(ResumeError::NoDoubt { next_layer: self.next_layer })
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
            next_layer: self.next_layer,
            unconfirmed: self.unconfirmed,
            in_doubt: self.in_doubt.is_some(),
            choice,
            touched: self.touched(),
            confirmed: self.confirmed,
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
            Record::Started { layer } => {
                self.expect_next(*layer)?;
                self.state = JobState::Printing;
                self.lifted = false;
                self.reason.clear();
            }
            Record::Commanded { layer, boot_id } => {
                self.expect_next(*layer)?;
                if self.in_doubt.is_some() || self.unconfirmed.is_some() {
                    return Err(format!("layer {layer} is commanded twice"));
                }
                self.unconfirmed = Some(Unconfirmed { layer: *layer, boot_id: *boot_id });
            }
            Record::Confirmed { layer } => {
                self.expect_commanded(*layer)?;
                (self.lit, self.confirmed) = (true, true);
                self.settle(true);
            }
            Record::NotExposed { layer } => {
                self.expect_commanded(*layer)?;
                self.lit = true;
                self.settle(false);
            }
            Record::Withdrawn { layer } => {
                self.expect_commanded(*layer)?;
                self.settle(false);
            }
            Record::InDoubt { layer, why } => {
                self.expect_commanded(*layer)?;
                self.unconfirmed = None;
                self.lit = true;
                self.in_doubt = Some(why.clone());
            }
            Record::Decided { layer, exposed } => {
                self.expect_commanded(*layer)?;
                self.lit = true;
                self.settle(*exposed);
            }
            Record::Paused => self.state = JobState::Paused,
            Record::Resumed => self.state = JobState::Printing,
            Record::LightOff => {}
            // An abort outranks a stop, whatever the order.
            Record::Ordered(order) => {
                self.ordered = self.ordered.filter(|known| *known == EndOrder::Abort).or(Some(*order));
            }
            Record::PlateClear { boot_id, traces } => {
                self.plate_clear_on = Some(*boot_id);
                let new = traces.iter().filter(|trace| !self.traces.contains(trace)).copied().collect::<Vec<_>>();
                self.traces.extend(new);
            }
            Record::Lifted => self.lifted = true,
            Record::Ended { state, reason } => {
                self.state = *state;
                self.reason.clone_from(reason);
            }
        }
        Ok(())
    }

    fn settle(&mut self, exposed: bool) {
        self.unconfirmed = None;
        self.in_doubt = None;
        self.next_layer += u32::from(exposed);
    }

    fn expect_next(&self, layer: u32) -> Result<(), String> {
        if layer == self.next_layer && layer <= self.layer_count {
            return Ok(());
        }
        let (next, count) = (self.next_layer, self.layer_count);
        Err(format!("layer {layer}, where layer {next} is next in a job of {count} layers"))
    }

    fn expect_commanded(&self, layer: u32) -> Result<(), String> {
        self.expect_next(layer)?;
        if self.unconfirmed.is_none() && self.in_doubt.is_none() {
            return Err(format!("layer {layer} was not commanded"));
        }
        Ok(())
    }
}
