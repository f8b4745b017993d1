//! The planner and the axes: a queue of straight motions, trapezoidal speeds with look-ahead, and where the machine is at a moment.

use std::collections::VecDeque;

use super::facts::distance_mm;
use super::options::AXES;

/// A planned motion. Lengths in mm, speeds in mm/s.
#[derive(Clone, Debug)]
pub(super) struct Block {
    pub(super) from: [f64; AXES],
    pub(super) to: [f64; AXES],
    pub(super) nominal: f64,
    pub(super) acceleration: f64,
    /// The laser's power while it moves; 0 is a jump.
    pub(super) s: f64,
    /// The power is scaled by the speed, as M4 does.
    pub(super) is_dynamic: bool,
    pub(super) feed_mm_per_min: f64,
    /// Speed limit at its start, from the corner with the one before.
    largest_entry: f64,
    entry: f64,
}

impl Block {
    pub(super) fn new(from: [f64; AXES], to: [f64; AXES], nominal: f64, acceleration: f64) -> Self {
        Self {
            from,
            to,
            nominal,
            acceleration,
            s: 0.0,
            is_dynamic: false,
            feed_mm_per_min: 0.0,
            largest_entry: 0.0,
            entry: 0.0,
        }
    }

    fn length(&self) -> f64 {
        distance_mm(&self.from, &self.to)
    }

    fn direction(&self) -> [f64; AXES] {
        let length = self.length();
        std::array::from_fn(|axis| (self.to[axis] - self.from[axis]) / length)
    }

    fn at(&self, done: f64) -> [f64; AXES] {
        let part = (done / self.length()).clamp(0.0, 1.0);
        std::array::from_fn(|axis| self.from[axis] + (self.to[axis] - self.from[axis]) * part)
    }
}

/// Speeds over a distance: faster, steady, slower.
#[derive(Clone, Debug)]
struct Profile {
    begin: f64,
    top: f64,
    acceleration: f64,
    faster_s: f64,
    steady_s: f64,
    slower_s: f64,
}

impl Profile {
    fn new(distance: f64, begin: f64, end: f64, nominal: f64, acceleration: f64) -> Self {
        // Rounding may leave the end out of reach by a hair.
        let end = end.min((begin * begin + 2.0 * acceleration * distance).sqrt());
        let peak = ((2.0 * acceleration * distance + begin * begin + end * end) / 2.0).max(0.0).sqrt();
        let top = nominal.min(peak).max(begin).max(end);
        let faster = (top * top - begin * begin) / (2.0 * acceleration);
        let slower = (top * top - end * end) / (2.0 * acceleration);
        let steady = (distance - faster - slower).max(0.0);
        Self {
            begin,
            top,
            acceleration,
            faster_s: (top - begin) / acceleration,
            steady_s: if top > 0.0 { steady / top } else { 0.0 },
            slower_s: (top - end) / acceleration,
        }
    }

    /// To a standstill.
    fn braking(begin: f64, acceleration: f64) -> Self {
        Self { begin, top: begin, acceleration, faster_s: 0.0, steady_s: 0.0, slower_s: begin / acceleration }
    }

    fn seconds(&self) -> f64 {
        self.faster_s + self.steady_s + self.slower_s
    }

    /// Distance and speed after a time.
    fn after(&self, seconds: f64) -> (f64, f64) {
        let t = seconds.clamp(0.0, self.seconds());
        let a = self.acceleration;
        if t <= self.faster_s {
            return (self.begin * t + a * t * t / 2.0, self.begin + a * t);
        }
        let risen = (self.begin + self.top) / 2.0 * self.faster_s;
        let steady = (t - self.faster_s).min(self.steady_s);
        let falling = (t - self.faster_s - steady).max(0.0);
        let fallen = self.top * falling - a * falling * falling / 2.0;
        (risen + self.top * steady + fallen, (self.top - a * falling).max(0.0))
    }

    /// When a distance is reached, if it is.
    fn seconds_to(&self, distance: f64) -> f64 {
        let (mut low, mut high) = (0.0, self.seconds());
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if self.after(middle).0 < distance { low = middle } else { high = middle }
        }
        high
    }
}

/// The motion that runs.
#[derive(Debug)]
struct Run {
    block: Block,
    /// Distance done when the profile began.
    done: f64,
    began_us: u64,
    profile: Profile,
    ends_us: u64,
}

/// What happens at the end of a motion's profile.
#[derive(Debug)]
pub(super) enum Ended {
    /// The motion is done.
    Done(Block),
    /// It stands in the middle, because of a hold.
    Held,
}

/// The planner.
#[derive(Debug, Default)]
pub(super) struct Motion {
    queue: VecDeque<Block>,
    run: Option<Run>,
    is_holding: bool,
    /// Where it stands, if nothing runs.
    stands: [f64; AXES],
    junction_deviation: f64,
}

impl Motion {
    pub(super) fn new(at: [f64; AXES], junction_deviation: f64) -> Self {
        Self { stands: at, junction_deviation, ..Self::default() }
    }

    /// Motions that are planned, with the one that runs.
    pub(super) fn planned(&self) -> usize {
        self.queue.len() + usize::from(self.run.is_some())
    }

    pub(super) fn running(&self) -> Option<&Block> {
        self.run.as_ref().map(|run| &run.block)
    }

    /// When the profile that runs ends.
    pub(super) fn ends_us(&self) -> Option<u64> {
        self.run.as_ref().map(|run| run.ends_us).filter(|ends| *ends != u64::MAX)
    }

    /// Position and speed.
    pub(super) fn at(&self, now_us: u64) -> ([f64; AXES], f64) {
        let Some(run) = &self.run else { return (self.stands, 0.0) };
        let (distance, speed) = run.profile.after(seconds(run.began_us, now_us));
        (run.block.at(run.done + distance), speed)
    }

    /// Adds a motion. True if the machine begins to move by it.
    pub(super) fn push(&mut self, mut block: Block, now_us: u64) -> bool {
        let before = self.queue.back().or(self.running());
        block.largest_entry = before.map_or(0.0, |before| self.corner_speed(before, &block));
        self.queue.push_back(block);
        self.plan();
        if self.run.is_none() && !self.is_holding {
            return self.start(now_us, 0.0);
        }
        if !self.is_holding {
            self.replan(now_us);
        }
        false
    }

    /// The speed at which a corner may be taken: a circle that leaves it by the junction deviation.
    fn corner_speed(&self, before: &Block, after: &Block) -> f64 {
        let slower = before.nominal.min(after.nominal);
        let cosine: f64 = before.direction().iter().zip(after.direction()).map(|(a, b)| -a * b).sum();
        if cosine < -0.999_999 {
            return slower;
        }
        if cosine > 0.999_999 {
            return 0.0;
        }
        let sine_half = ((1.0 - cosine) / 2.0).sqrt();
        let acceleration = before.acceleration.min(after.acceleration);
        slower.min((acceleration * self.junction_deviation * sine_half / (1.0 - sine_half)).sqrt())
    }

    /// Entry speeds from which the machine can still stop at the end of the queue.
    fn plan(&mut self) {
        let mut next = 0.0f64;
        for block in self.queue.iter_mut().rev() {
            let reachable = (next * next + 2.0 * block.acceleration * block.length()).sqrt();
            block.entry = block.largest_entry.min(reachable);
            next = block.entry;
        }
    }

    fn exit_speed(&self) -> f64 {
        self.queue.front().map_or(0.0, |next| next.entry)
    }

    /// A new profile for the rest of the motion that runs, because what follows it changed.
    fn replan(&mut self, now_us: u64) {
        let exit = self.exit_speed();
        let Some(run) = &mut self.run else { return };
        let (distance, speed) = run.profile.after(seconds(run.began_us, now_us));
        run.done += distance;
        run.began_us = now_us;
        let rest = (run.block.length() - run.done).max(0.0);
        run.profile = Profile::new(rest, speed, exit, run.block.nominal, run.block.acceleration);
        run.ends_us = now_us + micros(run.profile.seconds());
    }

    /// Begins the next motion at a speed. False if there is none.
    pub(super) fn start(&mut self, now_us: u64, speed: f64) -> bool {
        let Some(block) = self.queue.pop_front() else { return false };
        let profile = Profile::new(block.length(), speed, self.exit_speed(), block.nominal, block.acceleration);
        let ends_us = now_us + micros(profile.seconds());
        self.run = Some(Run { block, done: 0.0, began_us: now_us, profile, ends_us });
        if self.is_holding {
            self.brake(now_us, speed);
        }
        true
    }

    /// The end of the profile that runs: at `ends_us`.
    pub(super) fn end(&mut self, now_us: u64) -> Option<(Ended, f64)> {
        let run = self.run.as_mut()?;
        let (distance, speed) = run.profile.after(seconds(run.began_us, now_us));
        if self.is_holding && run.done + distance < run.block.length() - 1e-9 {
            run.done += distance;
            run.began_us = now_us;
            run.profile = Profile::braking(0.0, run.block.acceleration);
            run.ends_us = u64::MAX;
            return Some((Ended::Held, 0.0));
        }
        let run = self.run.take()?;
        self.stands = run.block.to;
        Some((Ended::Done(run.block), speed))
    }

    /// Brakes now and stands still until `resume`.
    pub(super) fn hold(&mut self, now_us: u64) {
        self.is_holding = true;
        let (_, speed) = self.at(now_us);
        self.brake(now_us, speed);
    }

    fn brake(&mut self, now_us: u64, speed: f64) {
        let Some(run) = &mut self.run else { return };
        let (distance, _) = run.profile.after(seconds(run.began_us, now_us));
        run.done += distance;
        run.began_us = now_us;
        run.profile = Profile::braking(speed, run.block.acceleration);
        let rest = run.block.length() - run.done;
        let (whole, _) = run.profile.after(run.profile.seconds());
        let takes_s = if whole >= rest { run.profile.seconds_to(rest) } else { run.profile.seconds() };
        run.ends_us = now_us + micros(takes_s);
    }

    /// It is held and stands still.
    pub(super) fn is_held(&self) -> bool {
        self.is_holding && self.run.as_ref().is_none_or(|run| run.ends_us == u64::MAX)
    }

    pub(super) fn is_holding(&self) -> bool {
        self.is_holding
    }

    /// Goes on after a hold. True if the machine moves.
    pub(super) fn resume(&mut self, now_us: u64) -> bool {
        self.is_holding = false;
        if self.run.is_some() {
            self.replan(now_us);
            return true;
        }
        self.start(now_us, 0.0)
    }

    /// Stands still at once and forgets everything. The motion that ran, and where it was cut off.
    pub(super) fn stop(&mut self, now_us: u64) -> Option<Block> {
        self.stands = self.at(now_us).0;
        self.queue.clear();
        self.is_holding = false;
        self.run.take().map(|run| run.block)
    }

    /// Puts the machine somewhere else, as homing does.
    pub(super) fn place(&mut self, at: [f64; AXES]) {
        self.stands = at;
    }
}

fn seconds(from_us: u64, to_us: u64) -> f64 {
    to_us.saturating_sub(from_us) as f64 / 1e6
}

/// At least one, so that a motion always ends after it began.
fn micros(seconds: f64) -> u64 {
    ((seconds * 1e6).ceil() as u64).max(1)
}
