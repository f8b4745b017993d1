//! Acts: lines for the controller, and what their end shows. Part of [`Firmware`](super::Firmware).

use super::rest::Ended;
use super::{Firmware, Readiness};
use crate::link::grbl::answer::State;
use crate::link::grbl::gcode;
use crate::link::grbl::marking::{Made, Marking};
use crate::link::grbl::path::length_um;
use crate::link::grbl::sender::Kind;
use crate::link::message::{ExposureId, PowderReply, PowderRequest, Refusal, Reply};

/// The status is asked for this often during an act, microseconds. An axis that moves by a changed byte is stopped after that.
const WATCH_US: u64 = 50_000;
/// A beam or plate that does not move for this long, with lines before it, is stuck, microseconds.
const STALL_US: u64 = 5_000_000;
/// After its last line is done, a controller is at rest within this time, microseconds.
const REST_US: u64 = 2_000_000;

/// An act under way.
#[derive(Debug)]
pub(super) struct Running {
    /// Of its request, while its session lasts.
    pub(super) number: Option<u32>,
    pub(super) act: Act,
    stage: Stage,
    /// When the status is asked for next, and when anything went on last, microseconds.
    watch_us: u64,
    moved_us: u64,
    /// Reports in a row of a beam that is beside its way.
    astray: u32,
    /// Whether the controller homes, and may answer nothing for minutes.
    is_homing: bool,
    /// Where the plate was at the start, micrometres in G54.
    z_um: Option<i32>,
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
enum Stage {
    /// The controller is prepared; then its position is asked for, where the way of the beam begins.
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
        self.running = Some(Running {
            number: Some(number),
            act,
            stage,
            watch_us: now_us,
            moved_us: now_us,
            astray: 0,
            is_homing,
            z_um,
        });
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

    /// The lines of an act; of a marking, those before its way begins. Returns whether the first one homes.
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
            Stage::Preparing if is_idle && self.sender.is_empty() => self.begin_way(at_um),
            Stage::Preparing | Stage::Naming => {}
            Stage::Lines | Stage::Resting(None) => self.watch_beam(at_um),
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
                "the plate is at Z{}, between Z{} and Z{} it should be: bytes were lost or changed on the line. Check the cable and look at \
                 the part",
                gcode::mm(z_um),
                gcode::mm(from_um),
                gcode::mm(to_um)
            )
        })
    }

    fn plate_tolerance_um(&self) -> u32 {
        self.controller.as_ref().map_or(0, |controller| controller.plate_tolerance_um)
    }

    /// The controller must have understood the modes, which no answer to a line shows.
    fn has_modes(&self) -> bool {
        let words: Vec<&str> = self.modes.split(' ').collect();
        gcode::MARKING_MODES.iter().all(|mode| words.contains(mode))
    }

    fn begin_way(&mut self, at_um: [i32; 3]) {
        if !self.has_modes() {
            return self.fail(format!(
                "the controller has understood other modes than it was sent (`{}`): bytes were lost or changed on the line. Nothing was \
                 marked. Check the cable",
                crate::text::plain_line(&self.modes)
            ));
        }
        let (Some(running), Some(controller)) = (&mut self.running, &self.controller) else { return };
        if let Some(marking) = running.marking_mut() {
            marking.begin([at_um[0], at_um[1]], controller);
            running.stage = Stage::Lines;
        }
    }

    /// The beam must be on its way. Two reports in a row beside it are not a coincidence.
    fn watch_beam(&mut self, at_um: [i32; 3]) {
        let Some(running) = &mut self.running else { return };
        let Some(marking) = running.marking_mut() else { return };
        running.astray = if marking.seen([at_um[0], at_um[1]]) { 0 } else { running.astray + 1 };
        if running.astray > 1 {
            let [x, y] = [at_um[0], at_um[1]].map(gcode::mm);
            self.fail(format!(
                "the beam is at X{x} Y{y}, which is not on its way: bytes were lost or changed on the line, or the axes lost steps. \
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

    /// A marking ended early, with the beam at rest here.
    pub(super) fn end_early(&mut self, at_um: [i32; 2], is_cut: bool, fault: Option<String>) {
        if let Some(marking) = self.marking() {
            let (id, vectors, cut) = (marking.id, marking.vectors(), marking.cut(at_um, is_cut));
            self.note_cut(Ended { id, vectors, cut });
        }
        // First the reason, then what it led to.
        if let Some(text) = fault {
            self.report_fault(text);
        }
        self.end_act(Reply::Refused(Refusal::CutShort));
    }
}
