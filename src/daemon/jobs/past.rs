//! What is known of a job's light and plate, from its journal and its engine. It outlives the engine, and a crash.
//! `printer/plate.rs` asks it what may be on the plate.

use crate::device::Passes;
use crate::job::{Command, EndOrder, Engine, History, PlateAfter, Trace, Unconfirmed};

/// A job's light and plate so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Past {
    /// Whether it may have had light, so that the part on the plate is its own.
    pub touched: bool,
    /// Whether it ended with its plate clear of the resin.
    pub lifted: bool,
    /// The exposures of its layers.
    pub passes: Passes,
    /// The exposure that was commanded and neither confirmed nor refuted.
    pub unconfirmed: Option<Unconfirmed>,
    /// The boot of the device on whose bare plate it began.
    pub plate_clear_on: Option<u32>,
    /// Exposures of unknown jobs that the operator has confirmed.
    pub traces: Vec<Trace>,
    /// The operator's order to end; afterwards it can only end.
    pub ordered: Option<EndOrder>,
    /// Whether none of this is known, because its journal cannot be read.
    pub unknown: bool,
}

impl Past {
    /// The past of a job just accepted.
    pub(crate) fn of_new(passes: Passes) -> Self {
        Self { passes, ..Self::default() }
    }

    /// The past of a job whose journal cannot be read.
    pub(crate) fn unknown() -> Self {
        Self { unknown: true, ..Self::default() }
    }

    /// Copies what the engine knows when it is done.
    pub(crate) fn update(&mut self, engine: &Engine) {
        self.touched = engine.touched();
        self.lifted = !engine.progress().part_unparked;
        self.unconfirmed = engine.unconfirmed();
        // It began with what the journal says.
        self.unknown = false;
    }

    /// Notes an order to end.
    pub(crate) fn order(&mut self, command: Command) {
        self.ordered = match command {
            Command::Abort => Some(EndOrder::Abort),
            Command::Stop => self.ordered.or(Some(EndOrder::Stop)),
            Command::Pause | Command::Resume => self.ordered,
        };
    }

    /// Where its plate is, for a job that ends without getting the machine.
    pub(crate) fn plate_text(&self) -> &'static str {
        match (self.unknown, self.touched, self.lifted) {
            (true, ..) => "it is unknown whether its plate was lifted; check the plate and the light",
            (_, true, true) => "its plate was lifted clear when it was interrupted",
            (_, true, false) => "the plate was not lifted; check the plate and the light",
            (_, false, _) => "it had no light",
        }
    }

    /// What it says about the plate after its end.
    pub(crate) fn plate_after(&self) -> PlateAfter {
        match (self.unknown, self.touched, self.lifted) {
            (true, ..) | (_, true, false) => PlateAfter::Left,
            (_, true, true) => PlateAfter::Clear,
            (_, false, _) if self.plate_clear_on.is_some() => PlateAfter::Clear,
            _ => PlateAfter::Unsaid,
        }
    }
}

impl From<&History> for Past {
    fn from(history: &History) -> Self {
        Self {
            touched: history.touched(),
            passes: history.passes.clone(),
            lifted: history.parked,
            unconfirmed: history.unconfirmed,
            plate_clear_on: history.plate_clear_on,
            traces: history.traces.clone(),
            ordered: history.ordered,
            unknown: false,
        }
    }
}
