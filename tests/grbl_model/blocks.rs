//! Lines of G-code become steps, which are done one after the other; some wait for the planner, some for the end of all motion.

use std::collections::VecDeque;

use super::facts::distance_mm;
use super::gcode::{Axes, Modes, Request, Spindle};
use super::machine::{Busy, Machine};
use super::motion::Block;
use super::options::AXES;

/// A homing cycle.
const HOMING_US: u64 = 1_000_000;

/// One thing that a line asks for.
#[derive(Debug)]
pub(super) enum Step {
    /// After all motion.
    Spindle(Spindle, f64),
    /// After all motion.
    Coolant,
    /// After all motion.
    Dwell(u64),
    /// As soon as the planner has room.
    Move(Block),
    Home,
}

/// A line that is being done.
#[derive(Debug)]
pub(super) struct Doing {
    pub(super) steps: VecDeque<Step>,
    pub(super) is_move: bool,
}

impl Machine {
    /// Does a line of G-code that was read.
    pub(super) fn request(&mut self, text: &str, request: &Request) {
        let mut steps = VecDeque::new();
        let is_g1_before = self.modes.is_feed;
        let before = std::mem::replace(&mut self.modes, request.modes.clone());
        let moves = request.axes_are == Axes::Motion;
        // A new S waits for the end of all motion, except on a motion in laser mode.
        let is_s_alone = request.has_s && before.s != request.modes.s && !(self.is_laser() && moves);
        if request.modes.spindle != before.spindle || is_s_alone {
            steps.push_back(Step::Spindle(request.modes.spindle, request.modes.s));
        }
        if request.modes.is_coolant != before.is_coolant {
            steps.push_back(Step::Coolant);
        }
        if let Some(seconds) = request.dwell_s {
            steps.push_back(Step::Dwell((seconds * 1e6) as u64));
        }
        if request.clears_g92 {
            self.g92 = [0.0; AXES];
        }
        if request.modes.system != before.system || request.clears_g92 {
            self.rare.offset_changed();
        }
        match request.axes_are {
            Axes::Nothing => {}
            Axes::SetPosition => self.set_position(request),
            Axes::Motion => match self.planned(request) {
                Ok(Some(block)) => steps.push_back(Step::Move(block)),
                Ok(None) => {}
                Err(()) => return self.soft_limit(text),
            },
        }
        if request.is_end {
            steps.push_back(Step::Spindle(Spindle::Off, 0.0));
            self.modes = Modes { is_feed: is_g1_before, ..Modes::new() };
        }
        if self.is_checking {
            self.parsed = self.motion.at(self.now_us).0;
            return self.answer(text, 0);
        }
        self.note_line(text, 0);
        self.doing = Some(Doing { steps, is_move: moves });
    }

    pub(super) fn set_position(&mut self, request: &Request) {
        let scale = request.modes.mm_per_unit();
        for axis in 0..AXES {
            if let Some(value) = request.axes[axis] {
                self.g92[axis] = self.parsed[axis] - self.systems[self.modes.system][axis] - value * scale;
            }
        }
        self.rare.offset_changed();
    }

    /// The motion that a line asks for; none if it goes nowhere. An error if it leaves the soft limits.
    pub(super) fn planned(&mut self, request: &Request) -> Result<Option<Block>, ()> {
        let scale = request.modes.mm_per_unit();
        let offset = self.offset();
        let mut to = self.parsed;
        for axis in 0..AXES {
            let Some(value) = request.axes[axis] else { continue };
            to[axis] = match () {
                () if request.is_machine => value * scale,
                () if request.modes.is_incremental => self.parsed[axis] + value * scale,
                () => value * scale + offset[axis],
            };
        }
        let axes = self.options.axes.min(3);
        let is_outside = |axis: usize| to[axis] > 0.0 || to[axis] < -self.number(130 + axis as u16);
        if self.number(20) != 0.0 && (0..axes).any(is_outside) {
            return Err(());
        }
        let from = self.stepped(self.parsed);
        self.parsed = to;
        let to = self.stepped(to);
        let length = distance_mm(&from, &to);
        if length == 0.0 {
            return Ok(None);
        }
        let share = |axis: usize| ((to[axis] - from[axis]) / length).abs();
        let limit = |setting: u16| {
            (0..self.options.axes)
                .filter(|axis| share(*axis) > 0.0)
                .map(|axis| self.number(setting + axis as u16) / share(axis))
                .fold(f64::INFINITY, f64::min)
        };
        let is_feed = request.modes.is_feed;
        let fastest = limit(110);
        let rate = if is_feed { request.modes.feed_mm_per_min.min(fastest) } else { fastest };
        let mut block = Block::new(from, to, rate / 60.0, limit(120));
        block.feed_mm_per_min = if is_feed { request.modes.feed_mm_per_min } else { fastest };
        block.is_dynamic = self.is_laser() && request.modes.spindle == Spindle::Dynamic;
        if is_feed && request.modes.spindle != Spindle::Off {
            block.s = request.modes.s;
        }
        Ok(Some(block))
    }

    pub(super) fn soft_limit(&mut self, text: &str) {
        self.note_line(text, 0);
        self.stop_all();
        self.alarm = Some(2);
        self.is_locked_until_reset = !self.is_hal();
        self.say("ALARM:2\r\n[MSG:Reset to continue]\r\n");
    }

    /// Does the next part of the line in work. False if that has to wait.
    pub(super) fn step(&mut self) -> bool {
        let Some(doing) = &mut self.doing else { return false };
        let Some(step) = doing.steps.pop_front() else {
            let is_move = doing.is_move;
            self.doing = None;
            self.done(is_move);
            return true;
        };
        let must_wait = match &step {
            Step::Move(_) => self.motion.planned() >= self.options.planner_blocks,
            _ => self.motion.planned() > 0,
        };
        if must_wait {
            doing.steps.push_front(step);
            return false;
        }
        match step {
            Step::Spindle(spindle, s) => {
                self.spindle = spindle;
                let burns = match spindle {
                    Spindle::Off => false,
                    Spindle::Constant => !self.is_laser() || self.modes.is_feed,
                    Spindle::Dynamic => !self.is_laser(),
                };
                self.rest_s = if burns { s } else { 0.0 };
                self.light();
            }
            Step::Dwell(us) => self.busy = Busy::Dwell { until_us: self.now_us + us },
            Step::Home => self.busy = Busy::Homing { until_us: self.now_us + HOMING_US },
            Step::Coolant => {}
            Step::Move(block) => {
                if self.motion.push(block, self.now_us) {
                    self.begin_motion();
                }
            }
        }
        true
    }

    /// The `ok` of a line whose parts are done. The line is among the facts already.
    pub(super) fn done(&mut self, is_move: bool) {
        if !self.trouble.loses_ok() {
            self.say("ok\r\n");
        }
        if is_move {
            self.trouble.moved();
        }
    }
}
