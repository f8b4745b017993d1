//! The world: one clock for host, line and machine, what happens to them, and the invariants, checked at every step.

mod faults;
mod journals;
mod light;
mod orders;
mod patient;
mod station;
mod views;

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, Once};

use crate::disk::{Harm, SimDisk};
use crate::host::{Host, Shared};
use crate::line::Line;
use crate::machine::Character;
use crate::operators::Answers;
use crate::parts::BAUD;
use crate::plan::{MAX_DARK_US, Plan, Planned};
use crate::rng::Rng;
use crate::truth::{Truth, Violation};
use patient::Patient;
use station::Station;

const SECOND_US: u64 = 1_000_000;
/// Turns of the loop in a whole run: a run that is longer turns in circles.
const MAX_TURNS: u64 = 3_000_000;
/// What faults came to, counted.
pub(crate) const EFFECTS: &[&str] = &[
    "effect: a write found no room",
    "effect: a write failed",
    "effect: a read failed",
    "effect: unflushed bytes lost",
    "effect: unflushed names lost",
    "effect: lies told",
];
const INTERRUPTED: &str = "effect: a vector was interrupted";
const WENT_ON: &str = "effect: a layer went on";
const DECIDED: &str = "effect: a layer was decided by an operator";
const STREAMED: &str = "effect: a layer streamed";
/// What faults came to on a laser machine, counted.
pub(crate) const LASER_EFFECTS: [&str; 4] = [INTERRUPTED, WENT_ON, DECIDED, STREAMED];

/// What came of a run.
#[derive(Debug, Default)]
pub(crate) struct Report {
    pub(crate) violation: Option<Violation>,
    /// Faults that happened, and orders that were given, by name.
    pub(crate) happened: BTreeMap<&'static str, u64>,
    pub(crate) checks: BTreeMap<&'static str, u64>,
    /// Jobs that ended, by state.
    pub(crate) ended: BTreeMap<&'static str, u64>,
    /// Prints: jobs that had light.
    pub(crate) prints: u64,
    pub(crate) layers: u64,
    pub(crate) turns: u64,
    pub(crate) virtual_us: u64,
    /// What happened, line by line, if asked for.
    pub(crate) trace: Vec<String>,
}

pub(crate) struct World {
    plan: Plan,
    now_us: u64,
    disk: SimDisk,
    shared: Arc<Shared>,
    stations: Vec<Station>,
    connected: usize,
    host: Option<Host>,
    /// When the daemon is started again.
    start_us: Option<u64>,
    /// How long the daemon will be down when it ends next.
    down_us: Option<u64>,
    /// The host stands still until then.
    frozen_until_us: Option<u64>,
    /// What ends by itself, in order of time.
    ends: BTreeMap<(u64, usize), End>,
    next_event: usize,
    answers: Answers,
    truth: Truth,
    promises: Promises,
    /// The latest time at which host, disk, line or machine were not as they should be: light is not judged soon after.
    disturbed_us: u64,
    /// The disk failed since the daemon's start, so that files may be left that could not be deleted. The next start deletes them.
    undeleted: bool,
    /// The death in a disk access that is to come is that of the whole host.
    power_fails: bool,
    /// The spool was moved aside since the daemon's start: what it promises is void once it starts in the new one.
    spool_is_new: bool,
    /// No fault but a lack of room has kept a record off the disk, and no space set aside was lost.
    reserve_holds: bool,
    /// Only what a print must survive has happened so far.
    gentle: bool,
    /// Until when the line's faults last.
    line_faulty_until_us: u64,
    patient: Patient,
    happened: BTreeMap<&'static str, u64>,
    trace: Option<Vec<String>>,
    turns: u64,
}

/// What operators ordered in the present spool, and what they were promised.
#[derive(Debug, Default)]
struct Promises {
    /// Jobs that were accepted and not removed.
    accepted: BTreeSet<u32>,
    removed: BTreeSet<u32>,
    /// New jobs that were asked for, and whose answer did not come yet.
    unanswered: usize,
    /// How many orders to remove a job were given and not refused.
    going: BTreeMap<u32, u32>,
    /// Jobs whose end was ordered, accepted without a warning.
    ended: BTreeMap<u32, &'static str>,
    /// Jobs that an operator told to stop or abort, at a random moment.
    told_to_end: BTreeSet<u32>,
    /// Jobs whose pause was accepted, and that have not rested or ended since.
    pauses: BTreeMap<u32, Pause>,
}

/// A pause that was accepted.
#[derive(Debug, Default)]
struct Pause {
    at_us: u64,
    /// Layers that had light since then.
    lit: BTreeSet<u32>,
}

/// What ends by itself.
#[derive(Clone, Copy, Debug)]
enum End {
    OtherMachine,
    DiskFull,
    DiskBroken,
    DiskUnreadable,
    DiskSlow,
}

impl World {
    pub(crate) fn new(plan: Plan, traced: bool) -> Self {
        // Made before the disk of the simulation is in place.
        plan.kind.parts();
        let mut rng = Rng::new(plan.seed ^ 0x5eed_7e57);
        let disk = SimDisk::new(rng.next_u64());
        for (path, text) in plan.kind.files(plan.confirms_plate) {
            disk.prepare(&path, text.as_bytes());
        }
        let line = Line::new(BAUD, rng.next_u64());
        let is_honest = plan.character == Character::Honest;
        let station = Station::new(plan.kind, plan.character, rng.next_u64());
        let mut world = Self {
            truth: Truth::of(plan.kind),
            plan,
            now_us: 0,
            disk,
            shared: Shared::new(line, rng.fork()),
            stations: vec![station],
            connected: 0,
            host: None,
            start_us: Some(0),
            down_us: None,
            frozen_until_us: None,
            ends: BTreeMap::new(),
            next_event: 0,
            answers: Arc::new(Mutex::new(Vec::new())),
            promises: Promises::default(),
            disturbed_us: 0,
            gentle: is_honest,
            power_fails: false,
            spool_is_new: false,
            undeleted: false,
            reserve_holds: true,
            line_faulty_until_us: 0,
            patient: Patient::default(),
            happened: BTreeMap::new(),
            trace: traced.then(Vec::new),
            turns: 0,
        };
        if let Character::Liar { .. } = world.plan.character {
            world.happen(world.plan.character.name());
        }
        world
    }

    fn note(&mut self, text: impl FnOnce() -> String) {
        let now_us = self.now_us;
        if let Some(trace) = &mut self.trace {
            let line = format!("{:>12.6} {}", now_us as f64 / 1e6, text());
            trace.push(line);
        }
    }

    fn happen(&mut self, name: &'static str) {
        *self.happened.entry(name).or_default() += 1;
    }

    fn check(&mut self, invariant: &'static str, holds: bool, text: impl FnOnce() -> String) {
        let now_us = self.now_us;
        self.truth.check(invariant, now_us, holds, text);
    }

    /// Runs to the end, or to the first violation.
    pub(crate) fn run(mut self) -> Report {
        while self.truth.violation.is_none() && !self.is_over() {
            self.turn();
        }
        self.report()
    }

    fn report(mut self) -> Report {
        if let Some(violation) = self.truth.violation.clone() {
            self.note(|| {
                format!("VIOLATION of \"{}\" at {} µs: {}", violation.invariant, violation.at_us, violation.text)
            });
        }
        let mut ended = BTreeMap::new();
        if let Some(host) = &self.host {
            for job in &host.handle.snapshot().jobs {
                *ended.entry(job.state.name()).or_default() += 1;
            }
        }
        let Harm { full, failed, unread, lost, lost_names } = self.disk.harm();
        let lies = self.stations.iter().map(|it| u64::from(it.machine.lies_told())).sum();
        for (name, count) in EFFECTS.iter().zip([full, failed, unread, lost, lost_names, lies]) {
            *self.happened.entry(name).or_default() += count;
        }
        if let Some(host) = self.host.take() {
            self.disk.kill();
            host.drop_dead();
        }
        Report {
            violation: self.truth.violation,
            happened: self.happened,
            checks: self.truth.checks,
            ended,
            prints: self.truth.printed.values().filter(|printed| !printed.whole.is_empty()).count() as u64,
            layers: self.truth.layers,
            turns: self.turns,
            virtual_us: self.now_us,
            trace: self.trace.unwrap_or_default(),
        }
    }

    fn is_over(&self) -> bool {
        self.patient.over_us.is_some_and(|over_us| self.now_us >= over_us)
    }

    fn turn(&mut self) {
        self.turns += 1;
        let now_us = self.now_us;
        self.check_host();
        if self.turns > MAX_TURNS {
            self.check("jobs end", false, || "the run turns in circles".into());
        }
        while let Some((key, end)) = self.ends.first_key_value().map(|(key, end)| (*key, *end))
            && key.0 <= now_us
        {
            self.ends.remove(&key);
            self.end(end);
        }
        while let Some(event) = self.plan.events.get(self.next_event)
            && self.due_us(event) <= now_us
        {
            let what = event.what.clone();
            self.next_event += 1;
            self.strike(&what);
        }
        if self.start_us.is_some_and(|at_us| at_us <= now_us) {
            self.start();
        }
        self.serve_machines();
        if self.frozen_until_us.is_some_and(|until_us| until_us <= now_us) {
            self.frozen_until_us = None;
            if let Some(host) = &self.host {
                host.stood_still(now_us);
            }
        }
        self.run_host();
        self.look_at_host();
        self.change_plate();
        self.watch_light();
        self.be_patient();
    }

    /// When something that is planned happens, as far as that is known now.
    fn due_us(&self, event: &Planned) -> u64 {
        let Some(lit_us) = event.lit_us else { return event.at_us };
        let latest_us = event.at_us + MAX_DARK_US;
        let lit = self.stations[self.connected].lit;
        lit.map_or(latest_us, |lit| latest_us.min(event.at_us.max(lit.since_us + lit_us)))
    }

    /// The next time at which something happens by itself.
    fn next_us(&self) -> u64 {
        let line = self.shared.line().next_us(self.now_us);
        let machines = self.stations.iter().filter_map(|station| station.machine.next_timeout_us());
        let event = self.plan.events.get(self.next_event).map(|event| self.due_us(event));
        let work =
            self.host.as_ref().filter(|_| self.frozen_until_us.is_none()).and_then(|_| self.shared.next_work_us());
        let patient = self.patient.since_us.filter(|_| self.frozen_until_us.is_none()).map(|_| self.patient.look_us);
        let end = self.ends.first_key_value().map(|((at_us, _), _)| *at_us);
        let times = [line, event, work, end, patient, self.start_us, self.frozen_until_us, self.patient.over_us];
        times
            .into_iter()
            .flatten()
            .chain(machines)
            .min()
            .unwrap_or(u64::MAX)
            .clamp(self.now_us + 1, self.now_us + SECOND_US)
    }

    /// Lets the host run to the next event, or lets that much time pass without it.
    fn run_host(&mut self) {
        let until_us = self.next_us();
        match self.host.as_ref().filter(|_| self.frozen_until_us.is_none()) {
            Some(host) => {
                host.wake_line();
                self.now_us = host.run_until(until_us).max(self.now_us);
                // One at a time: the host takes its result before the next.
                host.work(self.now_us);
                if self.disk.has_killed() {
                    if std::mem::take(&mut self.power_fails) {
                        self.disk.power_cut();
                    }
                    self.die("killed in a disk access");
                }
            }
            None => self.now_us = until_us,
        }
    }
}

thread_local! {
    /// What a panic of this thread said, whoever caught it.
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Runs a plan.
pub(crate) fn run(plan: &Plan, traced: bool) -> Report {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            PANIC.set(Some(panic.to_string()));
            before(panic);
        }));
    });
    PANIC.take();
    let world = World::new(plan.clone(), traced);
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| world.run())).unwrap_or_else(|_| {
        let text = PANIC.take().unwrap_or_default();
        Report { violation: Some(Violation { at_us: 0, invariant: "no panic", text }), ..Report::default() }
    })
}
