//! Whole prints on machines with grbl controllers: the daemon, the operator's command, and a model of the controller on a
//! pseudo-terminal, for both firmwares.

mod bench;
#[path = "../grbl_model/mod.rs"]
mod grbl_model;
mod lockstep;
mod misfortunes;
#[path = "../support/mod.rs"]
mod support;

use std::time::Duration;

use bench::GrblBench;
use grbl_model::{Firmware, Options};
use support::wait_until;

#[test]
fn grbl_1_1_marks_every_vector_once() {
    prints(Options::new(Firmware::Grbl11));
}

#[test]
fn grblhal_marks_every_vector_once() {
    prints(Options::new(Firmware::GrblHal));
}

#[test]
fn a_controller_that_must_be_homed_is_homed_and_its_offsets_count() {
    for firmware in [Firmware::Grbl11, Firmware::GrblHal] {
        prints(Options::new(firmware).homing_required());
    }
}

/// A position may be reported with or without offsets.
#[test]
fn positions_of_the_work_are_understood_too() {
    prints(Options::new(Firmware::Grbl11).setting(10, 0.0));
}

fn prints(options: Options) {
    let bench = GrblBench::start(options);
    let id = bench.print();
    bench.completed(id);
    bench.assert_marked_once();
    let log = std::fs::read_to_string(bench.bench.path("daemon.log")).expect("a log");
    assert!(log.contains("has no checksum"), "the operator is told what cannot be noticed: {log}");
    let facts = bench.model.facts();
    assert_eq!(facts.errors(), Vec::<&grbl_model::facts::Line>::new());
    // M3 would burn at rest, and a power without a motion would stop it.
    let is_laser_line =
        |text: &str| text.contains('S') && !text.starts_with("G1") && !text.starts_with("M5") && text != "M4S0";
    assert!(facts.lines.iter().all(|line| !line.text.contains("M3") && !is_laser_line(&line.text)));
}

#[test]
fn an_abort_resets_the_controller_and_the_next_print_begins() {
    let bench = GrblBench::start(Options::new(Firmware::Grbl11));
    let id = bench.print();
    bench.wait_marks(30);
    let resets = bench.model.facts().resets_us.len();
    bench.bench.ok(&["abort", &id.to_string()]);
    let job = bench.bench.wait_for(id, &["aborted", "failed"]);
    assert_eq!(job["state"], "aborted", "{job}");
    let facts = bench.model.facts();
    assert!(facts.resets_us.len() > resets && !facts.is_lit && !facts.is_moving);
    let marks = facts.marks.len();
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(bench.model.facts().marks.len(), marks, "nothing is marked after an abort");
    bench.bench.ok(&["resume", &bench.print().to_string()]);
    bench.wait_marks(marks + 30);
}

#[test]
fn a_controller_that_does_not_fit_is_told_with_setting_and_remedy() {
    for (setting, value, words) in
        [(32, 0.0, "$32=1"), (120, 10.0, "axes.acceleration_mm_s2 = 10"), (130, 20.0, "$130=20"), (13, 1.0, "$13=0")]
    {
        let bench = GrblBench::start(Options::new(Firmware::Grbl11).setting(setting, value));
        let status = || bench.bench.ok(&["status"]);
        wait_until("the reason", || status().contains(words));
    }
}
