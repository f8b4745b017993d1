//! A search: many seeds, what happened in them, and what was violated.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::parts::{Filling, Kind};
use crate::plan::{LASER_SEEDS, Plan, characters, fault_names};
use crate::truth::{INVARIANTS, Violation, invariants};
use crate::world::{EFFECTS, LASER_EFFECTS, Report, run};

/// A search of so many seeds with a vat machine must have met every kind of fault.
const COMPLETE_SEEDS: u64 = 2_000;
/// The same with a laser machine.
const COMPLETE_LASER_SEEDS: u64 = 500;
/// In a search that begins below [`LASER_SEEDS`], one in so many runs has a laser machine.
const LASER_SHARE: u64 = 5;

/// What a search found.
#[derive(Debug, Default)]
pub(crate) struct Summary {
    pub(crate) seeds: u64,
    /// Of these, runs with a laser machine.
    laser_seeds: u64,
    happened: BTreeMap<&'static str, u64>,
    checks: BTreeMap<&'static str, u64>,
    ended: BTreeMap<&'static str, u64>,
    prints: u64,
    layers: u64,
    turns: u64,
    virtual_us: u64,
    took: Duration,
    /// Failing seeds, with what they violated first.
    pub(crate) failed: Vec<(u64, Violation)>,
}

impl Summary {
    fn add(&mut self, seed: u64, report: Report) {
        for (sum, counts) in
            [(&mut self.happened, report.happened), (&mut self.checks, report.checks), (&mut self.ended, report.ended)]
        {
            counts.into_iter().for_each(|(name, count)| *sum.entry(name).or_default() += count);
        }
        self.seeds += 1;
        self.laser_seeds += u64::from(seed >= LASER_SEEDS);
        self.prints += report.prints;
        self.layers += report.layers;
        self.turns += report.turns;
        self.virtual_us += report.virtual_us;
        self.failed.extend(report.violation.map(|violation| (seed, violation)));
    }

    fn count(&self, name: &str) -> u64 {
        self.happened.get(name).copied().unwrap_or(0)
    }

    /// Kinds of faults, lies and their effects that never happened. A search that injects no fault proves nothing, and a long one
    /// that misses a kind proves nothing of it.
    pub(crate) fn unmet(&self) -> Vec<&'static str> {
        let mut unmet = Vec::new();
        let kinds = [
            (Kind::Vat, self.seeds - self.laser_seeds, COMPLETE_SEEDS),
            (Kind::Laser(Filling::Zigzag), self.laser_seeds, COMPLETE_LASER_SEEDS),
        ];
        for (kind, seeds, complete_seeds) in kinds {
            let lies = characters(kind).into_iter().map(|(name, _)| name).filter(|name| *name != "honest");
            let own: &[_] = if kind.is_laser() { &LASER_EFFECTS } else { &[] };
            let effects = EFFECTS.iter().chain(own).copied();
            let mut kinds: Vec<_> = fault_names(kind).into_iter().chain(lies).chain(effects).collect();
            kinds.retain(|name| self.count(name) == 0);
            let is_complete = seeds >= complete_seeds;
            if is_complete {
                let checked = |name: &&str| self.checks.get(*name).is_some_and(|count| *count > 0);
                kinds.extend(invariants(kind.is_laser()).filter(|name| !checked(name)));
            }
            // With none at all, a search of any length proves nothing.
            if is_complete || self.has_met_nothing() {
                unmet.extend(kinds);
            }
        }
        unmet.sort_unstable();
        unmet.dedup();
        unmet
    }

    /// Whether no fault happened, whatever orders were given.
    fn has_met_nothing(&self) -> bool {
        self.happened.iter().all(|(name, count)| *count == 0 || name.starts_with("order"))
    }

    /// Whether every invariant held, and enough was tried.
    pub(crate) fn is_good(&self) -> bool {
        self.failed.is_empty() && self.unmet().is_empty()
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "       times what happened")?;
        self.happened.iter().try_for_each(|(name, count)| writeln!(f, "{count:>12} {name}"))?;
        writeln!(f, "\n      checks invariant                   violated by")?;
        for name in INVARIANTS {
            let failed = self.failed.iter().filter(|(_, violation)| violation.invariant == *name).count();
            let checks = self.checks.get(name).copied().unwrap_or(0);
            writeln!(f, "{checks:>12} {name:<27} {failed:>6} seeds")?;
        }
        let seconds = self.took.as_secs_f64();
        writeln!(f, "\n{} seeds, jobs by their end: {:?}", self.seeds, self.ended)?;
        write!(
            f,
            "{} prints with {} layers in {seconds:.1} s: {:.0} prints a minute; {:.1} hours of virtual time in {} turns",
            self.prints,
            self.layers,
            self.prints as f64 * 60.0 / seconds,
            self.virtual_us as f64 / 3.6e9,
            self.turns
        )?;
        for (seed, violation) in &self.failed {
            write!(f, "\nseed {seed} violates \"{}\": {}", violation.invariant, violation.text)?;
        }
        let unmet = self.unmet();
        if !unmet.is_empty() {
            write!(f, "\nnever happened, so this search proves nothing of it: {}", unmet.join(", "))?;
        }
        Ok(())
    }
}

/// What to search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Search {
    pub(crate) first: u64,
    pub(crate) seeds: u64,
    /// Each runs one seed at a time.
    pub(crate) threads: usize,
    /// The search ends after so many failing seeds.
    pub(crate) failures: usize,
    /// Nothing goes wrong: for the speed of undisturbed prints.
    pub(crate) calm: bool,
}

impl Search {
    pub(crate) fn run(self) -> Summary {
        let (next, enough) = (AtomicU64::new(0), AtomicBool::new(false));
        let (summary, began) = (Mutex::new(Summary::default()), Instant::now());
        std::thread::scope(|scope| {
            for _ in 0..self.threads.max(1) {
                scope.spawn(|| {
                    while !enough.load(Ordering::Relaxed) {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        if number >= self.seeds {
                            return;
                        }
                        let seed = self.seed(number);
                        let report = run(&plan(seed, self.calm), false);
                        let mut summary = summary.lock().expect("no panic");
                        summary.add(seed, report);
                        enough.fetch_or(summary.failed.len() >= self.failures, Ordering::Relaxed);
                    }
                });
            }
        });
        Summary { took: began.elapsed(), ..summary.into_inner().expect("no panic") }
    }

    /// The seed of a run. Below the seeds of laser machines, each fifth run takes one of those.
    fn seed(self, number: u64) -> u64 {
        let lasers = number / LASER_SHARE;
        match number % LASER_SHARE {
            _ if self.first >= LASER_SEEDS => self.first + number,
            rest if rest == LASER_SHARE - 1 => LASER_SEEDS + self.first + lasers,
            _ => self.first + number - lasers,
        }
    }
}

/// The plan of a seed.
pub(crate) fn plan(seed: u64, calm: bool) -> Plan {
    if calm { Plan::calm(seed) } else { Plan::draw(seed) }
}
