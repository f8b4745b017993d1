//! Counts repeated lines of the log instead of writing them all.
//!
//! Each place in the program that logs has a window of ten seconds, which its first line begins. In a window the same line is
//! written [`MAX_REPEATS`] times, and at most [`MAX_LINES`] different lines. At its end the number of suppressed lines is
//! written. Debug lines are never suppressed: a user who sets `RUST_LOG=debug` wants all of them.
//! `tests/daemon_log.rs` shows it.

use std::collections::HashMap;
use std::fmt::{Debug, Write};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tracing::callsite::Identifier;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// Long enough that a line repeated for days makes only some thousand lines, short enough to show that it goes on.
const WINDOW: Duration = Duration::from_secs(10);
/// How often the same line is written in a window: more than once, so that an operator sees that it repeats.
const MAX_REPEATS: u64 = 3;
/// Different lines that one place writes in a window: no operator could read more. This also bounds the memory of the window.
const MAX_LINES: usize = 50;
/// Lines are compared and repeated up to this length, bytes.
const MAX_LINE_BYTES: usize = 300;
/// Target of the lines that report a count; they are never counted themselves.
const TARGET: &str = "layerd::repeats";

/// The present windows. As a tracing layer it suppresses lines. Clones share the windows.
#[derive(Clone, Debug, Default)]
pub(super) struct Limiter {
    windows: Arc<Mutex<HashMap<Identifier, Window>>>,
}

#[derive(Debug)]
struct Window {
    began: Instant,
    /// How often each line came.
    lines: HashMap<String, u64>,
    /// Lines beyond [`MAX_LINES`].
    more: u64,
}

impl Limiter {
    /// Counts the line; returns whether it is to be written.
    fn admit(&self, place: Identifier, line: String, now: Instant) -> bool {
        let mut windows = self.windows.lock().unwrap_or_else(PoisonError::into_inner);
        let new = || Window { began: now, lines: HashMap::new(), more: 0 };
        let window = windows.entry(place).or_insert_with(new);
        // A window with a count goes on until the writing thread has reported it.
        if now.duration_since(window.began) >= WINDOW && window.counted().is_empty() {
            *window = new();
        }
        if let Some(count) = window.lines.get_mut(&line) {
            *count += 1;
            return *count <= MAX_REPEATS;
        }
        if window.lines.len() >= MAX_LINES {
            window.more += 1;
            return false;
        }
        window.lines.insert(line, 1);
        true
    }

    /// Writes the counts of the windows that have ended.
    pub(super) fn tell_due(&self, now: Instant) {
        self.tell(|window| now.duration_since(window.began) >= WINDOW);
    }

    /// Writes all counts.
    pub(super) fn tell_all(&self) {
        self.tell(|_| true);
    }

    fn tell(&self, is_over: impl Fn(&Window) -> bool) {
        let mut counted = Vec::new();
        let mut windows = self.windows.lock().unwrap_or_else(PoisonError::into_inner);
        windows.retain(|_, window| {
            let over = is_over(window);
            if over {
                counted.extend(window.counted());
            }
            !over
        });
        // Writing a line locks the windows again.
        drop(windows);
        for line in counted {
            tracing::warn!(target: TARGET, "{line}");
        }
    }
}

impl Window {
    /// Reports of the suppressed lines.
    fn counted(&self) -> Vec<String> {
        let window_s = WINDOW.as_secs();
        let repeats = self.lines.iter().filter(|(_, count)| **count > MAX_REPEATS);
        let repeats = repeats
            .map(|(line, count)| format!("repeated {} more times within {window_s} s: {line}", count - MAX_REPEATS));
        let example = self.lines.keys().next().filter(|_| self.more > 0);
        let more = example.map(|line| format!("{} more lines of this kind within {window_s} s: {line}", self.more));
        repeats.chain(more).collect()
    }
}

impl<S: Subscriber> Layer<S> for Limiter {
    fn event_enabled(&self, event: &Event<'_>, _context: Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if *metadata.level() > Level::INFO || metadata.target() == TARGET {
            return true;
        }
        let mut line = Line(String::new());
        event.record(&mut line);
        self.admit(metadata.callsite(), line.0, Instant::now())
    }
}

/// A line's message and fields, as far as they are compared.
struct Line(String);

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        let separator = if self.0.is_empty() { "" } else { " " };
        let _ = match field.name() {
            "message" => write!(self.0, "{separator}{value:?}"),
            name => write!(self.0, "{separator}{name}={value:?}"),
        };
        while self.0.len() > MAX_LINE_BYTES {
            self.0.pop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two places of the program, as the macros of the log make them.
    fn places() -> [Identifier; 2] {
        use tracing::Callsite;
        use tracing::metadata::Kind;
        let first = tracing::callsite!(name: "first", kind: Kind::EVENT, fields: message);
        let second = tracing::callsite!(name: "second", kind: Kind::EVENT, fields: message);
        [first.metadata().callsite(), second.metadata().callsite()]
    }

    #[test]
    fn a_repeated_line_is_written_three_times_and_then_counted() {
        let (limiter, [place, other], now) = (Limiter::default(), places(), Instant::now());
        let written = (0..300_000).filter(|_| limiter.admit(place.clone(), "bad frame".into(), now)).count();
        assert_eq!(written, 3);
        assert!(limiter.admit(place.clone(), "another line".into(), now));
        assert!(limiter.admit(other, "bad frame".into(), now), "another place has its own count");
        let counted = limiter.windows.lock().unwrap()[&place].counted();
        assert_eq!(counted, ["repeated 299997 more times within 10 s: bad frame"]);
        limiter.tell_due(now + Duration::from_secs(9));
        assert!(!limiter.admit(place.clone(), "bad frame".into(), now + Duration::from_secs(9)));
        limiter.tell_due(now + WINDOW);
        assert!(limiter.admit(place, "bad frame".into(), now + WINDOW), "a new window");
    }

    #[test]
    fn lines_that_differ_are_bounded_as_well() {
        let (limiter, [place, _], now) = (Limiter::default(), places(), Instant::now());
        let written = (0..100_000).filter(|n| limiter.admit(place.clone(), format!("odd reply {n}"), now)).count();
        assert_eq!(written, MAX_LINES);
        let windows = limiter.windows.lock().unwrap();
        assert_eq!(windows[&place].lines.len(), MAX_LINES, "no more is remembered");
        let counted = windows[&place].counted();
        assert!(counted.len() == 1 && counted[0].starts_with("99950 more lines of this kind"), "{counted:?}");
    }
}
