//! What acts show while they run, and at their end. Part of [`Firmware`](super::Firmware).

use super::Firmware;
use super::acts::{Act, Stage};
use crate::link::grbl::answer::State;
use crate::link::grbl::gcode;
use crate::link::grbl::marking::Marking;
use crate::link::grbl::path::length_um;
use crate::link::message::{PowderReply, Refusal, Reply};
use crate::text::plain_line;

/// The status is asked for this often during an act, microseconds. An axis that moves by a changed byte is stopped after that.
const WATCH_US: u64 = 50_000;
/// A beam or plate that does not move for this long, with lines before it, is stuck, microseconds.
const STALL_US: u64 = 5_000_000;
/// After its last line is done, a controller is at rest within this time, microseconds.
const REST_US: u64 = 2_000_000;

impl Firmware {
    /// The controller has told where it is during an act.
    pub(super) fn act_status(&mut self, state: State, at_um: [i32; 3], before_um: Option<[i32; 3]>) {
        let Some(running) = &mut self.running else { return };
        if before_um != Some(at_um) {
            running.moved_us = self.now_us;
        }
        match state {
            State::Held => {
                return self.fail("the controller was held at the machine, by a door or a button: look at it".into());
            }
            State::Off => return self.fail("the controller sleeps, or only checks lines: reset it".into()),
            State::Idle | State::Moving | State::Alarm => {}
        }
        if let Some(text) = self.plate_astray(at_um[2]) {
            return self.fail(text);
        }
        let Some(running) = &self.running else { return };
        let is_idle = state == State::Idle;
        match running.stage {
            Stage::Preparing if is_idle && self.sender.is_empty() => self.begin_path(at_um),
            Stage::Preparing | Stage::Naming => {}
            Stage::Lines | Stage::Resting(None) => self.watch_beam(is_idle, at_um),
            Stage::Resting(Some(since_us)) => self.compare_end(is_idle, at_um, since_us),
        }
    }

    /// What is wrong with the plate's height: an act of the beam must not move it, and a move must not lead beyond its target.
    fn plate_astray(&self, z_um: i32) -> Option<String> {
        let running = self.running.as_ref()?;
        let from_um = running.z_um?;
        let to_um = match &running.act {
            Act::Home => return None,
            Act::Move(travel) => -travel.position_um,
            Act::Recoat | Act::Mark(_) => from_um,
        };
        let tolerance_um = i32::try_from(self.plate_tolerance_um()).unwrap_or(i32::MAX);
        let (low_um, high_um) = (from_um.min(to_um) - tolerance_um, from_um.max(to_um) + tolerance_um);
        (!(low_um..=high_um).contains(&z_um)).then(|| {
            format!(
                "the plate is at Z{} and should be between Z{} and Z{}: bytes were lost or changed on the line. Check the cable and look \
                 at the part",
                gcode::mm(z_um),
                gcode::mm(from_um),
                gcode::mm(to_um)
            )
        })
    }

    pub(super) fn plate_tolerance_um(&self) -> u32 {
        self.controller.as_ref().map_or(0, |controller| controller.plate_tolerance_um)
    }

    /// The controller must have understood the modes, which no answer to a line shows.
    fn has_modes(&self) -> bool {
        let words: Vec<&str> = self.modes.split(' ').collect();
        gcode::MARKING_MODES.iter().all(|mode| words.contains(mode))
    }

    fn begin_path(&mut self, at_um: [i32; 3]) {
        if !self.has_modes() {
            return self.fail(format!(
                "the controller has understood other modes than it was sent (`{}`): bytes were lost or changed on the line. Nothing was \
                 marked. Check the cable",
                plain_line(&self.modes)
            ));
        }
        let (Some(running), Some(controller)) = (&mut self.running, &self.controller) else { return };
        if let Some(marking) = running.marking_mut() {
            marking.begin([at_um[0], at_um[1]], controller);
            running.stage = Stage::Lines;
        }
    }

    /// The beam must be on its path. Two reports in a row beside it are not a coincidence.
    fn watch_beam(&mut self, is_idle: bool, at_um: [i32; 3]) {
        let Some(running) = &mut self.running else { return };
        let Some(marking) = running.marking_mut() else { return };
        marking.rests(is_idle, [at_um[0], at_um[1]]);
        running.astray = if marking.seen([at_um[0], at_um[1]]) { 0 } else { running.astray + 1 };
        if running.astray > 1 {
            let [x, y] = [at_um[0], at_um[1]].map(gcode::mm);
            self.fail(format!(
                "the beam is at X{x} Y{y}, which is not on its path: bytes were lost or changed on the line, or the axes lost steps. \
                 Part of a vector may be marked in the wrong place. Check the cable and look at the part"
            ));
        }
    }

    /// Everything is done: compares where the axes are with where they were sent.
    fn compare_end(&mut self, is_idle: bool, at_um: [i32; 3], since_us: u64) {
        let Some(running) = &self.running else { return };
        let steps_um = self.controller.as_ref().map_or(0.0, |controller| controller.tolerance_um);
        let plate_um = match &running.act {
            Act::Home => Some(0),
            Act::Move(travel) => Some(travel.position_um),
            Act::Recoat | Act::Mark(_) => None,
        };
        let plate_tolerance_um = self.plate_tolerance_um();
        let is_plate_right = plate_um.is_none_or(|to_um: i32| at_um[2].abs_diff(-to_um) <= plate_tolerance_um);
        let end_um = running.marking().filter(|marking| marking.stopping.is_none()).and_then(Marking::end_um);
        let is_beam_right = end_um.is_none_or(|end_um| length_um(end_um, [at_um[0], at_um[1]]) <= steps_um);
        if is_idle && is_plate_right && is_beam_right {
            return self.end_whole(at_um);
        }
        if self.now_us >= since_us + REST_US {
            let [x, y, z] = at_um.map(gcode::mm);
            self.fail(format!(
                "the controller has done all lines, but its axes are at X{x} Y{y} Z{z}, not where they were sent, or do not come to rest: \
                 bytes were lost or changed on the line, or a line was not carried out. Check the cable and look at the machine"
            ));
        }
    }

    /// An act has run to its end.
    fn end_whole(&mut self, at_um: [i32; 3]) {
        let Some(running) = &mut self.running else { return };
        let reply = match &mut running.act {
            Act::Home | Act::Move(_) => {
                self.knows_position = true;
                PowderReply::Moved { position_um: -at_um[2] }
            }
            Act::Recoat => {
                self.recoated = true;
                PowderReply::Recoated
            }
            Act::Mark(marking) if marking.stopping.is_some() => {
                return self.end_early([at_um[0], at_um[1]], false, None);
            }
            Act::Mark(marking) => {
                marking.complete();
                let (id, vectors) = (marking.id, marking.vectors().unwrap_or_default());
                let (laser_ms, starved_ms) = (marking.laser_ms(), marking.starved_ms());
                self.note_whole(id);
                PowderReply::Marked { id, vectors, laser_ms, starved_ms }
            }
        };
        self.end_act(Reply::Powder(reply));
    }

    /// Ends the act under way with this reply. A layer that was marked leaves its slot.
    pub(super) fn end_act(&mut self, reply: Reply) {
        let Some(running) = self.running.take() else { return };
        self.sender.drop_waiting();
        if let Some(marking) = running.marking() {
            self.buffer.drop_layer(marking.slot);
        }
        self.reply(running.number, reply);
    }

    /// Asks for the status, and ends an act that is stuck or takes too long.
    pub(super) fn act_due(&mut self) {
        let (now_us, is_deaf) = (self.now_us, self.is_deaf());
        if self.reset.is_some() {
            return;
        }
        let Some(running) = &mut self.running else { return };
        if now_us >= running.watch_us {
            running.watch_us = now_us + WATCH_US;
            if !is_deaf {
                self.sender.ask(now_us);
            }
        }
        if let Some(marking) = running.marking_mut()
            && now_us >= marking.deadline_us
        {
            marking.stopping = marking.stopping.or(Some("its longest time is over"));
            marking.deadline_us = u64::MAX;
        }
        // How long a recoater and a homing may take is the host's matter.
        let may_stall =
            matches!(running.act, Act::Recoat | Act::Home) || running.marking().is_some_and(Marking::is_starved);
        if !may_stall && now_us >= running.moved_us + STALL_US {
            self.fail(
                "the controller has taken no line and has not moved for 5 s: an `ok` may have been lost. Check the cable, and look at the \
                 machine"
                    .into(),
            );
        }
    }

    /// A marking ended early, with the beam at rest here.
    pub(super) fn end_early(&mut self, at_um: [i32; 2], is_cut: bool, fault: Option<String>) {
        if let Some(cut) = self.marking().map(|marking| marking.cut(at_um, is_cut)) {
            self.note_cut(cut);
        }
        // First the reason, then what it led to.
        if let Some(text) = fault {
            self.report_fault(text);
        }
        self.end_act(Reply::Refused(Refusal::CutShort));
    }
}
