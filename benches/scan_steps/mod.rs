//! Tables of what each step of a layer takes. `benches/contours.rs` and `benches/scan_fill.rs` print them.

use std::time::Duration;

use layerd::slice::scan::ContourTimes;

/// The steps of contours, and the time that each took between two readings.
pub(crate) fn contour_steps(before: ContourTimes, after: ContourTimes) -> [(&'static str, Duration); 4] {
    [
        ("field", after.field - before.field),
        ("march", after.march - before.march),
        ("join", after.join - before.join),
        ("simplify", after.simplify - before.simplify),
    ]
}

/// Prints the time of a step in some layers, and how many of `count` items that is a second.
pub(crate) fn print_step(step: &str, time: Duration, layers: u32, count: u64) {
    let seconds = time.as_secs_f64();
    println!("{step} | {:.2} | {:.0}", seconds * 1e3 / f64::from(layers), count as f64 / seconds);
}
