//! The controller without its port: bytes in, bytes out, time as a number. Lines, modal state, alarms, motion and light.
//!
//! Not modelled: arcs, jogging, probing, tool changes, overrides, parking; such lines are refused as unknown.

use std::collections::VecDeque;

use super::blocks::Doing;
use super::facts::{Beam, Facts, Line};
use super::gcode::{Modes, Spindle};
use super::motion::Motion;
use super::options::{AXES, Firmware, Options};
use super::system::{Rare, Status};
use super::trouble::Trouble;

/// The shortest time between two status reports: `?` in between are answered by one.
const REPORT_US: u64 = 5_000;

/// What a machine says instead of answers. Noise may have ends of lines too.
const NOISE: &[u8] = b"\x01\xfeok7@@\x7f\r\n<R|MPo";

/// Why lines are not taken now.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Busy {
    No,
    Dwell {
        until_us: u64,
    },
    Homing {
        until_us: u64,
    },
    /// Until the banner.
    Starting {
        until_us: u64,
    },
}

/// A controller on a machine. Time never goes back between calls.
pub(crate) struct Machine {
    pub(super) options: Options,
    pub(super) facts: Facts,
    pub(super) beam: Beam,
    pub(super) motion: Motion,
    pub(super) modes: Modes,
    pub(super) systems: [[f64; AXES]; 6],
    pub(super) g92: [f64; AXES],
    /// Where the parser is, in machine coordinates: the end of the last motion that was read.
    pub(super) parsed: [f64; AXES],
    /// The spindle as it is, not as it was read.
    pub(super) spindle: Spindle,
    /// Where coordinates are zero, from where the machine was when it was built. Power that goes moves it.
    pub(super) origin: [f64; AXES],
    /// Power that burns at rest, if it does.
    pub(super) rest_s: f64,
    pub(super) buffer: VecDeque<u8>,
    pub(super) line: String,
    /// The character that ended the last line, for CR LF on grblHAL.
    pub(super) ended_by: u8,
    /// The character that began the comment that is being received.
    pub(super) comment: Option<u8>,
    pub(super) is_too_long: bool,
    /// What the line that is being done still asks for; its `ok` comes after.
    pub(super) doing: Option<Doing>,
    pub(super) busy: Busy,
    pub(super) alarm: Option<u8>,
    /// Only on 1.1.
    pub(super) is_locked_until_reset: bool,
    pub(super) needs_homing: bool,
    pub(super) is_homed: bool,
    pub(super) is_checking: bool,
    /// grblHAL repeats this error for each line of G-code.
    pub(super) sticky_error: u8,
    pub(super) rare: Rare,
    pub(super) wants_status: bool,
    pub(super) reported_us: Option<u64>,
    pub(super) trouble: Trouble,
    pub(super) output: Vec<u8>,
    pub(super) now_us: u64,
}

impl Machine {
    pub(crate) fn new(options: Options) -> Self {
        let deviation = options.settings.get(&11).copied().unwrap_or(0.01);
        let trouble = Trouble::new(&options.faults);
        let mut systems = [[0.0; AXES]; 6];
        systems[0] = options.work_offset_mm;
        let mut machine = Self {
            facts: Facts::default(),
            beam: Beam::default(),
            motion: Motion::new([0.0; AXES], deviation),
            modes: Modes::new(),
            systems,
            g92: [0.0; AXES],
            parsed: [0.0; AXES],
            spindle: Spindle::Off,
            origin: [0.0; AXES],
            rest_s: 0.0,
            buffer: VecDeque::new(),
            line: String::new(),
            ended_by: 0,
            comment: None,
            is_too_long: false,
            doing: None,
            busy: Busy::Starting { until_us: 0 },
            alarm: None,
            is_locked_until_reset: false,
            needs_homing: false,
            is_homed: false,
            is_checking: false,
            sticky_error: 0,
            rare: Rare::new(options.firmware),
            wants_status: false,
            reported_us: None,
            trouble,
            output: Vec::new(),
            now_us: 0,
            options,
        };
        machine.power_on(0);
        machine
    }

    /// The facts up to now.
    pub(crate) fn facts(&mut self) -> Facts {
        self.beam.account(self.now_us, &mut self.facts);
        self.facts.position_mm = self.true_place(self.stepped(self.motion.at(self.now_us).0));
        self.facts.clone()
    }

    /// Bytes for the host since the last call.
    pub(crate) fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    /// A byte comes out of the line.
    pub(crate) fn receive(&mut self, now_us: u64, byte: u8) {
        self.advance(now_us);
        self.facts.received_bytes += 1;
        let Some(byte) = self.trouble.on_line(byte) else { return };
        match byte {
            0x18 => self.reset(),
            b'?' => self.wants_status = true,
            0x80 | 0x87 if self.is_hal() => self.wants_status = true,
            b'!' => self.hold(),
            b'~' => self.resume(),
            0x80.. => {}
            _ if self.buffer.len() >= self.options.receive_bytes => self.facts.overflowed_bytes += 1,
            _ => self.buffer.push_back(byte),
        }
        self.advance(now_us);
    }

    /// Lets time pass.
    pub(crate) fn advance(&mut self, to_us: u64) {
        loop {
            self.work();
            let next_us = [self.motion.ends_us(), self.busy_until()].into_iter().flatten().min();
            match next_us {
                Some(next_us) if next_us <= to_us => self.now_us = self.now_us.max(next_us),
                _ => break,
            }
            if self.motion.ends_us().is_some_and(|ends| ends <= self.now_us) {
                self.end_motion();
            }
            if self.busy_until().is_some_and(|until| until <= self.now_us) {
                self.end_busy();
            }
        }
        self.now_us = self.now_us.max(to_us);
        self.work();
    }

    pub(super) fn busy_until(&self) -> Option<u64> {
        match self.busy {
            Busy::No => None,
            Busy::Dwell { until_us } | Busy::Homing { until_us } | Busy::Starting { until_us } => Some(until_us),
        }
    }

    pub(super) fn end_busy(&mut self) {
        match std::mem::replace(&mut self.busy, Busy::No) {
            Busy::No | Busy::Dwell { .. } => {}
            Busy::Homing { .. } => {
                let back_mm = self.number(27);
                let at = std::array::from_fn(|axis| if axis < 3 { -back_mm } else { 0.0 });
                self.origin = [0.0; AXES];
                self.motion.place(at);
                self.parsed = at;
                self.is_homed = true;
                self.alarm = None;
                self.needs_homing = false;
            }
            Busy::Starting { .. } => self.start(),
        }
    }

    pub(super) fn number(&self, setting: u16) -> f64 {
        self.options.settings.get(&setting).copied().unwrap_or(0.0)
    }

    pub(super) fn is_hal(&self) -> bool {
        self.options.firmware == Firmware::GrblHal
    }

    pub(super) fn is_laser(&self) -> bool {
        self.number(32) != 0.0
    }

    /// Keeps a line that was read.
    pub(super) fn note_line(&mut self, text: &str, error: u8) {
        self.facts.lines.push(Line { text: text.to_owned(), read_us: self.now_us, error });
    }

    pub(super) fn say(&mut self, text: &str) {
        if self.trouble.is_garbage() {
            self.output.extend_from_slice(NOISE);
        } else if !self.trouble.is_silent() {
            self.output.extend_from_slice(text.as_bytes());
        }
    }

    /// Does what can be done at this moment.
    pub(super) fn work(&mut self) {
        self.report_if_due();
        while self.busy == Busy::No && !self.motion.is_holding() && !self.is_locked_until_reset {
            if self.doing.is_some() {
                if !self.step() {
                    break;
                }
                continue;
            }
            if self.trouble.is_stalled() {
                break;
            }
            let Some(byte) = self.buffer.pop_front() else { break };
            self.character(byte);
        }
    }

    pub(super) fn report_if_due(&mut self) {
        let is_deaf = match self.busy {
            Busy::Starting { .. } => true,
            Busy::Homing { .. } => !self.is_hal(),
            _ => self.is_locked_until_reset,
        };
        let pause_us = REPORT_US.max(self.options.status_every_ms * 1000);
        let is_soon = self.reported_us.is_some_and(|before| self.now_us < before + pause_us);
        if !self.wants_status || is_deaf {
            return;
        }
        if is_soon {
            // Answered later, unless the machine is one that does not.
            self.wants_status = self.options.status_every_ms == 0;
            return;
        }
        self.wants_status = false;
        self.reported_us = Some(self.now_us);
        let report = self.status();
        self.say(&report);
    }

    pub(super) fn offset(&self) -> [f64; AXES] {
        std::array::from_fn(|axis| self.systems[self.modes.system][axis] + self.g92[axis])
    }

    /// A place as the facts tell it: whatever the machine believes.
    pub(super) fn true_place(&self, at: [f64; AXES]) -> [f64; AXES] {
        std::array::from_fn(|axis| at[axis] + self.origin[axis])
    }

    /// The nearest place at a whole step.
    pub(super) fn stepped(&self, at: [f64; AXES]) -> [f64; AXES] {
        std::array::from_fn(|axis| {
            let per_mm = self.number(100 + axis as u16).max(1.0);
            (at[axis] * per_mm).round() / per_mm
        })
    }

    pub(super) fn status(&mut self) -> String {
        let (position, speed) = self.motion.at(self.now_us);
        let s = match self.motion.running() {
            Some(block) if block.is_dynamic => block.s * (speed / block.nominal).min(1.0),
            Some(block) => block.s,
            None => self.rest_s,
        };
        let status = Status {
            state: self.state(),
            position: self.stepped(position),
            offset: self.offset(),
            free_blocks: self.options.planner_blocks.saturating_sub(self.motion.planned()),
            free_bytes: self.options.receive_bytes.saturating_sub(self.buffer.len()),
            speed_mm_per_min: speed * 60.0,
            s,
            spindle: self.spindle,
            is_coolant: self.modes.is_coolant,
            is_homed: self.is_homed,
        };
        self.rare.report(&status, &self.options)
    }

    pub(super) fn state(&self) -> &'static str {
        match () {
            () if matches!(self.busy, Busy::Homing { .. }) => "Home",
            () if self.alarm.is_some() => "Alarm",
            () if self.is_checking => "Check",
            () if self.motion.is_held() => "Hold:0",
            () if self.motion.is_holding() => "Hold:1",
            () if self.motion.running().is_some() => "Run",
            () => "Idle",
        }
    }

    pub(super) fn is_idle(&self) -> bool {
        self.motion.running().is_none() && !self.motion.is_holding() && self.alarm.is_none() && !self.is_checking
    }
}
