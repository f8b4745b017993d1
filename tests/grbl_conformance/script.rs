//! What every controller of a kind does, model or real.

use std::path::Path;
use std::time::{Duration, Instant};

use super::grbl_model::Firmware;
use super::grbl_model::host::Host;
use super::{SOON, fresh, x_mm};

/// The same for every controller of a kind.
pub(super) fn script(port: &Path, firmware: Firmware) {
    let is_hal = firmware == Firmware::GrblHal;
    let host = &mut Host::open(port);
    // The banner of the start.
    while host.line(SOON).is_some() {}
    fresh(host);
    let settings = ["$20=0", "$22=0", "$32=1", "$30=1000", "$110=6000", "$111=6000", "$120=500", "$121=500"];
    for setting in settings.iter().chain(if is_hal { &["$10=511"] } else { &["$10=1"] }) {
        assert_eq!(host.answer(setting), "ok", "{setting}");
    }
    let (blocks, bytes) = buffers(host);
    answers(host, is_hal);
    errors(host, is_hal);
    modes(host, is_hal);
    waits(host, blocks, is_hal);
    overflow(host, bytes);
    holds(host);
    reset_in_motion(host, is_hal);
}

/// Planner blocks and receive bytes that `$I` tells.
fn buffers(host: &mut Host) -> (usize, usize) {
    let lines = host.ask("$I");
    assert!(lines[0].starts_with("[VER:1.1"), "{lines:?}");
    let options = lines.iter().find_map(|line| line.strip_prefix("[OPT:")?.strip_suffix(']')).expect("options");
    let numbers: Vec<usize> = options.split(',').skip(1).map(|number| number.parse().expect("a number")).collect();
    (numbers[0], numbers[1])
}

fn answers(host: &mut Host, is_hal: bool) {
    fresh(host);
    host.send("G4P0\r\n");
    assert_eq!(host.until("ok"), ["ok"]);
    // Each of CR and LF ends a line on 1.1.
    assert_eq!(host.is_quiet(SOON), is_hal);
    assert_eq!(host.answer(""), "ok");
    host.send("?\n");
    let lines = host.until("ok");
    assert!(lines.len() == 2 && lines[0].starts_with("<Idle|MPos:"), "{lines:?}");
    assert_eq!(host.answer(&format!("G4 P0.{}", "0".repeat(71))), "ok");
    let longest = if is_hal { 255 } else { 79 };
    assert_eq!(host.answer(&format!("G4P0.{}", "0".repeat(longest + 10))), "error:11");
    assert_eq!(host.answer(""), "ok");
    assert_eq!(host.answer(&format!("G4P0{}(comment)", " ".repeat(100))), "ok");
    assert_eq!(host.answer("G4P0;(a comment) goes on to the end of the line"), "ok");
    let settings = host.ask("$$");
    assert!(settings.iter().any(|line| line == "$32=1"), "{settings:?}");
    let rate = if is_hal { "$30=1000.000" } else { "$30=1000" };
    assert!(settings.iter().any(|line| line == rate), "{settings:?}");
}

fn errors(host: &mut Host, is_hal: bool) {
    fresh(host);
    host.send("G1 X0 F600\nG1 X0 Q\nG1 X0\nM5\n$G\nG1 X0\n");
    let lines: Vec<String> = host.until("[GC").into_iter().chain(host.until("ok")).chain(host.until("ok")).collect();
    let after = if is_hal { "error:2" } else { "ok" };
    assert_eq!(lines[..4], ["ok", "error:2", after, after], "{lines:?}");
    let unknown_letter = if is_hal { "error:36" } else { "error:20" };
    for (line, error) in [
        ("A1", unknown_letter),
        ("M77", "error:20"),
        ("G1 X1 X2", "error:25"),
        ("X1.2.3", "error:1"),
        ("G0 G1 X1", "error:24"),
        ("1", "error:1"),
        ("G1 X1 F0", "error:22"),
        ("G1 X1 S-1", "error:4"),
        ("$110=-5", "error:4"),
        ("$999=1", if is_hal { "error:53" } else { "error:3" }),
        ("$20=1", "error:10"),
    ] {
        assert_eq!(host.answer(line), error, "{line}");
        assert_eq!(host.answer(""), "ok");
    }
    fresh(host);
    assert_eq!(host.answer("G1 X0 S10"), "error:22", "the feed is lost by a reset");
}

fn modes(host: &mut Host, is_hal: bool) {
    fresh(host);
    assert_eq!(host.answer("G20 G91 M4 S100 F10"), "ok");
    let state = host.ask("$G").remove(0);
    assert!(state.contains(" G20 ") && state.contains(" G91 ") && state.contains(" M4 "), "{state}");
    assert!(state.contains(" S100"), "{state}");
    fresh(host);
    let state = host.ask("$G").remove(0);
    assert!(state.starts_with("[GC:G0 G54 G17 G21 G90 G94 ") && state.contains(" M5 "), "{state}");
    assert!(state.contains(" F0 S0"), "{state}");
    assert_eq!(host.answer("G92 X5 Y6"), "ok");
    fresh(host);
    let kept = host.ask("$#").into_iter().find(|line| line.starts_with("[G92:")).expect("a line");
    assert_eq!(kept.starts_with("[G92:0.000,0.000,"), !is_hal, "{kept}");
    assert_eq!(host.answer("G92.1"), "ok");
}

/// `ok` comes for lines in the planner, and no sooner; other lines wait for the end of all motion.
fn waits(host: &mut Host, blocks: usize, is_hal: bool) {
    fresh(host);
    host.ask("G91 M4 S0");
    let began = Instant::now();
    host.send("G1 X4 F120\nM5\n");
    assert_eq!(host.until("ok"), ["ok"]);
    assert!(began.elapsed() < Duration::from_millis(1500), "a motion is answered when it is planned");
    assert_eq!(host.answer("$$"), "ok", "the second `ok` is that of `M5`");
    assert!(began.elapsed() > Duration::from_millis(1500), "`M5` waits for the motion");
    assert_eq!(host.until("ok").last().map(String::as_str), Some("ok"));

    host.send("G1 X-4 F60\n");
    assert_eq!(host.until("ok"), ["ok"]);
    assert_eq!(host.answer("$I"), "error:8");
    assert_eq!(host.answer(""), "ok");
    let mut oks = 1;
    for _ in 0..blocks + 3 {
        host.send("X0.02\n");
        oks += usize::from(host.line(SOON / 4).is_some());
    }
    assert_eq!(oks, blocks, "blocks that are answered while the first of them runs");
    // On 1.1 the line that waits for the planner is answered although it never runs: this `ok` counts for nothing.
    host.send([0x18]);
    let lines = host.until("Grbl");
    assert!(lines.iter().any(|line| line == "ALARM:3"), "{lines:?}");
    assert_eq!(lines.iter().any(|line| line == "ok"), !is_hal, "{lines:?}");
    assert_eq!(host.answer("$X"), "ok");
}

/// Bytes beyond the buffer are lost.
fn overflow(host: &mut Host, bytes: usize) {
    fresh(host);
    host.send("G4 P2\n");
    std::thread::sleep(SOON);
    let line = "(comment)\n";
    let lines = bytes / line.len() + 10;
    host.send(line.repeat(lines));
    host.until("ok");
    let mut oks = 0;
    while host.line(SOON).is_some() {
        oks += 1;
    }
    assert!(oks <= bytes / line.len() && oks >= (bytes - 1) / line.len() - 1, "{oks} of {lines} lines, {bytes} bytes");
    // A part of a line is left in the buffer.
    host.ask("");
}

fn holds(host: &mut Host) {
    fresh(host);
    host.ask("G91 M4 S0");
    host.ask("G1 X5 F600");
    host.send([0x85]);
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(Host::field(&host.status(), "").as_deref(), Some("Run"), "0x85 ends jogs only");
    host.send("!");
    let report = host.wait_for_state("Hold:0");
    host.send("$G\n");
    assert!(host.is_quiet(SOON), "lines wait while it holds");
    let later = host.status();
    assert_eq!(Host::field(&report, "MPos"), Host::field(&later, "MPos"));
    host.send("~");
    assert!(host.until("ok").iter().any(|line| line.starts_with("[GC:")));
    host.wait_for_state("Idle");
    host.ask("G1 X-5");
    host.wait_for_state("Idle");
}

fn reset_in_motion(host: &mut Host, is_hal: bool) {
    fresh(host);
    host.ask("M4 S0");
    let before = x_mm(&host.status());
    host.ask("G91 G1 X8 F1200 S500");
    std::thread::sleep(Duration::from_millis(150));
    host.send([0x18]);
    host.until("ALARM:3");
    let began = Instant::now();
    host.send("G0 X1\n");
    host.until("Grbl");
    let waited = began.elapsed();
    assert!(is_hal || waited > Duration::from_millis(350), "1.1 is deaf for 0.5 s: {waited:?}");
    assert_eq!(host.until("[MSG"), ["[MSG:'$H'|'$X' to unlock]"]);
    let report = host.status();
    assert_eq!(Host::field(&report, "").as_deref(), Some("Alarm"));
    let stopped = x_mm(&report);
    assert!(stopped > before + 0.2 && stopped < before + 7.9, "it stopped on its way: {stopped}");
    assert_eq!(host.answer("G0 X1"), "error:9");
    assert_eq!(host.ask("$X"), ["[MSG:Caution: Unlocked]", "ok"]);
    assert!((x_mm(&host.status()) - stopped).abs() < 0.01, "the position is kept");
    let back = before - stopped;
    host.ask(&format!("G91 G0 X{back:.3}"));
    host.wait_for_state("Idle");
}
