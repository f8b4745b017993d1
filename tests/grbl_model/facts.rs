//! What the machine really did: marks, jumps, light, and the lines it got. No host can influence it.

use super::options::AXES;

/// A straight motion with the laser on.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Machine coordinates.
    pub from_mm: [f64; AXES],
    /// Where the motion ended, or where it was cut off.
    pub to_mm: [f64; AXES],
    /// The power word as sent. A value above `$30` acts as `$30`.
    pub s: f64,
    pub feed_mm_per_min: f64,
    pub began_us: u64,
    pub ended_us: u64,
    /// False if it was cut off by a reset.
    pub whole: bool,
}

/// A motion with the laser off.
#[derive(Clone, Debug, PartialEq)]
pub struct Jump {
    pub from_mm: [f64; AXES],
    pub to_mm: [f64; AXES],
    pub began_us: u64,
    pub ended_us: u64,
    /// False if it was cut off by a reset.
    pub whole: bool,
}

/// A line as the machine read it, and how it was answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    pub text: String,
    pub read_us: u64,
    /// 0 is `ok`.
    pub error: u8,
}

/// Everything kept. Times are on the machine's clock.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    pub marks: Vec<Mark>,
    pub jumps: Vec<Jump>,
    pub lines: Vec<Line>,
    /// When each 0x18 arrived.
    pub resets_us: Vec<u64>,
    /// Bytes that found the receive buffer full.
    pub overflowed_bytes: usize,
    pub received_bytes: usize,
    /// How long the laser was on.
    pub lit_us: u64,
    /// How long it was on while the machine stood.
    pub at_rest_lit_us: u64,
    /// Longest time it was on while the machine stood, without a pause.
    pub longest_at_rest_lit_us: u64,
    /// The laser is on now.
    pub is_lit: bool,
    /// Where the machine is, in machine coordinates.
    pub position_mm: [f64; AXES],
    pub is_moving: bool,
}

impl Facts {
    /// How long the laser was on while the machine stood, in milliseconds.
    pub fn at_rest_lit_ms(&self) -> f64 {
        self.at_rest_lit_us as f64 / 1e3
    }

    /// Length of all marks in mm.
    pub fn marked_mm(&self) -> f64 {
        self.marks.iter().map(|mark| distance_mm(&mark.from_mm, &mark.to_mm)).sum()
    }

    /// Lines that were refused.
    pub fn errors(&self) -> Vec<&Line> {
        self.lines.iter().filter(|line| line.error != 0).collect()
    }
}

/// The distance between two points in mm.
pub fn distance_mm(from: &[f64; AXES], to: &[f64; AXES]) -> f64 {
    from.iter().zip(to).map(|(from, to)| (to - from) * (to - from)).sum::<f64>().sqrt()
}

/// Accounts for the light.
#[derive(Debug, Default)]
pub(super) struct Beam {
    s: f64,
    is_moving: bool,
    since_us: u64,
    at_rest_for_us: u64,
}

impl Beam {
    /// The power and whether the machine moves, from now on.
    pub(super) fn set(&mut self, now_us: u64, s: f64, is_moving: bool, facts: &mut Facts) {
        self.account(now_us, facts);
        self.s = s;
        self.is_moving = is_moving;
        if s <= 0.0 || is_moving {
            self.at_rest_for_us = 0;
        }
        facts.is_lit = s > 0.0;
        facts.is_moving = is_moving;
    }

    /// Adds the time since the last account.
    pub(super) fn account(&mut self, now_us: u64, facts: &mut Facts) {
        let passed_us = now_us.saturating_sub(self.since_us);
        self.since_us = now_us;
        if self.s <= 0.0 {
            return;
        }
        facts.lit_us += passed_us;
        if !self.is_moving {
            facts.at_rest_lit_us += passed_us;
            self.at_rest_for_us += passed_us;
            facts.longest_at_rest_lit_us = facts.longest_at_rest_lit_us.max(self.at_rest_for_us);
        }
    }
}
