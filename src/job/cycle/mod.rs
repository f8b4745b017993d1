//! What a machine does between two layers, by kind of machine. The engine knows the life of a job, its journal, its light and its
//! line; a cycle knows the machine.
//!
//! A [`Cycle`] is a state machine without I/O and without a clock. The engine asks it for the next [`Step`], carries that out, and
//! reports how it ended:
//!
//! ```text
//!   engine                                        cycle
//!   the job is to print                         ▶ prepare  ─▶ Act, Wait … until Clear
//!   the layer is on its way or there            ▶ begin    ─▶ Act, Wait … until Ready
//!   the layer is there: journal, then expose    ▶ exposure ─▶ the act and its times
//!   the device reports the exposure             ▶ judge    ─▶ its light time, compared with the commanded one
//!   the layer is confirmed, and on disk         ▶ after_exposure ─▶ Wait
//!   the job pauses or ends, however it does     ▶ park     ─▶ Act … until Parked or Unparked
//!
//!   an act ended                                ▶ done     ─▶ the next Step, and what is wrong
//!   a Wait is over                              ▶ waited   ─▶ the next Step
//!   the device reported its state               ▶ locate, rest or moved
//! ```
//!
//! Exposures have the numbers of [`Passes`](crate::device::Passes). A bed of powder has one for each layer.
//!
//! After [`Step::Free`] the engine looks at light, line, orders and disk, and then asks for [`Cycle::prepare`] or [`Cycle::park`]
//! again. So a cycle never decides whether the print goes on. It decides what is safe for the machine: whether the machine may
//! search its zero position, and where a part is safe while nothing is printed.
//!
//! A new kind of machine becomes a variant of [`Cycle`], [`super::Process`], [`Act`] and [`Outcome`]. [`Step::Wait`] also
//! serves for a state of the machine that the engine does not know: the cycle sees every reported state, and may answer
//! [`Cycle::waited`] with another wait. `job/engine/steps.rs` uses this interface.

mod plate;
mod powder;
mod vat;

pub use powder::{LEFTOVER_MS, PowderPlan};
pub use vat::VatPlan;

use powder::PowderCycle;
use vat::VatCycle;

use super::{JobPlan, Process, StartPoint};
use crate::device::{Act, Dose, Outcome, ScanTimes};
use crate::link::message::{DeviceState, Refusal};

/// The machine's side of a job.
#[derive(Debug)]
pub(super) enum Cycle {
    /// Resin in a vat.
    Vat(VatCycle),
    /// Powder in a bed.
    Powder(PowderCycle),
}

/// The limits of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The plate's greatest distance from the plane in which layers are exposed, micrometres.
    pub max_position_um: i32,
    /// Longest exposure, milliseconds.
    pub max_exposure_ms: u32,
}

/// What the engine must do next.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Step {
    /// Nothing is under way: decide again whether to print or to park.
    Free,
    /// Nothing is left to do for the layers before: the next layer may begin.
    Clear,
    /// The machine is in place: expose the layer.
    Ready,
    /// Carry out this act.
    Act {
        act: Act,
        /// It must have ended after this time of the host's clock, microseconds.
        most_us: u64,
        /// It takes this time of the device's clock at least, microseconds; 0 if that is unknown.
        least_us: u64,
    },
    /// Let the machine stand still, dark.
    Wait {
        us: u64,
        /// Whether a pause or an end of the job may cut the wait short.
        may_break_off: bool,
    },
    /// The machine is parked: the part is safe.
    Parked,
    /// The machine cannot be parked; says why.
    Unparked(&'static str),
    /// The machine must not move any more. Ends the job; says why and what to do.
    Halt(String),
}

/// What the engine wants of the machine once the act under way has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Goal {
    /// Print on.
    Print,
    /// Pause or end.
    Park,
}

/// An exposure of a layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Exposure {
    pub(super) act: Act,
    /// The light must be off after this time, milliseconds.
    pub(super) limit_ms: u32,
    /// Least time until its end is reported, microseconds of the device's clock.
    pub(super) least_us: u64,
}

/// The light of an exposure, as the device reported it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Lit {
    /// Light time, milliseconds.
    pub(super) light_ms: u32,
    /// How long the laser waited, off, for layer data, milliseconds.
    pub(super) starved_ms: u32,
    /// How that compares with the commanded time.
    pub(super) dose: Dose,
}

/// An act is reported to have ended sooner than it can.
#[derive(Clone, Debug)]
pub(super) struct TooSoon {
    /// Time since the act was handed to the line, microseconds of the host's clock.
    pub(super) took_us: u64,
    /// A hint to the operator, to be added to the message; may be empty.
    pub(super) hint: String,
}

/// The end of an act.
#[derive(Debug)]
pub(super) struct Done {
    /// What is wrong with it, and what to do. The print must end.
    pub(super) problem: Option<String>,
    pub(super) step: Step,
}

impl Cycle {
    /// A machine of which nothing is known yet, to go on from `start`.
    pub(super) fn new(plan: &JobPlan, start: StartPoint) -> Self {
        match &plan.process {
            Process::Vat(vat) => Self::Vat(VatCycle::new(vat.clone(), plan.passes.clone(), start.touched)),
            Process::Powder(plan) => Self::Powder(PowderCycle::new(plan.clone(), start.from_vector)),
        }
    }

    /// A session with a device of these limits began.
    pub(super) fn greeted(&mut self, limits: Limits) {
        match self {
            Self::Vat(vat) => vat.greeted(limits.max_position_um),
            Self::Powder(powder) => powder.greeted(limits.max_position_um, limits.max_exposure_ms),
        }
    }

    /// Checks that a part of so many layers fits the machine.
    ///
    /// # Errors
    /// What does not fit, and what to do.
    pub(super) fn check_fit(&self, layer_count: u32) -> Result<(), String> {
        match self {
            Self::Vat(vat) => vat.check_fit(layer_count),
            Self::Powder(powder) => powder.check_fit(layer_count),
        }
    }

    /// What the operator must know of this machine before the print begins.
    pub(super) fn notice(&self) -> Option<String> {
        match self {
            Self::Vat(vat) => vat.notice(),
            Self::Powder(_) => None,
        }
    }

    /// Takes over where the machine is, after a time in which it may have moved by order.
    pub(super) fn locate(&mut self, state: &DeviceState) {
        match self {
            Self::Vat(vat) => vat.locate(state),
            Self::Powder(powder) => powder.locate(state),
        }
    }

    /// Takes over where the machine is during a pause: the operator may move it.
    pub(super) fn rest(&mut self, state: &DeviceState) {
        match self {
            Self::Vat(vat) => vat.rest(state),
            Self::Powder(powder) => powder.locate(state),
        }
    }

    /// Compares where the machine is with where it was left. Call it only while nothing moves by order. Returns a message for the
    /// operator if it has moved; the print must end then.
    pub(super) fn moved(&mut self, state: &DeviceState) -> Option<String> {
        match self {
            Self::Vat(vat) => vat.moved(state),
            Self::Powder(powder) => powder.moved(state),
        }
    }

    /// Whether the act under way is to leave the plate where it is.
    pub(super) fn plate_rests(&self) -> bool {
        match self {
            Self::Vat(_) => false,
            Self::Powder(powder) => powder.plate_rests(),
        }
    }

    /// The next step to make the machine ready for the exposure `next_exposure`, until [`Step::Clear`].
    pub(super) fn prepare(&mut self, next_exposure: u32, part_possible: bool) -> Step {
        match self {
            Self::Vat(vat) => vat.prepare(next_exposure, part_possible),
            Self::Powder(powder) => powder.prepare(part_possible),
        }
    }

    /// The next step to bring the machine to where a layer is exposed, until [`Step::Ready`]. [`Step::Clear`] came before.
    pub(super) fn begin(&mut self, exposure: u32) -> Step {
        match self {
            Self::Vat(vat) => vat.begin(exposure),
            Self::Powder(powder) => powder.begin(exposure),
        }
    }

    /// The device holds a layer; `times` says how long a laser takes for it.
    pub(super) fn sent(&mut self, exposure: u32, times: Option<ScanTimes>) {
        match (self, times) {
            (Self::Powder(powder), Some(times)) => powder.sent(exposure, times),
            (Self::Vat(_), _) | (Self::Powder(_), None) => {}
        }
    }

    /// Whether enough is known of a layer that the device holds to expose it.
    pub(super) fn knows(&self, exposure: u32) -> bool {
        match self {
            Self::Vat(_) => true,
            Self::Powder(powder) => powder.knows(exposure),
        }
    }

    /// How the layer is exposed. [`Step::Ready`] came before.
    pub(super) fn exposure(&mut self, exposure: u32) -> Exposure {
        match self {
            Self::Vat(vat) => vat.exposure(exposure),
            Self::Powder(powder) => powder.exposure(exposure),
        }
    }

    /// Commanded light time of a layer, milliseconds; `None` if it is not known.
    pub(super) fn light_ms(&self, exposure: u32) -> Option<u32> {
        match self {
            Self::Vat(vat) => Some(vat.light_ms(exposure)),
            Self::Powder(powder) => powder.light_ms(exposure),
        }
    }

    /// Longest light of an exposure that an earlier session commanded, milliseconds.
    pub(super) fn leftover_ms(&self, exposure: u32) -> u32 {
        match self {
            Self::Vat(vat) => vat.light_ms(exposure),
            Self::Powder(_) => powder::LEFTOVER_MS,
        }
    }

    /// The light that an outcome reports for this exposure; `None` if the outcome is not that of it.
    pub(super) fn judge(&self, exposure: u32, outcome: Outcome) -> Option<Lit> {
        match (self, outcome) {
            (Self::Vat(vat), Outcome::Vat(outcome)) => vat.judge(exposure, outcome),
            (Self::Powder(powder), Outcome::Powder(outcome)) => powder.judge(exposure, outcome),
            (_, Outcome::Vat(_) | Outcome::Powder(_) | Outcome::Refused(_) | Outcome::TakenBack) => None,
        }
    }

    /// Whether a machine of this kind can go on with a layer whose light ended early.
    pub(super) fn continues(&self) -> bool {
        match self {
            Self::Vat(_) => false,
            Self::Powder(_) => true,
        }
    }

    /// The layer was marked up to this vector. Returns how many vectors that is more than before; `None` if it cannot be.
    pub(super) fn marked_to(&mut self, exposure: u32, next_vector: u32) -> Option<u32> {
        match self {
            Self::Vat(_) => None,
            Self::Powder(powder) => powder.marked_to(exposure, next_vector),
        }
    }

    /// The exposure before the next one counts as done.
    pub(super) fn note_exposed(&mut self) {
        match self {
            Self::Vat(vat) => vat.note_exposed(),
            Self::Powder(powder) => powder.note_exposed(),
        }
    }

    /// The first step after an exposure.
    pub(super) fn after_exposure(&mut self) -> Step {
        match self {
            Self::Vat(vat) => vat.after_exposure(),
            Self::Powder(_) => Step::Free,
        }
    }

    /// The next step to a place where the machine can rest and the part is safe, until [`Step::Parked`] or [`Step::Unparked`].
    /// `is_faulty` forbids to move.
    pub(super) fn park(&mut self, next_exposure: u32, is_faulty: bool) -> Step {
        match self {
            Self::Vat(vat) => vat.park(next_exposure, is_faulty),
            Self::Powder(powder) => powder.park(),
        }
    }

    /// The act of a step has ended. Returns `None` if the outcome is not that of the act.
    pub(super) fn done(
        &mut self,
        outcome: Outcome,
        next_exposure: u32,
        too_soon: Option<&TooSoon>,
        goal: Goal,
    ) -> Option<Done> {
        match (self, outcome) {
            (Self::Vat(vat), Outcome::Vat(outcome)) => vat.done(outcome, next_exposure, too_soon, goal),
            (Self::Powder(powder), Outcome::Powder(outcome)) => powder.done(outcome, too_soon, goal),
            (_, Outcome::Vat(_) | Outcome::Powder(_) | Outcome::Refused(_) | Outcome::TakenBack) => None,
        }
    }

    /// The device refused the act under way because it is busy. Returns a wait, if it may be busy with an act of the session before.
    pub(super) fn busy(&mut self) -> Option<Step> {
        match self {
            Self::Vat(_) => None,
            Self::Powder(powder) => powder.busy(),
        }
    }

    /// A [`Step::Wait`] is over.
    pub(super) fn waited(&mut self) -> Step {
        match self {
            Self::Vat(vat) => vat.waited(),
            Self::Powder(powder) => powder.waited(),
        }
    }

    /// Whether the machine is parked.
    pub(super) fn is_parked(&self) -> bool {
        match self {
            Self::Vat(vat) => vat.is_parked(),
            Self::Powder(powder) => powder.is_parked(),
        }
    }

    /// Whether the act under way can be left to itself when the daemon ends: no part is in its way, and nothing follows.
    pub(super) fn may_be_left(&self) -> bool {
        match self {
            Self::Vat(vat) => vat.may_be_left(),
            Self::Powder(powder) => powder.may_be_left(),
        }
    }

    /// What to tell the operator if the act under way has not ended in time. `is_taken` says that the device has received it.
    pub(super) fn overdue_text(&self, is_taken: bool) -> String {
        match self {
            Self::Vat(vat) => vat.overdue_text(is_taken),
            Self::Powder(powder) => powder.overdue_text(is_taken),
        }
    }

    /// Why a device refused an act or a layer, and what to do.
    pub(super) fn remedy(&self, request: Requested, refusal: Refusal) -> &'static str {
        match (self, request) {
            (Self::Vat(_), Requested::Upload) => vat::remedy_of_upload(refusal),
            (Self::Vat(_), Requested::Act) => vat::remedy_of_act(refusal),
            (Self::Powder(_), Requested::Upload) => powder::remedy_of_upload(refusal),
            (Self::Powder(_), Requested::Act) => powder::remedy_of_act(refusal),
        }
    }

    /// Says that the machine was not parked.
    pub(super) fn unparked_text(&self) -> &'static str {
        match self {
            Self::Vat(_) => vat::UNPARKED,
            Self::Powder(_) => powder::UNPARKED,
        }
    }

    /// Says what is done about a part while the disk is slow.
    pub(super) fn slow_disk_text(&self) -> &'static str {
        match self {
            Self::Vat(_) => vat::SLOW_DISK,
            Self::Powder(_) => powder::SLOW_DISK,
        }
    }
}

/// What a device was asked for when it refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Requested {
    /// To hold a layer.
    Upload,
    /// To move or expose.
    Act,
}
