//! The cycle of a machine with a bed of powder. The plate goes down by a layer height, a recoater spreads powder over it, and a
//! laser melts the layer. See it tested by `tests/job_powder.rs`.
//!
//! ```text
//!   plate bare, and not above layer 0:  Home
//!   begin:                              Lower ──▶ Recoat ──▶ Settle (wait_after_recoat) ──▶ Ready
//!   after a layer:                                                                      ──▶ Free
//!   pause or end:                                                                       ──▶ Parked
//! ```
//!
//! What is safe in a bed of powder:
//! - A part rests in its powder: with the laser off it is safe where it is. So nothing moves for a pause or an end.
//! - The plate only goes down while there may be a part. Homing raises it, so it is homed only while it is bare.
//! - A plate that is not where it was sent, or an act that ends sooner than it can, ends the print.
//! - A recoater goes on when its session is lost, and no state shows it. A device that is busy then is waited for.
//! - A layer that was marked in part goes on with the vector that the device names. It is neither lowered nor recoated again, unless the
//!   device no longer knows that it was recoated.

mod plan;
mod texts;

pub use plan::PowderPlan;
pub(super) use texts::{SLOW_DISK, UNPARKED, remedy_of_act, remedy_of_upload};

use texts::POSITION_LOST;

use super::plate::HOMING_US;
use super::{Done, Exposure, Goal, Lit, Step, TooSoon};
use crate::device::{Act, Dose, PowderAct, PowderOutcome, ScanTimes, least_exposure_us};
use crate::job::ACT_MARGIN_US;
use crate::link::message::DeviceState;
use crate::text::mm_text;

/// Time that marking may take beyond what was computed, milliseconds: waits for layer data, and the first jump.
const MARK_MARGIN_MS: u32 = 5_000;
/// Longest time in which a laser ends the vector that it is on, once its session has ended, milliseconds. Devices refuse longer ones.
pub const LEFTOVER_MS: u32 = 10_000;
/// Time between two looks at a device that is busy with an act of the session before, microseconds: states come twice a second.
const BUSY_WAIT_US: u64 = 500_000;
/// Layers whose times are kept: those of a device's slots ([`MAX_SLOTS`](crate::link::codec::MAX_SLOTS)).
const MAX_KNOWN: usize = 16;

/// Plate, recoater and laser.
#[derive(Debug)]
pub(in crate::job) struct PowderCycle {
    plan: PowderPlan,
    stage: Stage,
    /// Depth of the plate; `None` if the device does not know.
    position_um: Option<i32>,
    max_position_um: i32,
    max_mark_ms: u32,
    recoated: bool,
    /// Times of the layers that were sent to the device, the newest last.
    known: Vec<(u32, ScanTimes)>,
    /// The first vector of the next layer that is not marked.
    from_vector: u32,
    /// How often to wait, in this session, for an act of the session before.
    busy_waits: u64,
}

/// What the machine is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Still,
    Homing,
    /// On its way to this depth, micrometres.
    Lowering(i32),
    Recoating,
    /// The device is busy with an act of the session before: waits until that has spread the powder.
    Busy,
    Settling,
    /// At rest for a pause or an end.
    Parked,
}

impl PowderCycle {
    /// `from_vector` is the first vector of the next layer that is not marked.
    pub(super) fn new(plan: PowderPlan, from_vector: u32) -> Self {
        Self {
            plan,
            stage: Stage::Still,
            position_um: None,
            max_position_um: 0,
            max_mark_ms: 0,
            recoated: false,
            known: Vec::new(),
            from_vector,
            busy_waits: 0,
        }
    }

    pub(super) fn greeted(&mut self, max_position_um: i32, max_exposure_ms: u32) {
        (self.max_position_um, self.max_mark_ms) = (max_position_um, max_exposure_ms);
        self.busy_waits = self.recoat_limit_us() / BUSY_WAIT_US;
    }

    pub(super) fn check_fit(&self, layer_count: u32) -> Result<(), String> {
        let height_um = self.plan.positions().part_height_um(layer_count);
        if height_um > f64::from(self.max_position_um) {
            return Err(format!(
                "the part needs the plate {} below the working plane, the device goes down to {}: choose a lower part",
                mm_text(height_um),
                mm_text(self.max_position_um)
            ));
        }
        Ok(())
    }

    pub(super) fn locate(&mut self, state: &DeviceState) {
        self.position_um = state.position_um;
        self.recoated = state.powder.is_some_and(|powder| powder.recoated);
    }

    pub(super) fn moved(&mut self, state: &DeviceState) -> Option<String> {
        if self.stage == Stage::Busy && state.powder.is_some_and(|powder| powder.recoated) {
            self.recoated = true;
        }
        let left_um = self.plan.positions().moved(&mut self.position_um, state)?;
        let found = self
            .position_um
            .map_or("at a depth that it no longer knows".into(), |found_um| format!("{} deep", mm_text(found_um)));
        Some(format!(
            "the device says its plate is {found}; it was left {} deep. Look at the machine, then resume",
            mm_text(left_um)
        ))
    }

    pub(super) fn prepare(&mut self, part_possible: bool) -> Step {
        self.break_off();
        match self.position_um {
            None if part_possible => Step::Halt(POSITION_LOST.into()),
            Some(position_um) if part_possible || position_um <= self.plan.positions().layer_um(0) => Step::Clear,
            // The plate is bare, and too deep or nobody knows where.
            _ => {
                self.stage = Stage::Homing;
                Step::Act { act: Act::Powder(PowderAct::Home), most_us: HOMING_US, least_us: 0 }
            }
        }
    }

    pub(super) fn begin(&mut self, layer: u32) -> Step {
        let to_um = self.plan.positions().layer_um(layer);
        match self.position_um {
            Some(position_um) if !self.plan.positions().is_off(position_um, to_um) => self.recoat(),
            Some(position_um) if position_um > to_um => Step::Halt(format!(
                "the plate is {} deep, deeper than the {} of layer {layer}: it must not be raised with a part on it. If \
                 somebody moved it, bring it back to that depth at the machine and resume; otherwise abort the job",
                mm_text(position_um),
                mm_text(to_um)
            )),
            // The plate was left where the layer before was marked. A device that lost its power counts from another place.
            Some(position_um) if layer > 0 && self.is_above(position_um, layer - 1) => Step::Halt(format!(
                "the device says its plate is {} deep, but layer {} was marked at {}: it has lost its position, perhaps with its power. \
                 Nothing was moved. Take the part out and start it again",
                mm_text(position_um),
                layer - 1,
                mm_text(self.plan.positions().layer_um(layer - 1))
            )),
            _ => self.lower(to_um),
        }
    }

    /// Whether a plate is higher than where a layer was marked.
    fn is_above(&self, position_um: i32, layer: u32) -> bool {
        let marked_um = self.plan.positions().layer_um(layer);
        position_um < marked_um && self.plan.positions().is_off(position_um, marked_um)
    }

    fn lower(&mut self, position_um: i32) -> Step {
        self.stage = Stage::Lowering(position_um);
        self.recoated = false;
        let speed_um_s = self.plan.recipe.plate_speed_um_s;
        let act = Act::Powder(PowderAct::Move { position_um, speed_um_s });
        self.plan.positions().travel(act, self.position_um, position_um, speed_um_s)
    }

    fn recoat(&mut self) -> Step {
        if self.recoated {
            return self.settle();
        }
        self.stage = Stage::Recoating;
        let recoat_us = u64::from(self.plan.recoat_ms) * 1000;
        // A recoater that was set faster at the machine is not at fault.
        Step::Act { act: Act::Powder(PowderAct::Recoat), most_us: self.recoat_limit_us(), least_us: recoat_us / 2 }
    }

    /// Longest time that the recoater may take.
    fn recoat_limit_us(&self) -> u64 {
        2 * u64::from(self.plan.recoat_ms) * 1000 + ACT_MARGIN_US
    }

    /// The device refused an act because it is busy. After a lost session its recoater may still be at work, which no state shows.
    /// Returns the wait for it; `None` if that cannot be the reason.
    pub(super) fn busy(&mut self) -> Option<Step> {
        if self.stage != Stage::Recoating {
            return None;
        }
        self.busy_waits = self.busy_waits.checked_sub(1)?;
        self.stage = Stage::Busy;
        Some(Step::Wait { us: BUSY_WAIT_US, may_break_off: true })
    }

    fn settle(&mut self) -> Step {
        self.stage = Stage::Settling;
        Step::Wait { us: self.plan.settle_us(), may_break_off: true }
    }

    /// The device holds a layer that takes these times.
    pub(super) fn sent(&mut self, layer: u32, times: ScanTimes) {
        self.known.retain(|(known, _)| *known != layer);
        if self.known.len() == MAX_KNOWN {
            self.known.remove(0);
        }
        self.known.push((layer, times));
    }

    /// Whether the times of a layer that the device holds are known.
    pub(super) fn knows(&self, layer: u32) -> bool {
        self.times(layer).is_some()
    }

    fn times(&self, layer: u32) -> Option<ScanTimes> {
        self.known.iter().find(|(known, _)| *known == layer).map(|(_, times)| *times)
    }

    /// How long the laser is on for a whole layer, milliseconds; `None` if that is not known.
    pub(super) fn light_ms(&self, layer: u32) -> Option<u32> {
        self.times(layer).map(|times| times.laser_ms)
    }

    pub(super) fn exposure(&mut self, layer: u32) -> Exposure {
        self.stage = Stage::Still;
        let ScanTimes { laser_ms, mark_ms, .. } = self.times(layer).unwrap_or_default();
        let most_ms = mark_ms.saturating_add(mark_ms / 10 + MARK_MARGIN_MS).min(self.max_mark_ms);
        let from_vector = self.from_vector;
        // How long the rest of a layer takes was not computed.
        let least_us = if from_vector == 0 { least_exposure_us(laser_ms) } else { 0 };
        let act = Act::Powder(PowderAct::Mark { layer, from_vector, most_ms });
        // The vector that it is on then may end.
        Exposure { act, limit_ms: most_ms.saturating_add(LEFTOVER_MS), least_us }
    }

    /// Compares the whole layer's laser time. Of the rest of a layer only the most is known.
    pub(super) fn judge(&self, layer: u32, outcome: PowderOutcome) -> Option<Lit> {
        let PowderOutcome::Marked { layer: marked, vectors, laser_ms, starved_ms } = outcome else { return None };
        let times = self.times(layer)?;
        if marked != layer || vectors != times.vectors {
            return None;
        }
        let dose = match Dose::of(times.laser_ms, laser_ms) {
            Dose::TooLittle if self.from_vector > 0 => Dose::Right,
            dose => dose,
        };
        Some(Lit { light_ms: laser_ms, starved_ms, dose })
    }

    /// The device has marked the next layer up to this vector. Returns how many vectors that is more than before; `None` if it cannot be.
    pub(super) fn marked_to(&mut self, layer: u32, next_vector: u32) -> Option<u32> {
        let newly_marked = next_vector.checked_sub(self.from_vector)?;
        if self.times(layer).is_some_and(|times| next_vector >= times.vectors.max(1)) {
            return None;
        }
        self.from_vector = next_vector;
        Some(newly_marked)
    }

    pub(super) fn note_exposed(&mut self) {
        self.from_vector = 0;
    }

    /// The part waits in its powder.
    pub(super) fn park(&mut self) -> Step {
        self.stage = Stage::Parked;
        Step::Parked
    }

    /// Whether the act under way leaves the plate where it is.
    pub(super) fn plate_rests(&self) -> bool {
        self.stage == Stage::Recoating
    }

    pub(super) fn done(&mut self, outcome: PowderOutcome, too_soon: Option<&TooSoon>, goal: Goal) -> Option<Done> {
        let (done, problem) = match (self.stage, outcome) {
            (Stage::Homing, PowderOutcome::Arrived { position_um }) => {
                ("its plate arrived", self.arrived(position_um, 0))
            }
            (Stage::Lowering(to_um), PowderOutcome::Arrived { position_um }) => {
                ("its plate arrived", self.arrived(position_um, to_um))
            }
            (Stage::Recoating, PowderOutcome::Recoated) => {
                self.recoated = true;
                ("it has recoated", None)
            }
            _ => return None,
        };
        // A layer that is not to be marked any more is left as it is.
        let may_settle = self.stage == Stage::Recoating && goal == Goal::Print;
        self.stage = Stage::Still;
        let problem = problem.or_else(|| too_soon.map(|too_soon| too_soon_text(done, too_soon)));
        let step = if may_settle && problem.is_none() { self.settle() } else { Step::Free };
        Some(Done { problem, step })
    }

    /// A move has ended. Returns what is wrong with that.
    fn arrived(&mut self, position_um: i32, to_um: i32) -> Option<String> {
        self.position_um = Some(position_um);
        self.plan.positions().is_off(position_um, to_um).then(|| {
            let [position, target] = [position_um, to_um].map(mm_text);
            format!("the plate is {position} deep instead of {target}: check the axis, then resume")
        })
    }

    pub(super) fn waited(&mut self) -> Step {
        let stage = self.stage;
        self.break_off();
        match stage {
            Stage::Settling => Step::Ready,
            Stage::Busy if self.recoated => self.settle(),
            Stage::Busy if self.busy_waits > 0 => {
                self.busy_waits -= 1;
                self.stage = stage;
                Step::Wait { us: BUSY_WAIT_US, may_break_off: true }
            }
            _ => Step::Free,
        }
    }

    /// The step under way ends here, if there is one: the line was lost, the act was withdrawn, or the job ends.
    fn break_off(&mut self) {
        self.stage = Stage::Still;
    }

    pub(super) fn is_parked(&self) -> bool {
        self.stage == Stage::Parked
    }

    pub(super) fn may_be_left(&self) -> bool {
        self.stage == Stage::Homing
    }

    pub(super) fn overdue_text(&self, is_taken: bool) -> String {
        match self.stage {
            _ if !is_taken => "the order to the machine did not reach the device in time: check the line".into(),
            Stage::Recoating => {
                "the device did not say in time that it has recoated: look at the recoater and the device".into()
            }
            Stage::Lowering(to_um) => format!(
                "the device did not say in time that its plate is {} deep: check the axis and the device",
                mm_text(to_um)
            ),
            _ => "the device did not say in time that it has homed: check the axis and the device".into(),
        }
    }
}

/// The device says that an act ended sooner than it can by the host's clock.
fn too_soon_text(done: &str, TooSoon { took_us, hint }: &TooSoon) -> String {
    format!(
        "the device says that {done} {} ms after the order, which is too soon: check the machine{hint}",
        took_us / 1000
    )
}
