//! Acts: what begins them, and their lines for the controller. Part of [`Firmware`](super::Firmware).

use super::Firmware;
use crate::link::grbl::gcode;
use crate::link::grbl::marking::{Made, Marking};
use crate::link::grbl::sender::Kind;
use crate::link::message::{ExposureId, PowderRequest, Refusal, Reply};

/// An act under way.
#[derive(Debug)]
pub(super) struct Running {
    /// Number of its request.
    pub(super) number: u32,
    pub(super) act: Act,
    pub(super) stage: Stage,
    /// When the status is asked for next, and when anything went on last, microseconds.
    pub(super) watch_us: u64,
    pub(super) moved_us: u64,
    /// Reports in a row of a beam that is beside its path.
    pub(super) astray: u32,
    /// Whether the controller homes, and may answer nothing for minutes.
    pub(super) is_homing: bool,
    /// Where the plate was at the start, micrometres in G54.
    pub(super) z_um: Option<i32>,
}

/// What is done.
#[derive(Debug)]
pub(super) enum Act {
    Home,
    Move(Travel),
    Recoat,
    Mark(Box<Marking>),
}

/// A move of the plate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Travel {
    /// To this depth, micrometres.
    pub(super) position_um: i32,
    speed_um_s: u32,
}

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    /// The controller is prepared; then its position is asked for, where the path of the beam starts.
    Preparing,
    /// The plate's place is named; then it is read back.
    Naming,
    /// Lines are sent.
    Lines,
    /// All lines are sent. When they are answered, the position is compared. Since when they are, microseconds.
    Resting(Option<u64>),
}

impl Running {
    pub(super) fn marking(&self) -> Option<&Marking> {
        match &self.act {
            Act::Mark(marking) => Some(marking),
            Act::Home | Act::Move(_) | Act::Recoat => None,
        }
    }

    pub(super) fn marking_mut(&mut self) -> Option<&mut Marking> {
        match &mut self.act {
            Act::Mark(marking) => Some(marking),
            Act::Home | Act::Move(_) | Act::Recoat => None,
        }
    }

    pub(super) fn moves_plate(&self) -> bool {
        matches!(self.act, Act::Home | Act::Move(_))
    }

    pub(super) fn due_us(&self) -> u64 {
        let deadline_us = self.marking().map_or(u64::MAX, |marking| marking.deadline_us);
        self.watch_us.min(deadline_us)
    }
}

impl Firmware {
    /// Whether the controller may answer nothing for minutes: grbl 1.1 is deaf while it homes.
    pub(in crate::link::grbl) fn is_deaf(&self) -> bool {
        self.running.as_ref().is_some_and(|running| running.is_homing)
    }

    /// Begins an act. None is under way.
    pub(super) fn begin_act(&mut self, number: u32, request: PowderRequest) -> Result<(), Refusal> {
        let act = match request {
            PowderRequest::Home => Act::Home,
            PowderRequest::Move { position_um, speed_um_s } => {
                self.check_move(position_um, speed_um_s)?;
                Act::Move(Travel { position_um, speed_um_s })
            }
            PowderRequest::Recoat if !self.knows_position => return Err(Refusal::NotHomed),
            PowderRequest::Recoat => Act::Recoat,
            PowderRequest::Mark { id, from_vector, most_ms } => {
                Act::Mark(Box::new(self.new_marking(id, from_vector, most_ms)?))
            }
        };
        let stage = match &act {
            Act::Mark(_) => Stage::Preparing,
            Act::Move(_) => Stage::Naming,
            Act::Home | Act::Recoat => Stage::Resting(None),
        };
        let z_um = self.position_um.filter(|_| self.knows_position).map(|at_um| at_um[2]);
        let is_homing = self.push_lines(&act);
        if !matches!(act, Act::Mark(_)) {
            self.recoated = false;
        }
        let now_us = self.now_us;
        self.running =
            Some(Running { number, act, stage, watch_us: now_us, moved_us: now_us, astray: 0, is_homing, z_um });
        Ok(())
    }

    fn check_move(&self, position_um: i32, speed_um_s: u32) -> Result<(), Refusal> {
        let fastest_um_s = self.controller.as_ref().map_or(0.0, |controller| controller.max_plate_speed_um_s);
        if !self.knows_position {
            return Err(Refusal::NotHomed);
        }
        let is_possible = (0..=self.machine.max_position_um).contains(&position_um);
        let is_right_speed = speed_um_s > 0 && f64::from(speed_um_s) <= fastest_um_s * 1.01;
        if is_possible && is_right_speed { Ok(()) } else { Err(Refusal::BadMove) }
    }

    fn new_marking(&self, id: ExposureId, from_vector: u32, most_ms: u32) -> Result<Marking, Refusal> {
        if !self.knows_position {
            return Err(Refusal::NotHomed);
        }
        if !self.recoated {
            return Err(Refusal::NotRecoated);
        }
        if most_ms == 0 || most_ms > self.capabilities.max_exposure_ms {
            return Err(Refusal::BadDuration);
        }
        if self.last_exposed.is_some_and(|last| last.job == id.job && id <= last) {
            return Err(Refusal::AlreadyExposed);
        }
        let layer = self.buffer.ready_layer(id).ok_or(Refusal::NoSuchLayer)?;
        let is_continued = self.cut_short.is_some_and(|(cut, _)| cut == id);
        let first = if is_continued { self.next_vector } else { 0 };
        if from_vector != first || layer.1.vectors.is_some_and(|vectors| from_vector > vectors) {
            return Err(Refusal::WrongVector);
        }
        let broken = self.broken.filter(|_| is_continued);
        let deadline_us = self.now_us + u64::from(most_ms) * 1000;
        let field_um = self.machine.field_um;
        Ok(Marking::new(layer, (from_vector, broken), deadline_us, field_um, self.power()))
    }

    /// The lines of an act; of a marking, those before its path starts. Returns whether the first one homes.
    fn push_lines(&mut self, act: &Act) -> bool {
        let homes = self.controller.as_ref().is_some_and(|controller| controller.homes);
        let is_homing = homes && matches!(act, Act::Home);
        if is_homing {
            self.push("$H");
        } else if self.is_locked {
            self.push("$X");
        }
        if is_homing || !self.is_prepared {
            gcode::PREAMBLE.into_iter().for_each(|line| self.push(line));
            self.is_prepared = true;
        }
        match act {
            Act::Home => {
                self.knows_position = false;
                self.push(gcode::PLATE_HOME);
            }
            Act::Move(travel) => {
                let z_um = self.position_um.map_or(0, |at_um| at_um[2]);
                self.shift_um = None;
                self.push(gcode::name_plate(-travel.position_um - z_um));
                // The name must not outlast the move.
                self.is_prepared = false;
                self.push(gcode::OFFSETS);
                return false;
            }
            Act::Recoat => {
                for line in self.machine.recoat_gcode.clone() {
                    self.push(line);
                }
                // They are the operator's own.
                self.is_prepared = false;
            }
            Act::Mark(_) => {
                self.push(gcode::LASER);
                self.modes.clear();
                self.push(gcode::MODES);
            }
        }
        self.push(gcode::SYNC);
        is_homing
    }

    fn push(&mut self, line: impl Into<String>) {
        self.sender.push(line, Kind::Other);
    }

    /// The controller has taken a line.
    pub(super) fn act_answered(&mut self, kind: Kind) {
        let Some(running) = &mut self.running else { return };
        running.moved_us = self.now_us;
        running.is_homing = false;
        if let (Kind::Beam, Act::Mark(marking)) = (kind, &mut running.act) {
            marking.answered();
        }
        if !self.sender.is_empty() {
            return;
        }
        // The next position is asked for at once: it shows what all these lines did.
        running.watch_us = self.now_us;
        match &mut running.stage {
            Stage::Resting(since_us) => *since_us = Some(self.now_us),
            Stage::Naming => self.move_named(),
            _ => {}
        }
    }

    /// The plate's place is named: its offset is now the place where the plate will go. If that is right, it goes there.
    fn move_named(&mut self) {
        let tolerance_um = self.plate_tolerance_um();
        let Some(running) = &mut self.running else { return };
        let Act::Move(Travel { position_um, speed_um_s }) = running.act else { return };
        let is_right = self.shift_um.is_some_and(|[_, _, z_um]| z_um.abs_diff(-position_um) <= tolerance_um);
        if !is_right {
            let found = self.shift_um.map_or_else(
                || "did not tell the offset of G92".into(),
                |[_, _, z_um]| format!("has understood that the plate is to go to Z{}", gcode::mm(z_um)),
            );
            return self.fail(format!(
                "the controller {found}; it is to go to Z{}. Bytes were lost or changed on the line. The plate was not moved. Check the \
                 cable",
                gcode::mm(-position_um)
            ));
        }
        running.stage = Stage::Resting(None);
        self.push(gcode::plate_to_zero(speed_um_s));
        self.push(gcode::SYNC);
    }

    /// Makes lines of what is to be marked.
    pub(super) fn make_lines(&mut self) {
        // After a reset, nothing may follow: it would be carried out without the lines before it.
        if self.reset.is_some() {
            return;
        }
        let Some(running) = self.running.as_mut().filter(|running| running.stage == Stage::Lines) else { return };
        let Act::Mark(marking) = &mut running.act else { return };
        match marking.make(&mut self.buffer, &mut self.sender, self.now_us) {
            Made::More => {}
            Made::All => running.stage = Stage::Resting(None),
            Made::Bad(why) => {
                let text = format!("layer {}: {why}", marking.id.layer);
                self.fail(text);
            }
            Made::NoSuchVector => self.end_act(Reply::Refused(Refusal::WrongVector)),
        }
    }
}
