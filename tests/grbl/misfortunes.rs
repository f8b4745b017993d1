//! What goes wrong with a controller and its line: the laser goes dark, the operator reads why, and the print goes on where that is
//! safe.

use std::time::Duration;

use crate::bench::GrblBench;
use crate::grbl_model::{Fault, Firmware, Options};
use crate::support::wait_until;

const FIRMWARES: [Firmware; 2] = [Firmware::Grbl11, Firmware::GrblHal];

#[test]
fn a_cable_that_is_pulled_leaves_no_vector_out_and_marks_none_twice() {
    for firmware in FIRMWARES {
        let bench = GrblBench::start(Options::new(firmware));
        let id = bench.print();
        let mut doubts = 0;
        for marks in [40, 150, 400] {
            wait_until("the marks", || {
                doubts += resume_if_interrupted(&bench, id);
                bench.model.facts().marks.len() >= marks
            });
            bench.model.unplug(Some(300));
        }
        doubts += finish(&bench, id);
        assert_marked(&bench, doubts);
    }
}

/// A ring that went to the controller whole, and of which nothing was answered, ends where it begins, and short vectors cannot be told
/// apart: then only the operator can tell what was marked, and has it repeated.
fn assert_marked(bench: &GrblBench, doubts: usize) {
    match doubts {
        0 => bench.assert_marked_once(),
        _ => bench.assert_marked_at_least_once(),
    }
}

/// Resumes a print that was interrupted. Where its position does not tell how far a layer is, the operator says that the vector is to be
/// repeated. Returns how many such doubts there were.
fn resume_if_interrupted(bench: &GrblBench, id: u64) -> usize {
    let job = bench.bench.job(id);
    if job["state"] != "interrupted" {
        return 0;
    }
    let is_doubt = !job["in_doubt"].is_null();
    let doubt: &[&str] = if is_doubt { &["--in-doubt", "repeat"] } else { &[] };
    let id = id.to_string();
    bench.bench.ok(&[&["resume", &id], doubt].concat());
    usize::from(is_doubt)
}

/// Completes a print. Returns how many doubts there were.
fn finish(bench: &GrblBench, id: u64) -> usize {
    let mut doubts = 0;
    while bench.bench.wait_for(id, &["completed", "failed", "interrupted", "aborted"])["state"] == "interrupted" {
        doubts += resume_if_interrupted(bench, id);
    }
    bench.completed(id);
    doubts
}

#[test]
fn a_reset_at_the_machine_is_asked_about_and_goes_on_where_the_beam_stopped() {
    for firmware in FIRMWARES {
        let bench = GrblBench::start(Options::new(firmware));
        let id = bench.print();
        bench.wait_marks(60);
        bench.model.inject(Fault::Reset { after_moves: 5 });
        let reason = bench.interrupted(id);
        assert!(reason.contains("ALARM:3"), "{reason}");
        // Without a doubt if the beam stopped in a jump.
        let doubts = finish(&bench, id);
        assert!(doubts <= 1);
        assert_marked(&bench, doubts);
    }
}

#[test]
fn lost_power_without_homing_is_refused_in_words() {
    let bench = GrblBench::start(Options::new(Firmware::Grbl11));
    let id = bench.print();
    bench.wait_marks(60);
    bench.model.power_cycle();
    bench.interrupted(id);
    let marks = bench.model.facts().marks.len();
    let id_text = id.to_string();
    let resumed = bench.bench.layerctl(&["resume", &id_text, "--in-doubt", "repeat"]);
    // Right after the end of the job, the daemon may not have asked for the position yet. Then the job finds out.
    let words = match resumed.status.success() {
        true => bench.interrupted(id),
        false => String::from_utf8_lossy(&resumed.stderr).into_owned(),
    };
    assert!(words.contains("know where its plate is") || words.contains("knows where its plate is"), "{words}");
    assert_eq!(bench.model.facts().marks.len(), marks, "nothing is marked in an unknown place");
}

/// The same while the daemon is down: a controller without switches believes that it stands at its zero.
#[test]
fn power_that_was_lost_together_with_the_hosts_is_noticed() {
    let mut bench = GrblBench::start(Options::new(Firmware::Grbl11));
    let id = bench.print();
    bench.wait_marks(60);
    bench.bench.kill_daemon();
    bench.model.power_cycle();
    let marks = bench.model.facts().marks.len();
    bench.bench.start_daemon();
    bench.bench.ok(&["resume", &id.to_string(), "--in-doubt", "repeat"]);
    let reason = bench.interrupted(id);
    assert!(reason.contains("lost its position"), "{reason}");
    assert_eq!(bench.model.facts().marks.len(), marks, "nothing is marked in an unknown place");
}

/// Each of these ends the print with the laser dark. When it is over, the print goes on.
#[test]
fn trouble_ends_the_print_dark_and_in_words_and_the_print_goes_on_afterwards() {
    let cases = [
        (Fault::Refuse { after_moves: 5, error: 20 }, "error:20"),
        (Fault::Garbage { after_moves: 5 }, "garbage"),
        (Fault::Stall { after_moves: 5 }, "has taken no line"),
        (Fault::LoseOk { after_moves: 5 }, "has taken no line"),
    ];
    std::thread::scope(|scope| {
        for (place, (fault, words)) in cases.into_iter().enumerate() {
            scope.spawn(move || trouble(FIRMWARES[place % 2], &fault, words));
        }
    });
}

fn trouble(firmware: Firmware, fault: &Fault, words: &str) {
    let bench = GrblBench::start(Options::new(firmware));
    let id = bench.print();
    bench.wait_marks(60);
    bench.model.inject(fault.clone());
    let reason = bench.interrupted(id);
    assert!(reason.contains(words), "{fault:?}: {reason}");
    let facts = bench.model.facts();
    assert!(!facts.is_lit && !facts.is_moving, "{fault:?}");
    bench.model.heal();
    let doubts = finish(&bench, id);
    assert_marked(&bench, doubts);
}

#[test]
fn a_controller_that_falls_silent_ends_its_marks_and_the_print_waits_for_it() {
    let bench = GrblBench::start(Options::new(Firmware::Grbl11));
    let id = bench.print();
    bench.wait_marks(60);
    bench.model.inject(Fault::Silence { after_moves: 5 });
    std::thread::sleep(Duration::from_secs(4));
    let facts = bench.model.facts();
    assert!(!facts.is_lit && !facts.is_moving);
    bench.model.heal();
    let doubts = finish(&bench, id);
    assert_marked(&bench, doubts);
}

/// A lost line end makes one line of two. The answers no longer fit the lines, or the line is refused.
#[test]
fn a_lost_byte_that_the_answers_or_positions_show_ends_the_print() {
    let bench = GrblBench::start(Options::new(Firmware::Grbl11));
    let id = bench.print();
    let facts = bench.wait_marks(60);
    // Some bytes, one after the other, until the print notices.
    for _ in 0..40 {
        bench.model.inject(Fault::LoseByte { nth: 7 });
        std::thread::sleep(Duration::from_millis(100));
        if bench.bench.job(id)["state"] == "interrupted" {
            break;
        }
    }
    let reason = bench.interrupted(id);
    assert!(reason.contains("cable") || reason.contains("error:"), "{reason}");
    assert!(bench.model.facts().marks.len() > facts.marks.len());
    assert!(!bench.model.facts().is_lit);
}
