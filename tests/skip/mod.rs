//! For what a machine does not let a test check.

use std::io::Write;

/// Says so, past the capture of a passing test's output: nothing is left out in silence.
pub(crate) fn skipped(what: &str) {
    let _ = writeln!(std::io::stderr(), "skipped: {what}");
}
