//! A search: many seeds, what happened in them, and what was violated.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::machine::all;
use crate::plan::{Plan, fault_names};
use crate::truth::{INVARIANTS, Violation};
use crate::world::{EFFECTS, Report, run};

/// A search of so many seeds must have met every kind of fault.
const COMPLETE_SEEDS: u64 = 2_000;

/// What a search found.
#[derive(Debug, Default)]
pub(crate) struct Summary {
    pub(crate) seeds: u64,
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
        let lies = all().iter().map(|(name, _)| *name).filter(|name| *name != "honest");
        let kinds: Vec<_> = fault_names().into_iter().chain(lies).chain(EFFECTS.iter().copied()).collect();
        let met = kinds.iter().filter(|name| self.count(name) > 0).count();
        match (met, self.seeds) {
            (0, _) => kinds,
            (_, COMPLETE_SEEDS..) => {
                let checked = |name: &&str| self.checks.get(*name).is_some_and(|count| *count > 0);
                let unchecked = INVARIANTS.iter().copied().filter(|name| !checked(name));
                kinds.into_iter().filter(|name| self.count(name) == 0).chain(unchecked).collect()
            }
            _ => Vec::new(),
        }
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
                        let seed = self.first + number;
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
}

/// The plan of a seed.
pub(crate) fn plan(seed: u64, calm: bool) -> Plan {
    if calm { Plan::calm(seed) } else { Plan::draw(seed) }
}
