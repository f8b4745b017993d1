//! Resets of the controller, and what is known afterwards: where the axes are, and how far a layer is marked. Part of
//! [`Firmware`](super::Firmware).

use super::acts::{Act, Running};
use super::{Firmware, Readiness};
use crate::link::grbl::answer::{State, Status};
use crate::link::grbl::marking::{Cut, Marking};
use crate::link::grbl::path::length_um;
use crate::link::grbl::sender::PRESS_AGAIN_US;
use crate::link::grbl::settings::{Controller, GrblMisfit};
use crate::link::message::ExposureId;
use layerd_wire::session::MAX_URGENTS;

/// A controller that does not answer a reset within this time is lost, microseconds.
const RESET_US: u64 = 3_500_000;
/// The status after a reset is asked for this often, microseconds.
const ASK_US: u64 = 100_000;
/// Most that a plate may have moved without its position being lost, micrometres: a reported position is rounded.
const PLATE_SHIFT_UM: i32 = 10;

/// A reset under way. Nothing that the controller says counts before its banner.
#[derive(Debug)]
pub(super) struct Reset {
    why: &'static str,
    /// What the operator is told.
    fault: Option<String>,
    /// Urgent orders that are carried out with it.
    urgents: Vec<u32>,
    began_us: u64,
    press_us: u64,
    /// The banner has come: the position is asked for.
    is_answered: bool,
}

impl Reset {
    pub(super) fn due_us(&self) -> u64 {
        self.press_us
    }
}

/// A marking that ended with its session, until the position tells how far it came.
#[derive(Debug)]
pub(super) struct Interrupted {
    marking: Box<Marking>,
    /// The controller was reset, so that the beam may have stopped anywhere.
    is_cut: bool,
    /// The controller has done all that reached it. A reset changes nothing then.
    is_dry: bool,
}

impl Firmware {
    /// Resets the controller: the laser is dark within milliseconds, and all that it was sent is void.
    pub(super) fn reset(&mut self, why: &'static str, fault: Option<String>, urgent: Option<u32>) {
        let now_us = self.now_us;
        let withdrawn = self.sender.drop_waiting();
        if let Some(marking) = self.running.as_mut().and_then(Running::marking_mut) {
            marking.withdraw(withdrawn);
        }
        let reset = self.reset.get_or_insert_with(|| Reset {
            why,
            fault: None,
            urgents: Vec::new(),
            began_us: now_us,
            press_us: now_us,
            is_answered: false,
        });
        reset.fault = reset.fault.take().or(fault);
        // Those beyond are carried out in the next session.
        if reset.urgents.len() < MAX_URGENTS {
            reset.urgents.extend(urgent);
        }
        self.press_reset();
    }

    /// Sends the reset if that is due. Returns `false` if the controller does not answer it.
    pub(super) fn press_reset(&mut self) -> bool {
        let now_us = self.now_us;
        let Some(reset) = &mut self.reset else { return true };
        if now_us >= reset.press_us {
            if reset.is_answered {
                reset.press_us = now_us + ASK_US;
                self.sender.ask(now_us);
            } else {
                reset.press_us = now_us + PRESS_AGAIN_US;
                self.sender.reset();
            }
        }
        now_us < reset.began_us + RESET_US
    }

    /// The controller has started. Returns whether that was asked for.
    pub(in crate::link::grbl) fn started(&mut self, now_us: u64) -> bool {
        self.now_us = now_us;
        self.sender.forget();
        (self.is_prepared, self.offset_um) = (false, None);
        if let Some(interrupted) = &mut self.interrupted {
            interrupted.is_cut |= !interrupted.is_dry;
        }
        match &mut self.reset {
            Some(reset) => {
                reset.is_answered = true;
                reset.press_us = now_us + ASK_US;
                self.sender.ask(now_us);
                true
            }
            None => {
                self.act_broken();
                // No alarm came first, so it stood. It may have carried out the lines behind the reset with the laser off: the position
                // tells nothing.
                if let Some(running) = self.running.take() {
                    self.beam_unseen = true;
                    running.marking().into_iter().for_each(|marking| self.note_cut(marking.cut_somewhere()));
                }
                false
            }
        }
    }

    /// The controller was reset, perhaps during an act.
    fn act_broken(&mut self) {
        match self.running.as_ref().map(|running| &running.act) {
            // The plate was moving.
            Some(Act::Home | Act::Move(_)) => self.knows_position = false,
            Some(Act::Recoat) => self.recoated = false,
            Some(Act::Mark(_)) | None => {}
        }
    }

    /// The controller was reset, and has told its position.
    pub(super) fn at_rest_after_reset(&mut self, state: State, at_um: [i32; 3]) {
        if state == State::Moving || !self.reset.as_ref().is_some_and(|reset| reset.is_answered) {
            return;
        }
        let Some(reset) = self.reset.take() else { return };
        tracing::info!(why = reset.why, ?at_um, "the controller was reset");
        self.act_broken();
        self.done.extend(reset.urgents);
        match self.running.is_some() {
            true => self.end_early([at_um[0], at_um[1]], true, reset.fault),
            false => reset.fault.into_iter().for_each(|text| self.report_fault(text)),
        }
    }

    /// The session has ended: what is under way is not answered any more, and no further line is sent.
    pub(in crate::link::grbl) fn end_session(&mut self) {
        self.messages.clear();
        self.done.clear();
        self.questions.clear();
        self.waiting = None;
        let withdrawn = self.sender.drop_waiting();
        if let Some(mut running) = self.running.take() {
            if let Some(marking) = running.marking_mut() {
                marking.withdraw(withdrawn);
            }
            match running.act {
                Act::Move(travel) => self.unseen_to_um = Some(travel.position_um),
                Act::Home => self.knows_position = false,
                Act::Recoat => self.beam_unseen = true,
                Act::Mark(_) => self.interrupt(running),
            }
        }
        self.buffer.restart();
        self.readiness = Readiness::Ready;
    }

    /// Keeps a marking whose end is not known.
    fn interrupt(&mut self, running: Running) {
        if let Act::Mark(marking) = running.act {
            self.interrupted = Some(Interrupted { marking, is_cut: self.reset.is_some(), is_dry: false });
        }
    }

    /// The controller is at rest, and has reported no reset since the session ended. A hold and a reset at the machine in that time go
    /// unnoticed, but leave the beam at the end of a move only by chance.
    pub(in crate::link::grbl) fn ran_dry(&mut self) {
        self.interrupted.iter_mut().for_each(|interrupted| interrupted.is_dry = true);
    }

    /// A session begins with this controller, and this is its status. What is known from before is compared with that.
    ///
    /// # Errors
    /// [`GrblMisfit::NoPosition`] if the status does not tell where the axes are.
    pub(in crate::link::grbl) fn greet(
        &mut self,
        controller: Controller,
        status: &Status,
        now_us: u64,
    ) -> Result<(), GrblMisfit> {
        self.now_us = now_us;
        let (name, usable_bytes) = (controller.name.clone(), controller.usable_bytes);
        let before = self.controller.replace(controller);
        let is_first = before.is_none();
        let Some(at_um) = self.locate(status) else {
            self.controller = before;
            return Err(GrblMisfit::NoPosition);
        };
        self.capabilities.name = name;
        self.sender.set_room(usable_bytes);
        let fault = self.reset.take().and_then(|reset| reset.fault);
        let was_known = self.position_um.filter(|_| self.knows_position);
        self.is_locked = status.state == State::Alarm;
        self.knows_position = match was_known {
            // While it stood still or marked, the plate did not move. If it is elsewhere, the controller had no power.
            Some(before_um) => {
                let to_um = self.unseen_to_um.map_or(before_um[2], |position_um| -position_um);
                let (low_um, high_um) = (before_um[2].min(to_um), before_um[2].max(to_um));
                let is_there = (low_um - PLATE_SHIFT_UM..=high_um + PLATE_SHIFT_UM).contains(&at_um[2]);
                // A move that a reset has broken off may have lost steps.
                let was_broken = self.unseen_to_um.is_some() && self.is_locked;
                is_there && !was_broken && !self.is_beam_elsewhere(before_um, at_um)
            }
            // Later, only homing tells. A controller that is locked may have lost its position.
            None => is_first && !self.is_locked,
        };
        (self.unseen_to_um, self.beam_unseen) = (None, false);
        if was_known.is_some() && !self.knows_position {
            self.recoated = false;
        }
        self.position_um = Some(at_um);
        if let Some(Interrupted { marking, is_cut, .. }) = self.interrupted.take() {
            self.note_cut(match self.knows_position {
                true => marking.cut([at_um[0], at_um[1]], is_cut),
                false => marking.cut_somewhere(),
            });
        }
        (self.fault, self.fault_ends_us) = (None, None);
        // A fault that ended the session before. The welcome carries it, so it is not reported as well.
        if let Some(text) = fault {
            self.report_fault(text);
            self.messages.clear();
        }
        self.readiness = Readiness::Ready;
        Ok(())
    }

    /// Whether the beam is not where it stood, although nothing was to move it.
    fn is_beam_elsewhere(&self, before_um: [i32; 3], at_um: [i32; 3]) -> bool {
        let tolerance_um = self.controller.as_ref().map_or(0.0, |controller| controller.tolerance_um);
        let stands = self.interrupted.is_none() && !self.beam_unseen;
        stands && length_um([before_um[0], before_um[1]], [at_um[0], at_um[1]]) > tolerance_um
    }

    /// A layer is marked to its end.
    pub(super) fn note_whole(&mut self, id: ExposureId) {
        self.last_exposed = Some(id);
        if self.cut_short.take_if(|(cut, _)| *cut == id).is_some() {
            (self.next_vector, self.broken) = (0, None);
        }
    }

    /// The marking of a layer ended early.
    pub(super) fn note_cut(&mut self, cut: Cut) {
        let Cut { id, is_whole, next_vector, broken, laser_ms } = cut;
        if is_whole {
            return self.note_whole(id);
        }
        tracing::info!(layer = id.layer, next_vector, ?broken, "marking ended early");
        self.cut_short = Some((id, laser_ms));
        (self.next_vector, self.broken) = (next_vector, broken);
    }
}
