//! Shows that the simulation finds bugs: plants one after the other in a copy of the sources, and searches with each until the first
//! failure.
//!
//! ```text
//! cargo run --release --example planted
//! cargo run --release --example planted -- --only "recipe is not flushed"
//! ```
//!
//! The copy and what is built of it stay in `target/planted`, so that a later run builds only what changed.

#[path = "planted/bugs.rs"]
mod bugs;

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use clap::Parser;

use bugs::{BUGS, Bug};

/// What a build of the simulation needs. Cargo wants the benches that the manifest names.
const NEEDED: [&str; 7] = ["Cargo.toml", "Cargo.lock", "src", "wire", "config", "benches", "tests/simulation"];
/// Longest search with one bug. A planted bug may keep a run from ending.
const MAX_SEARCH: Duration = Duration::from_secs(1200);
/// Where the seeds of laser machines begin (`plan.rs`).
const LASER_SEEDS: u64 = 1_000_000_000;
/// Width of the column of names.
const NAME_WIDTH: usize = 58;

/// Plants bugs and shows whether the simulation finds them.
#[derive(Debug, Parser)]
struct Arguments {
    /// Plant only this bug, or those whose names contain this text.
    #[arg(long)]
    only: Option<String>,
    /// Search with at most this many seeds, of which each fifth has a laser machine.
    #[arg(long, default_value_t = 2000)]
    seeds: u64,
}

/// What came of a search.
enum Found {
    /// This invariant is violated, and by which seed.
    Violation { invariant: String, seed: u64 },
    /// The search broke down.
    BrokeDown(String),
    /// Every invariant held.
    Nothing,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match plant_all(&arguments) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("planted: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Plants every bug that was asked for. Returns whether each was found, and nothing in the sources as they are.
fn plant_all(arguments: &Arguments) -> Result<bool, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let place = target.join("planted");
    let copy = place.join("sources");
    for needed in NEEDED {
        mirror(&root.join(needed), &copy.join(needed)).map_err(|error| format!("cannot copy {needed}: {error}"))?;
    }
    let bugs: Vec<_> =
        BUGS.iter().filter(|bug| arguments.only.as_ref().is_none_or(|only| bug.name.contains(only))).collect();
    if bugs.is_empty() {
        return Err("no bug has such a name: see tests/simulation/planted/bugs.rs".into());
    }
    println!("| {:NAME_WIDTH$} | {:24} | seeds |", "bug", "violated invariant");
    println!("|{:-<1$}|{2:-<26}|------:|", "", NAME_WIDTH + 2, "");
    let mut is_good = true;
    // Without a bug nothing may be found: otherwise a find says nothing about the bug.
    if arguments.only.is_none() {
        let found = build(&place).and_then(|()| search(&place, arguments.seeds))?;
        is_good &= matches!(found, Found::Nothing);
        show("(none)", &found, arguments.seeds);
    }
    for bug in bugs {
        let found = plant(bug, &copy, &place, arguments.seeds)?;
        is_good &= matches!(found, Found::Violation { .. });
        show(bug.name, &found, arguments.seeds);
    }
    Ok(is_good)
}

/// Makes `to` the same as `from`, a file or a directory. Files that are the same already keep their times.
fn mirror(from: &Path, to: &Path) -> io::Result<()> {
    if !from.is_dir() {
        let bytes = std::fs::read(from)?;
        if std::fs::read(to).is_ok_and(|there| there == bytes) {
            return Ok(());
        }
        return std::fs::create_dir_all(to.parent().unwrap_or(to)).and_then(|()| std::fs::write(to, bytes));
    }
    std::fs::create_dir_all(to)?;
    let names = |directory: &Path| -> io::Result<Vec<OsString>> {
        std::fs::read_dir(directory)?.map(|entry| Ok(entry?.file_name())).collect()
    };
    let here = names(from)?;
    for gone in names(to)?.iter().filter(|name| !here.contains(name)).map(|name| to.join(name)) {
        if gone.is_dir() { std::fs::remove_dir_all(gone) } else { std::fs::remove_file(gone) }?;
    }
    // Tests of their own may have left a target directory.
    here.iter().filter(|name| *name != "target").try_for_each(|name| mirror(&from.join(name), &to.join(name)))
}

/// Plants a bug, searches with it, and takes it out again.
fn plant(bug: &Bug, copy: &Path, place: &Path, seeds: u64) -> Result<Found, String> {
    let path = copy.join(bug.file);
    let io = |error: io::Error| format!("{}: {error}", path.display());
    let right = std::fs::read_to_string(&path).map_err(io)?;
    if right.matches(bug.was).count() != 1 {
        return Err(format!("{:?}: {} does not have this code once: {}", bug.name, bug.file, bug.was));
    }
    std::fs::write(&path, right.replacen(bug.was, bug.becomes, 1)).map_err(io)?;
    let found = build(place).and_then(|()| search(place, seeds));
    std::fs::write(&path, right).map_err(io)?;
    Ok(found.unwrap_or_else(Found::BrokeDown))
}

fn build(place: &Path) -> Result<(), String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let built = Command::new(cargo)
        .args(["build", "--quiet", "--locked", "--example", "simulate"])
        .current_dir(place.join("sources"))
        .env("CARGO_TARGET_DIR", place.join("target"))
        .env("CARGO_PROFILE_DEV_DEBUG", "0")
        .output()
        .map_err(|error| format!("cannot run cargo: {error}"))?;
    if built.status.success() {
        return Ok(());
    }
    Err(format!("does not compile:\n{}", String::from_utf8_lossy(&built.stderr)))
}

/// Runs one seed after the other until an invariant is violated.
fn search(place: &Path, seeds: u64) -> Result<Found, String> {
    let io = |error: io::Error| format!("cannot run the simulation: {error}");
    let mut child = Command::new(place.join("target/debug/examples/simulate"))
        .args(["--seeds", &seeds.to_string(), "--failures", "1"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(io)?;
    let until = Instant::now() + MAX_SEARCH;
    // Its output, which comes at its end, fits the pipe.
    while child.try_wait().map_err(io)?.is_none() {
        if Instant::now() > until {
            child.kill().map_err(io)?;
            child.wait().map_err(io)?;
            return Ok(Found::BrokeDown(format!("not over after {} s", MAX_SEARCH.as_secs())));
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let output = child.wait_with_output().map_err(io)?;
    let text = String::from_utf8_lossy(&output.stdout);
    if let Some((seed, invariant)) = text.lines().find_map(violation) {
        return Ok(Found::Violation { invariant: invariant.to_owned(), seed });
    }
    Ok(if output.status.success() { Found::Nothing } else { Found::BrokeDown(output.status.to_string()) })
}

/// Number of the seed, within those of its kind of machine, and invariant of a line of the simulation's summary.
fn violation(line: &str) -> Option<(u64, &str)> {
    let (seed, rest) = line.strip_prefix("seed ")?.split_once(" violates \"")?;
    let seed: u64 = seed.parse().ok()?;
    // The seeds of laser machines are counted from their first.
    Some((seed % LASER_SEEDS, rest.split_once('"')?.0))
}

fn show(name: &str, found: &Found, seeds: u64) {
    let (text, seed) = match found {
        Found::Violation { invariant, seed } => (invariant.clone(), *seed),
        Found::BrokeDown(how) => (format!("BROKE DOWN: {how}"), seeds),
        Found::Nothing => ("nothing found".into(), seeds),
    };
    println!("| {name:NAME_WIDTH$} | {text:24} | {seed:5} |");
}
