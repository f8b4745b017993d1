//! The cycle of a layer: lift, return, settle, command, expose, confirm.

use super::{Engine, Intent, LATE_LIMIT_US, Phase, SECOND_US};
use crate::deadline::Deadline;
use crate::device::{Act, Dose, Outcome, least_exposure_us};
use crate::job::{JobState, Record, Unconfirmed};
use crate::link::message::{DeviceState, ExposureId, Refusal};
use crate::text::mm_text;

/// Longest homing. From the largest build height (2 m) at 10 mm/s it takes 200 s.
const HOMING_US: u64 = 300 * SECOND_US;
/// How often one layer may be commanded. Every time but the first follows a lost line or a refusal.
const MAX_COMMANDS: u32 = 10;

impl Engine {
    /// Takes the next step. No act and no unconfirmed exposure may be under way.
    pub(super) fn advance(&mut self, now_us: u64) {
        if !self.line_up {
            return self.lose(now_us);
        }
        if self.light.must_wait() {
            return self.darken(now_us);
        }
        if self.intent == Intent::Print && self.next_layer == self.plan.layer_count {
            self.intent = Intent::End(JobState::Completed, String::new());
        }
        if self.intent != Intent::Print {
            return self.park(now_us);
        }
        match self.position_um {
            None if self.touched => self.end_unparked(POSITION_LOST.into()),
            None => {
                self.target_um = 0;
                self.start_act(Act::Home, Phase::Homing, now_us + HOMING_US, now_us);
            }
            Some(position_um) if self.stuck => self.lift(position_um, now_us),
            Some(_) if !self.warm && !self.uploads.holds(self.next_layer) => {
                self.wait_until(Phase::WarmingUp, now_us + LATE_LIMIT_US);
            }
            Some(position_um) => self.approach(position_um, now_us),
        }
    }

    pub(super) fn lift(&mut self, position_um: i32, now_us: u64) {
        let exposed = self.next_layer.saturating_sub(1);
        let target_um = self.plan.lifted_position_um(exposed).min(self.max_position_um);
        if position_um >= target_um {
            self.stuck = false;
            return self.advance(now_us);
        }
        self.start_move(target_um, self.plan.recipe.lift_speed_um_s, Phase::Lifting, now_us);
    }

    pub(super) fn approach(&mut self, position_um: i32, now_us: u64) {
        self.warm = true;
        let target_um = self.plan.layer_position_um(self.next_layer);
        if position_um == target_um {
            return self.settle(now_us);
        }
        self.start_move(target_um, self.plan.recipe.retract_speed_um_s, Phase::Approaching, now_us);
    }

    pub(super) fn settle(&mut self, now_us: u64) {
        let recipe = &self.plan.recipe;
        let wait_ms = u64::from(recipe.light_off_delay_ms) + u64::from(recipe.wait_before_exposure_ms);
        self.wait_until(Phase::Settling, now_us + wait_ms * 1000);
    }

    /// The machine is ready for the layer: commands it, or waits for it.
    pub(super) fn want_layer(&mut self, now_us: u64) {
        if self.uploads.holds(self.next_layer) {
            return self.command_exposure(now_us);
        }
        self.wait_until(Phase::Waiting { since_us: now_us }, now_us + LATE_LIMIT_US);
    }

    pub(super) fn command_exposure(&mut self, now_us: u64) {
        self.commands_of_layer += 1;
        if self.commands_of_layer > MAX_COMMANDS {
            let text = format!(
                "layer {} was commanded {MAX_COMMANDS} times without success; check the device",
                self.next_layer
            );
            return self.wind_down(JobState::Interrupted, text, now_us);
        }
        let boot_id = self.device.boot_id;
        (self.refused, self.ended_early) = (None, None);
        self.unconfirmed = Some(Unconfirmed { layer: self.next_layer, boot_id });
        self.out.journal(Record::Commanded { layer: self.next_layer, boot_id });
        self.phase = Phase::Commanding;
        self.deadline = None;
    }

    pub(super) fn expose(&mut self, now_us: u64) {
        let duration_ms = self.plan.recipe.layer_exposure_ms(self.next_layer);
        let act = Act::Expose { layer: self.next_layer, duration_ms, light_pwm: self.plan.recipe.light_pwm };
        self.touched = true;
        self.light.command(self.exposure_id(), duration_ms, now_us);
        let light_until_us = now_us + u64::from(duration_ms) * 1000;
        let limit_us = self.light.limit_us().unwrap_or(light_until_us);
        self.start_act(act, Phase::Exposing { light_until_us }, limit_us, now_us);
        self.act.least_us = self.plan.host_us(least_exposure_us(duration_ms));
    }

    /// Identifies the exposure of the next layer.
    pub(super) fn exposure_id(&self) -> ExposureId {
        ExposureId::first_pass(self.plan.key, self.next_layer)
    }

    /// The device has received the act under way. The machine stood still until then.
    pub(super) fn on_act_taken(&mut self, number: u64, now_us: u64) {
        if self.act.running != Some(number) {
            return;
        }
        if let Some(sent_us) = self.act.sent_us.take() {
            self.pace.waited(now_us.saturating_sub(sent_us));
        }
        if matches!(self.phase, Phase::Exposing { .. }) {
            self.light.taken(now_us);
            self.deadline = self.light.limit_us().map(Deadline::at);
        }
    }

    /// Compares the reported light time with the commanded one.
    fn on_exposed(&mut self, reported_ms: u32, now_us: u64) {
        let (layer, commanded_ms) = (self.next_layer, self.plan.recipe.layer_exposure_ms(self.next_layer));
        if let Some(text) = self.exposed_too_soon(now_us) {
            return self.doubt(&text, now_us);
        }
        let dose = Dose::of(commanded_ms, reported_ms);
        let text =
            format!("the device reports {reported_ms} ms of light for layer {layer} instead of {commanded_ms} ms");
        match dose {
            Dose::TooLittle => return self.doubt(&text, now_us),
            Dose::TooMuch => {
                self.intend_to_end(JobState::Interrupted, format!("{text}: check its firmware, then resume"));
            }
            Dose::Right => {}
        }
        self.confirm(Some(reported_ms), now_us);
    }

    /// Describes the error if the last exposure is reported to have ended sooner than it can by the host's clock.
    pub(super) fn exposed_too_soon(&self, now_us: u64) -> Option<String> {
        let (layer, commanded_ms) = (self.next_layer, self.plan.recipe.layer_exposure_ms(self.next_layer));
        let took_us = self.too_soon_us(now_us)?;
        Some(format!(
            "the device says that layer {layer} had its {commanded_ms} ms of light, but only {} ms have passed since the order{}",
            took_us / 1000,
            self.time_scale_hint()
        ))
    }

    /// A state names the layer under way as exposed sooner than it can be: the light goes off, and the layer is in doubt.
    pub(super) fn look_for_early_end(&mut self, state: &DeviceState, now_us: u64) {
        let under_way = self.out.act.is_none() && matches!(self.phase, Phase::Exposing { .. } | Phase::CuttingShort);
        if under_way
            && self.ended_early.is_none()
            && state.last_exposed == Some(self.exposure_id())
            && let Some(text) = self.exposed_too_soon(now_us)
        {
            self.ended_early = Some(text);
            self.cut_short(now_us);
        }
    }

    /// Time since the last act was handed out, microseconds, if that act cannot have ended yet; else `None`.
    fn too_soon_us(&self, now_us: u64) -> Option<u64> {
        let took_us = now_us.saturating_sub(self.act.began_us);
        (took_us < self.act.least_us).then_some(took_us)
    }

    fn time_scale_hint(&self) -> String {
        let hint = format!(
            " (is the device simulated? Set `time_scale` in the machine file, now {}, to its `--time-scale`, and restart layerd)",
            self.plan.time_scale
        );
        // One cause leads to several reports.
        if self.end_reason().contains(&hint) { String::new() } else { hint }
    }

    /// The device says that it exposed the commanded layer. `light_ms` is the reported light time, if it names one.
    pub(super) fn confirm(&mut self, light_ms: Option<u32>, now_us: u64) {
        self.confirmed = true;
        self.light_ms = light_ms;
        self.pace.confirmed(self.plan.layer_ms(self.next_layer), now_us);
        self.out.journal(Record::Confirmed { layer: self.next_layer });
        self.count_as_exposed();
        self.phase = Phase::Confirming;
        self.deadline = None;
        if self.out.journal_broken {
            self.advance(now_us);
        }
    }

    pub(super) fn count_as_exposed(&mut self) {
        self.uploads.release(self.next_layer);
        self.unconfirmed = None;
        self.in_doubt = None;
        self.next_layer += 1;
        self.stuck = true;
        self.touched = true;
        self.commands_of_layer = 0;
        self.failures.losses_in_a_row = 0;
        self.failures.misbehaviours_in_a_row = 0;
        self.failures.layers_of_misbehaviour = self.failures.layers_of_misbehaviour.saturating_sub(1);
    }

    /// The commanded layer had no light, by the device's word.
    pub(super) fn deny(&mut self) {
        if self.unconfirmed.take().is_some() {
            self.out.journal(Record::NotExposed { layer: self.next_layer });
        }
    }

    pub(super) fn on_journal_idle(&mut self, now_us: u64) {
        match self.phase {
            Phase::Commanding => self.expose(now_us),
            Phase::Confirming => {
                let wait_us = u64::from(self.plan.recipe.wait_after_exposure_ms) * 1000;
                self.wait_until(Phase::Curing, now_us + wait_us);
            }
            Phase::Ending => self.finish(),
            _ => {}
        }
    }

    pub(super) fn on_uploaded(&mut self, layer: u32, now_us: u64) {
        if !self.uploads.uploaded(layer) || layer != self.next_layer {
            return;
        }
        match self.phase {
            Phase::WarmingUp => self.advance(now_us),
            Phase::Waiting { since_us } => {
                self.pace.waited(now_us.saturating_sub(since_us));
                self.command_exposure(now_us);
            }
            _ => {}
        }
    }

    pub(super) fn on_act_done(&mut self, outcome: Outcome, now_us: u64) {
        if matches!(self.phase, Phase::Exposing { .. } | Phase::CuttingShort) {
            if !matches!(outcome, Outcome::Refused(refusal) if refusal != Refusal::CutShort) {
                self.light.ended();
            }
            if let Some(text) = self.ended_early.take() {
                return self.doubt(&text, now_us);
            }
        }
        match (self.phase, outcome) {
            (Phase::Exposing { .. } | Phase::CuttingShort, Outcome::Exposed { layer, duration_ms })
                if layer == self.next_layer =>
            {
                self.on_exposed(duration_ms, now_us);
            }
            (
                Phase::Homing | Phase::Lifting | Phase::Approaching | Phase::Parking,
                Outcome::Arrived { position_um },
            ) => {
                self.position_um = Some(position_um);
                self.deadline = None;
                self.on_arrived(position_um, now_us);
            }
            (_, Outcome::TakenBack) => self.withdraw(now_us),
            (_, Outcome::Refused(refusal)) => self.on_refused(refusal, now_us),
            (_, outcome) => {
                let text = format!("the device answered {outcome:?}, which does not fit the act; check its firmware");
                if self.unconfirmed.is_some() {
                    self.doubt(&text, now_us);
                } else {
                    self.end_unparked(text);
                }
            }
        }
    }

    fn on_arrived(&mut self, position_um: i32, now_us: u64) {
        if self.is_off(position_um, self.target_um) {
            return self.on_misplaced(position_um, now_us);
        }
        if let Some(took_us) = self.too_soon_us(now_us) {
            return self.on_moved_too_soon(took_us, now_us);
        }
        match self.phase {
            Phase::Lifting => {
                self.stuck = false;
                let wait_us = u64::from(self.plan.recipe.wait_after_lift_ms) * 1000;
                self.wait_until(Phase::Dripping, now_us + wait_us);
            }
            Phase::Approaching if self.intent == Intent::Print => self.settle(now_us),
            Phase::Parking if self.intent != Intent::Print => self.parked(now_us),
            _ => self.advance(now_us),
        }
    }

    /// The device says that its plate arrived sooner than it can by the host's clock. The plate is lifted clear once. If this was
    /// that lift, or the plate is already up, the job ends with the plate where it is.
    fn on_moved_too_soon(&mut self, took_us: u64, now_us: u64) {
        let text = format!(
            "the device says that its plate arrived at {} {} ms after the order, which is too soon: check the axis and the device{}",
            mm_text(self.target_um),
            took_us / 1000,
            self.time_scale_hint()
        );
        self.intend_to_end(self.failed_or_interrupted(), text);
        let may_lift = self.phase != Phase::Parking && self.position_um < Some(self.parking_um());
        if may_lift { self.advance(now_us) } else { self.unparked("the device says so too soon", now_us) }
    }

    /// A move has not ended in time.
    pub(super) fn on_overdue_move(&mut self, now_us: u64) {
        let text = if self.act.sent_us.is_some() {
            "the order to move the plate did not reach the device in time: check the line"
        } else {
            &format!(
                "the device did not say in time that its plate arrived at {}: check the axis and the device",
                mm_text(self.target_um)
            )
        };
        self.on_misbehaved(&self.with_cause(text), now_us);
    }

    /// Adds to `text` what keeps data from getting through: a device that does not answer may not have been reached.
    pub(super) fn with_cause(&self, text: &str) -> String {
        self.hindrance.as_ref().map_or(text.to_owned(), |hindrance| format!("{text}; {hindrance}"))
    }

    fn is_off(&self, position_um: i32, target_um: i32) -> bool {
        position_um.abs_diff(target_um) > self.plan.position_tolerance_um()
    }

    /// A move ended at the wrong position. The plate is lifted clear once. If this was that lift, the job ends with the plate
    /// where it is.
    fn on_misplaced(&mut self, position_um: i32, now_us: u64) {
        let target_um = self.target_um;
        let [position, target] = [position_um, target_um].map(mm_text);
        let text = format!("the plate is at {position} instead of {target}: check the axis, then resume");
        self.intend_to_end(self.failed_or_interrupted(), text);
        if self.phase != Phase::Parking {
            return self.advance(now_us);
        }
        if position_um > target_um { self.parked(now_us) } else { self.unparked("the move ended too low", now_us) }
    }

    /// Compares the reported plate position with the one where the plate was left. Nothing moves the plate in these phases.
    pub(super) fn watch_plate(&mut self, found_um: Option<i32>, now_us: u64) {
        use Phase::{Commanding, Confirming, Curing, Dripping, Exposing, Resting, Settling, Waiting, WarmingUp};
        match self.phase {
            // During a pause the operator may move the plate.
            Resting => {
                let left_um = self.position_um.replace(found_um.unwrap_or(i32::MIN));
                self.lifted &= self.position_um >= left_um;
                self.position_um = found_um;
                return;
            }
            Settling | WarmingUp | Waiting { .. } | Commanding | Exposing { .. } | Confirming | Curing | Dripping => {}
            _ => return,
        }
        let Some(left_um) = self.position_um else { return };
        if found_um.is_some_and(|found_um| !self.is_off(found_um, left_um)) {
            return;
        }
        self.position_um = found_um;
        let found = found_um
            .map_or("at a position that it no longer knows".into(), |found_um| format!("at {}", mm_text(found_um)));
        let text = format!(
            "the device says its plate is {found}; it was left at {}. Look at the machine, then resume",
            mm_text(left_um)
        );
        self.wind_down(self.failed_or_interrupted(), text, now_us);
    }
}

/// A device that lost its position must not be homed with a part on the plate.
const POSITION_LOST: &str = "the device no longer knows where its plate is, and homing would drive the part into the vat's \
     bottom. Nothing was moved. If the machine can restore its position without going down, do so and resume; otherwise \
     take the part off and start it anew";
