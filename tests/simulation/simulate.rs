//! Searches for faults: runs whole printers in virtual time, each with its own seed, and checks the invariants at every step.
//!
//! ```text
//! cargo run --release --example simulate -- --seeds 100000 --threads 2
//! cargo run --release --example simulate -- --seed 4711 --shrink
//! ```

mod disk;
mod host;
mod line;
mod machine;
mod operators;
mod parts;
mod plan;
mod port;
mod rng;
mod search;
mod truth;
mod world;

use std::process::ExitCode;

use clap::Parser;

use machine::Character;
use plan::Plan;
use search::{Search, plan};
use world::run;

/// Runs whole printers in virtual time and searches for what must not happen.
#[derive(Debug, Parser)]
struct Arguments {
    /// How many seeds to run. Each fifth has a laser machine, unless all have one.
    #[arg(long, default_value_t = 1000)]
    seeds: u64,
    /// The first seed. From 1000000000 on, all have a laser machine.
    #[arg(long, default_value_t = 1)]
    first: u64,
    /// Run this seed alone, and show what happens.
    #[arg(long, conflicts_with_all = ["seeds", "first"])]
    seed: Option<u64>,
    /// Leave out of a failing run what it can do without, and show the rest.
    #[arg(long, requires = "seed")]
    shrink: bool,
    /// Threads; each runs one seed at a time.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// End after so many failing seeds.
    #[arg(long, default_value_t = 20)]
    failures: usize,
    /// Let nothing go wrong, to see the speed of undisturbed prints of the largest part. Such a search fails: it proves nothing.
    #[arg(long)]
    calm: bool,
}

fn main() -> ExitCode {
    let Arguments { seeds, first, seed, shrink, threads, failures, calm } = Arguments::parse();
    let is_good = match seed {
        Some(seed) => one(seed, shrink, calm),
        None => {
            let summary = Search { first, seeds, threads, failures, calm }.run();
            println!("{summary}");
            summary.is_good()
        }
    };
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Runs one seed and prints what happens.
fn one(seed: u64, shrinks: bool, calm: bool) -> bool {
    let mut plan = plan(seed, calm);
    if shrinks {
        plan = shrink(plan);
    }
    println!("seed {seed}: {:?}, {:?}", plan.kind, plan.character);
    for event in &plan.events {
        let lit = event.lit_us.map_or_else(String::new, |lit_us| format!(", after {lit_us} µs of light"));
        println!("  planned at {:>10} µs{lit}: {:?}", event.at_us, event.what);
    }
    let report = run(&plan, true);
    report.trace.iter().for_each(|line| println!("{line}"));
    println!(
        "{} turns, {:.1} s in virtual time, jobs {:?}",
        report.turns,
        report.virtual_us as f64 / 1e6,
        report.ended
    );
    match &report.violation {
        Some(violation) => println!("violated: {}: {}", violation.invariant, violation.text),
        None => println!("every invariant held"),
    }
    report.violation.is_none()
}

/// Leaves out of a failing plan what is not needed for the same invariant to be violated.
fn shrink(mut plan: Plan) -> Plan {
    let Some(violation) = run(&plan, false).violation else { return plan };
    let fails = |plan: &Plan| run(plan, false).violation.is_some_and(|found| found.invariant == violation.invariant);
    let honest = Plan { character: Character::Honest, ..plan.clone() };
    if fails(&honest) {
        plan = honest;
    }
    let mut index = 0;
    while index < plan.events.len() {
        let mut smaller = plan.clone();
        smaller.events.remove(index);
        if fails(&smaller) {
            (plan, index) = (smaller, 0);
        } else {
            index += 1;
        }
    }
    plan
}
