//! What the model keeps of marks, jumps and light, and what its faults do.

use std::time::Duration;

use super::grbl_model::host::Host;
use super::grbl_model::{Fault, Firmware, Options};
use super::{BOTH, SOON, bench, fresh, ready, x_mm};

/// Marks and jumps are what was sent, at exact times of the machine's clock.
#[test]
fn marks_jumps_and_light_are_kept() {
    for firmware in BOTH {
        let (_directory, model, mut host) = ready(Options { speed_up: 10.0, ..Options::new(firmware) });
        host.send("G21 G90 M4 S0\nG0 X10 Y0\nG1 X20 F6000 S500\nY10 S2000\nG0 X0\nM5\n");
        for _ in 0..6 {
            assert_eq!(host.until("ok"), ["ok"]);
        }
        let facts = model.facts();
        assert_eq!((facts.marks.len(), facts.jumps.len()), (2, 2), "{facts:?}");
        assert_eq!(facts.marks[0].from_mm, [10.0, 0.0, 0.0, 0.0]);
        assert_eq!(facts.marks[0].to_mm, [20.0, 0.0, 0.0, 0.0]);
        assert_eq!((facts.marks[0].s, facts.marks[1].s), (500.0, 2000.0));
        assert!(facts.marks.iter().all(|mark| mark.whole && mark.feed_mm_per_min == 6000.0));
        assert!((facts.marked_mm() - 20.0).abs() < 1e-9);
        // 20 mm straight on, from rest to a corner, at 500 mm/s²: a peak of 100 mm/s in the middle.
        let took_us = facts.marks[0].ended_us - facts.jumps[0].began_us;
        assert!((390_000..402_000).contains(&took_us), "{took_us}");
        assert_eq!(facts.marks[1].began_us, facts.marks[0].ended_us, "nothing between two marks");
        assert_eq!((facts.at_rest_lit_us, facts.is_lit), (0, false), "M4 is dark at rest");
        assert_eq!(facts.lit_us, facts.marks[1].ended_us - facts.marks[0].began_us);
    }
}

#[test]
fn constant_power_burns_at_rest_and_so_does_a_machine_without_laser_mode() {
    for (options, line) in
        [(Options::new(Firmware::Grbl11), "G1 M3 S300"), (Options::new(Firmware::Grbl11).setting(32, 0.0), "M4 S300")]
    {
        let (_directory, model, mut host) = ready(options);
        assert_eq!(host.answer(line), "ok");
        let facts = model.wait(Duration::from_secs(5), |facts| facts.at_rest_lit_ms() > 20.0);
        assert!(facts.is_lit && facts.at_rest_lit_ms() > 20.0 && facts.marks.is_empty(), "{facts:?}");
        assert_eq!(host.answer("M5"), "ok");
        assert!(!model.facts().is_lit);
    }
}

#[test]
fn a_reset_cuts_the_mark_off_and_is_dark_at_once() {
    for firmware in BOTH {
        let (_directory, model, mut host) = ready(Options::new(firmware));
        host.ask("M4 S0");
        host.ask("G1 X20 F600 S500");
        model.wait(Duration::from_secs(5), |facts| facts.is_lit);
        host.send([0x18]);
        host.until("ALARM:3");
        let facts = model.facts();
        assert!(!facts.is_lit && !facts.marks[0].whole, "{facts:?}");
        assert_eq!(facts.marks[0].ended_us, facts.resets_us[0]);
        assert_eq!(facts.marks[0].to_mm, facts.position_mm);
        assert!(facts.position_mm[0] < 20.0);
    }
}

#[test]
fn faults_do_what_their_names_say() {
    let with = |fault| Options::new(Firmware::Grbl11).fault(fault);
    let lines = ["M4 S0", "G1 X1 F6000 S1", "X2", "X3"];

    let (_directory, _model, mut host) = ready(with(Fault::Refuse { after_moves: 2, error: 33 }));
    assert_eq!(lines.map(|line| host.answer(line)), ["ok", "ok", "ok", "error:33"]);

    let (_directory, model, mut host) = ready(with(Fault::LoseOk { after_moves: 1 }));
    lines.iter().for_each(|line| host.send(format!("{line}\n")));
    assert_eq!([(); 3].map(|()| host.until("ok").len()), [1; 3]);
    assert!(host.is_quiet(SOON), "one answer is missing");
    assert_eq!(model.facts().marks.len(), 3);

    let (_directory, model, mut host) = ready(with(Fault::Reset { after_moves: 1 }));
    lines.iter().for_each(|line| host.send(format!("{line}\n")));
    host.until("Grbl");
    assert!(model.facts().marks.len() <= 1);

    let (_directory, model, mut host) = ready(with(Fault::PowerLoss { after_moves: 3 }));
    lines.iter().for_each(|line| drop(host.ask(line)));
    host.wait_for_state("Idle");
    host.send("X4\n");
    host.until("Grbl");
    assert_eq!(x_mm(&host.status()), 0.0, "it believes to be at zero");
    assert_eq!(model.facts().position_mm[0], 3.0, "and is not");

    let (_directory, _model, mut host) = ready(with(Fault::Stall { after_moves: 2 }));
    lines[..3].iter().for_each(|line| drop(host.ask(line)));
    host.send("X3\n");
    assert!(host.is_quiet(SOON));
    host.wait_for_state("Idle");
    fresh(&mut host);

    let (_directory, _model, mut host) = ready(with(Fault::Silence { after_moves: 1 }));
    lines[..2].iter().for_each(|line| drop(host.ask(line)));
    host.send("X3\n?\x18");
    assert!(host.is_quiet(SOON));

    let (_directory, _model, mut host) = ready(with(Fault::Garbage { after_moves: 1 }));
    lines[..2].iter().for_each(|line| drop(host.ask(line)));
    host.send("X3\n");
    let noise = host.line(SOON).expect("something");
    assert!(noise != "ok" && !noise.starts_with("error"), "{noise}");

    // The 5th byte is the 1 of X1: the machine goes to X0 and says `ok`.
    let (_directory, model, mut host) = ready(with(Fault::FlipByte { nth: 5, mask: 1 }));
    host.ask("G0 X1");
    host.wait_for_state("Idle");
    assert_eq!(model.facts().position_mm[0], 0.0);
    model.inject(Fault::LoseByte { nth: 5 });
    assert_eq!(host.answer("G0 X1"), "error:2");

    let (_directory, model, mut host) = ready(with(Fault::Disconnect { after_moves: 1, back_after_ms: Some(50) }));
    lines[..2].iter().for_each(|line| host.send(format!("{line}\n")));
    let facts = model.wait(Duration::from_secs(5), |facts| facts.marks.first().is_some_and(|mark| mark.whole));
    assert_eq!(facts.marks.len(), 1, "motion goes on");
    std::thread::sleep(SOON);
    let mut again = Host::open(model.port());
    assert_eq!(x_mm(&again.status()), 1.0);
}

#[test]
fn homing_that_is_required_starts_in_alarm() {
    for firmware in BOTH {
        let (_directory, model, mut host) =
            bench(Options { speed_up: 10.0, ..Options::new(firmware).homing_required() });
        host.until("[MSG");
        assert_eq!(Host::field(&host.status(), "").as_deref(), Some("Alarm"));
        assert_eq!(host.answer("G0 X1"), "error:9");
        let unlocked = if firmware == Firmware::Grbl11 { "ok" } else { "error:46" };
        assert_eq!(host.answer("$X"), unlocked);
        assert_eq!(host.answer("$H"), "ok");
        assert_eq!(x_mm(&host.status()), -1.0);
        assert_eq!(model.facts().position_mm[..3], [-1.0; 3]);
    }
}

#[test]
fn a_fourth_axis_and_rare_reports() {
    let options = Options { axes: 4, status_every_ms: 300, ..Options::new(Firmware::GrblHal) };
    let (_directory, model, mut host) = ready(options);
    assert_eq!(host.answer("G0 A0.5"), "ok");
    model.wait(Duration::from_secs(5), |facts| facts.jumps.first().is_some_and(|jump| jump.whole));
    assert_eq!(Host::field(&host.status(), "MPos").as_deref(), Some("0.000,0.000,0.000,0.500"));
    host.send("?");
    assert!(host.is_quiet(Duration::from_millis(100)));
}

#[test]
fn work_positions_need_the_offset_of_an_earlier_report() {
    let options = Options { work_offset_mm: [2.0, 0.0, 0.0, 0.0], ..Options::new(Firmware::Grbl11).setting(10, 0.0) };
    let (_directory, _model, mut host) = ready(options);
    let report = host.status();
    assert_eq!(Host::field(&report, "WPos").as_deref(), Some("-2.000,0.000,0.000"));
    assert_eq!(Host::field(&report, "WCO").as_deref(), Some("2.000,0.000,0.000"));
    assert_eq!(Host::field(&report, "MPos"), None);
    std::thread::sleep(Duration::from_millis(20));
    assert_eq!(Host::field(&host.status(), "WCO"), None);
}
