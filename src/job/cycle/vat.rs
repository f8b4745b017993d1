//! The cycle of a machine with a vat. The plate hangs in the resin, and a projector exposes a layer through the bottom of the
//! vat. See it used by the whole of `tests/job_engine` and `tests/job_lies`.
//!
//! ```text
//!   position unknown, plate bare:  Home
//!   layer exposed last sticks:     Lift ──▶ Drip (wait_after_lift)            ──▶ Clear
//!   begin:                         Approach ──▶ Settle (light_off_delay +
//!                                               wait_before_exposure)         ──▶ Ready
//!   after an exposure:             Cure (wait_after_exposure)                 ──▶ Free
//!   pause or end:                  Park                                       ──▶ Parked
//! ```
//!
//! What is safe in a vat:
//! - Homing drives the plate to the bottom of the vat, and would crush a part. The plate is homed only while it is bare: a device
//!   that lost its position after the job may have had light moves nothing more.
//! - A part must not stay in the resin. Every pause, stop, abort and failure lifts the plate clear of it, if the device can move and
//!   knows its position. That lift goes up only: it is safe whatever the journal says.
//! - A layer is peeled off the bottom of the vat before the plate moves down again.
//! - A plate that is not where it was sent, or that arrives sooner than it can, ends the print. It is lifted clear once; if that
//!   very lift is the one that failed, the plate stays where it is.

mod plan;
mod texts;

pub use plan::VatPlan;
pub(super) use texts::{SLOW_DISK, UNPARKED, remedy_of_act, remedy_of_upload};

use texts::POSITION_LOST;

use super::plate::HOMING_US;
use super::{Done, Exposure, Goal, Lit, Step, TooSoon};
use crate::device::{Act, Dose, Pass, Passes, VatAct, VatOutcome, least_exposure_us};
use crate::link::message::DeviceState;
use crate::text::mm_text;

/// Plate and vat.
#[derive(Debug)]
pub(in crate::job) struct VatCycle {
    plan: VatPlan,
    passes: Passes,
    stage: Stage,
    /// Where the plate is; `None` if the device does not know.
    position_um: Option<i32>,
    max_position_um: i32,
    /// The layer exposed last still sticks to the bottom of the vat.
    sticks: bool,
}

/// What the plate is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Still,
    /// On its way to this position, micrometres.
    Moving(Move, i32),
    Dripping,
    Settling,
    Curing,
    /// Clear of the resin.
    Parked,
}

/// What a move is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Move {
    Home,
    Lift,
    Approach,
    Park,
}

impl VatCycle {
    pub(super) fn new(plan: VatPlan, passes: Passes, part_possible: bool) -> Self {
        Self { plan, passes, stage: Stage::Still, position_um: None, max_position_um: 0, sticks: part_possible }
    }

    pub(super) fn greeted(&mut self, max_position_um: i32) {
        self.max_position_um = max_position_um;
    }

    pub(super) fn check_fit(&self, layer_count: u32) -> Result<(), String> {
        let height_um = self.plan.positions().part_height_um(layer_count);
        if height_um > f64::from(self.max_position_um) {
            return Err(format!(
                "the part needs the plate {} above the vat, the device goes up to {}: choose a lower part",
                mm_text(height_um),
                mm_text(self.max_position_um)
            ));
        }
        Ok(())
    }

    pub(super) fn notice(&self) -> Option<String> {
        (self.plan.clear_height_um > f64::from(self.max_position_um)).then(|| {
            format!(
                "the plate cannot lift to the machine's clear height of {}: the device goes up to {}, and it rests there",
                mm_text(self.plan.clear_height_um),
                mm_text(self.max_position_um)
            )
        })
    }

    pub(super) fn locate(&mut self, state: &DeviceState) {
        self.position_um = state.position_um;
    }

    pub(super) fn rest(&mut self, state: &DeviceState) {
        if self.stage == Stage::Parked && Some(state.position_um.unwrap_or(i32::MIN)) < self.position_um {
            self.stage = Stage::Still;
        }
        self.position_um = state.position_um;
    }

    pub(super) fn moved(&mut self, state: &DeviceState) -> Option<String> {
        let left_um = self.plan.positions().moved(&mut self.position_um, state)?;
        let found = self
            .position_um
            .map_or("at a position that it no longer knows".into(), |found_um| format!("at {}", mm_text(found_um)));
        Some(format!(
            "the device says its plate is {found}; it was left at {}. Look at the machine, then resume",
            mm_text(left_um)
        ))
    }

    pub(super) fn prepare(&mut self, next_exposure: u32, part_possible: bool) -> Step {
        self.break_off();
        match self.position_um {
            None if part_possible => Step::Halt(POSITION_LOST.into()),
            None => {
                self.stage = Stage::Moving(Move::Home, 0);
                Step::Act { act: Act::Vat(VatAct::Home), most_us: HOMING_US, least_us: 0 }
            }
            Some(position_um) if self.sticks => self.lift(position_um, next_exposure),
            Some(_) => Step::Clear,
        }
    }

    fn lift(&mut self, position_um: i32, next_exposure: u32) -> Step {
        let exposed = self.passes.at(next_exposure.saturating_sub(1)).layer;
        let to_um = self.plan.lifted_position_um(exposed).min(self.max_position_um);
        if position_um >= to_um {
            self.sticks = false;
            return Step::Clear;
        }
        self.travel(Move::Lift, to_um, self.plan.recipe.lift_speed_um_s)
    }

    pub(super) fn begin(&mut self, exposure: u32) -> Step {
        let to_um = self.plan.positions().layer_um(self.passes.at(exposure).layer);
        if self.position_um == Some(to_um) {
            return self.settle();
        }
        self.travel(Move::Approach, to_um, self.plan.recipe.retract_speed_um_s)
    }

    fn settle(&mut self) -> Step {
        self.stage = Stage::Settling;
        Step::Wait { us: self.plan.settle_us(), may_break_off: true }
    }

    pub(super) fn light_ms(&self, exposure: u32) -> u32 {
        self.plan.exposure_ms(self.passes.at(exposure).layer)
    }

    pub(super) fn exposure(&mut self, exposure: u32) -> Exposure {
        self.stage = Stage::Still;
        let Pass { layer, pass, .. } = self.passes.at(exposure);
        let duration_ms = self.light_ms(exposure);
        let act = Act::Vat(VatAct::Expose { layer, pass, duration_ms, light_pwm: self.plan.recipe.light_pwm });
        Exposure { act, limit_ms: duration_ms, least_us: least_exposure_us(duration_ms) }
    }

    pub(super) fn judge(&self, exposure: u32, outcome: VatOutcome) -> Option<Lit> {
        let Pass { layer, pass, .. } = self.passes.at(exposure);
        match outcome {
            VatOutcome::Exposed { layer: lit_layer, pass: lit_pass, duration_ms: light_ms }
                if (lit_layer, lit_pass) == (layer, pass) =>
            {
                Some(Lit { light_ms, starved_ms: 0, dose: Dose::of(self.light_ms(exposure), light_ms) })
            }
            VatOutcome::Exposed { .. } | VatOutcome::Arrived { .. } | VatOutcome::Changed { .. } => None,
        }
    }

    pub(super) fn note_exposed(&mut self) {
        self.sticks = true;
    }

    /// The resin must set before the layer is peeled off, so this wait is never cut short.
    pub(super) fn after_exposure(&mut self) -> Step {
        self.stage = Stage::Curing;
        Step::Wait { us: u64::from(self.plan.recipe.wait_after_exposure_ms) * 1000, may_break_off: false }
    }

    pub(super) fn park(&mut self, next_exposure: u32, is_faulty: bool) -> Step {
        self.break_off();
        let to_um = self.parking_um(next_exposure);
        match self.position_um {
            Some(position_um) if position_um >= to_um => self.parked(),
            Some(_) if is_faulty => Step::Unparked("the device has a fault"),
            Some(_) => self.travel(Move::Park, to_um, self.plan.recipe.lift_speed_um_s),
            None => Step::Unparked("the device does not know where it is"),
        }
    }

    /// Position at which the plate is clear of the resin, micrometres.
    fn parking_um(&self, next_exposure: u32) -> i32 {
        let exposed = next_exposure.checked_sub(1).map(|exposure| self.passes.at(exposure).layer);
        self.plan.parked_position_um(exposed).min(self.max_position_um)
    }

    fn parked(&mut self) -> Step {
        self.stage = Stage::Parked;
        Step::Parked
    }

    fn travel(&mut self, purpose: Move, position_um: i32, speed_um_s: u32) -> Step {
        self.stage = Stage::Moving(purpose, position_um);
        let act = Act::Vat(VatAct::Move { position_um, speed_um_s });
        self.plan.positions().travel(act, self.position_um, position_um, speed_um_s)
    }

    pub(super) fn done(
        &mut self,
        outcome: VatOutcome,
        next_exposure: u32,
        too_soon: Option<&TooSoon>,
        goal: Goal,
    ) -> Option<Done> {
        let VatOutcome::Arrived { position_um } = outcome else { return None };
        let Stage::Moving(purpose, to_um) = self.stage else { return None };
        self.stage = Stage::Still;
        self.position_um = Some(position_um);
        if self.plan.positions().is_off(position_um, to_um) {
            return Some(self.misplaced(purpose, position_um, to_um));
        }
        if let Some(too_soon) = too_soon {
            return Some(self.arrived_too_soon(purpose, to_um, next_exposure, too_soon));
        }
        let step = match (purpose, goal) {
            (Move::Lift, _) => {
                self.sticks = false;
                self.stage = Stage::Dripping;
                Step::Wait { us: u64::from(self.plan.recipe.wait_after_lift_ms) * 1000, may_break_off: true }
            }
            (Move::Approach, Goal::Print) => self.settle(),
            (Move::Park, Goal::Park) => self.parked(),
            (Move::Home, _) | (Move::Approach, Goal::Park) | (Move::Park, Goal::Print) => Step::Free,
        };
        Some(Done { problem: None, step })
    }

    /// A move ended at the wrong position.
    fn misplaced(&mut self, purpose: Move, position_um: i32, to_um: i32) -> Done {
        let [position, target] = [position_um, to_um].map(mm_text);
        let problem = Some(format!("the plate is at {position} instead of {target}: check the axis, then resume"));
        let step = match purpose {
            Move::Park if position_um > to_um => self.parked(),
            Move::Park => Step::Unparked("the move ended too low"),
            Move::Home | Move::Lift | Move::Approach => Step::Free,
        };
        Done { problem, step }
    }

    /// The device says that its plate arrived sooner than it can by the host's clock.
    fn arrived_too_soon(&self, purpose: Move, to_um: i32, next_exposure: u32, too_soon: &TooSoon) -> Done {
        let problem = Some(format!(
            "the device says that its plate arrived at {} {} ms after the order, which is too soon: check the axis and the device{}",
            mm_text(to_um),
            too_soon.took_us / 1000,
            too_soon.hint
        ));
        let may_lift = purpose != Move::Park && self.position_um < Some(self.parking_um(next_exposure));
        let step = if may_lift { Step::Free } else { Step::Unparked("the device says so too soon") };
        Done { problem, step }
    }

    pub(super) fn waited(&mut self) -> Step {
        let ready = self.stage == Stage::Settling;
        self.break_off();
        if ready { Step::Ready } else { Step::Free }
    }

    /// The step under way ends here, if there is one: the line was lost, the act was withdrawn, or the job ends.
    fn break_off(&mut self) {
        if self.stage != Stage::Parked {
            self.stage = Stage::Still;
        }
    }

    pub(super) fn is_parked(&self) -> bool {
        self.stage == Stage::Parked
    }

    pub(super) fn may_be_left(&self) -> bool {
        matches!(self.stage, Stage::Moving(Move::Home, _))
    }

    pub(super) fn overdue_text(&self, is_taken: bool) -> String {
        match self.stage {
            Stage::Moving(_, to_um) if is_taken => format!(
                "the device did not say in time that its plate arrived at {}: check the axis and the device",
                mm_text(to_um)
            ),
            _ => "the order to move the plate did not reach the device in time: check the line".into(),
        }
    }
}
