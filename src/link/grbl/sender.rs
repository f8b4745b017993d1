//! What goes to a grbl controller: lines, never more than it has room for, and real-time characters, which take no room. `tests/grbl/main.rs`
//! prints with it.

use std::collections::VecDeque;

/// Most bytes given to the line at once: an order to go dark waits behind them.
const MAX_PIECE_BYTES: usize = 256;
/// Lines that wait for room in the controller: enough for the next piece. No other act has so many.
const MAX_WAITING: usize = 16;
/// Asks for the status.
const STATUS: u8 = b'?';
/// Resets the controller: the laser is dark within 5 ms.
const RESET: u8 = 0x18;
/// A reset that is not answered is sent again after this time, microseconds. grbl 1.1 says nothing for half a second if it moved, and
/// would carry out a second reset after that.
pub(super) const PRESS_AGAIN_US: u64 = 1_000_000;
/// A status that does not come within this time is asked for again, microseconds. More questions would be merged into one.
const STATUS_LOST_US: u64 = 1_000_000;

/// What a line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A move of the beam, which is part of the path.
    Beam,
    /// Anything else.
    Other,
}

/// Lines and characters on their way.
#[derive(Debug, Default)]
pub(super) struct Sender {
    /// Most bytes that may be unanswered.
    usable_bytes: usize,
    waiting: VecDeque<(String, Kind)>,
    /// Sent and not answered: the bytes of each line with its end.
    unanswered: VecDeque<(usize, Kind)>,
    unanswered_bytes: usize,
    resets: bool,
    asks: bool,
    asked_us: Option<u64>,
}

impl Sender {
    /// Sets how many bytes may be unanswered.
    pub(super) fn set_room(&mut self, usable_bytes: usize) {
        self.usable_bytes = usable_bytes;
    }

    /// Adds a line.
    pub(super) fn push(&mut self, line: impl Into<String>, kind: Kind) {
        self.waiting.push_back((line.into(), kind));
    }

    /// Whether another line may be added.
    pub(super) fn has_room(&self) -> bool {
        self.waiting.len() < MAX_WAITING
    }

    /// Whether every line is sent and answered.
    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty() && self.unanswered.is_empty()
    }

    /// Whether lines wait for room.
    pub(super) fn has_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Drops the lines that are not sent. Returns how many of them were moves of the beam.
    pub(super) fn drop_waiting(&mut self) -> usize {
        std::mem::take(&mut self.waiting).iter().filter(|(_, kind)| *kind == Kind::Beam).count()
    }

    /// Resets the controller, ahead of everything.
    pub(super) fn reset(&mut self) {
        self.resets = true;
    }

    /// Asks for the status.
    pub(super) fn ask(&mut self, now_us: u64) {
        self.asks |= self.asked_us.is_none_or(|asked_us| now_us >= asked_us + STATUS_LOST_US);
    }

    /// The status has come.
    pub(super) fn heard_status(&mut self) {
        self.asked_us = None;
    }

    /// The oldest line is answered; `None` if none was sent.
    pub(super) fn answered(&mut self) -> Option<Kind> {
        let (bytes, kind) = self.unanswered.pop_front()?;
        self.unanswered_bytes -= bytes;
        Some(kind)
    }

    /// The controller was reset: it knows nothing of what it was sent.
    pub(super) fn forget(&mut self) {
        self.waiting.clear();
        self.unanswered.clear();
        (self.unanswered_bytes, self.asked_us, self.asks) = (0, None, false);
    }

    /// The next bytes for the line.
    pub(super) fn next(&mut self, now_us: u64) -> Option<Vec<u8>> {
        if std::mem::take(&mut self.resets) {
            return Some(vec![RESET]);
        }
        let mut bytes = Vec::new();
        if std::mem::take(&mut self.asks) {
            self.asked_us = Some(now_us);
            bytes.push(STATUS);
        }
        while let Some((line, kind)) = self.waiting.front() {
            let size = line.len() + 1;
            if self.unanswered_bytes + size > self.usable_bytes || bytes.len() + size > MAX_PIECE_BYTES {
                break;
            }
            bytes.extend_from_slice(line.as_bytes());
            bytes.push(b'\n');
            self.unanswered.push_back((size, *kind));
            self.unanswered_bytes += size;
            self.waiting.pop_front();
        }
        (!bytes.is_empty()).then_some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_is_sent_than_there_is_room_for_line_ends_included() {
        let mut sender = Sender::default();
        sender.set_room(20);
        for line in ["G1X1Y1", "G1X2Y2", "G1X3Y3"] {
            sender.push(line, Kind::Beam);
        }
        assert_eq!(sender.next(0).unwrap(), b"G1X1Y1\nG1X2Y2\n");
        assert_eq!(sender.next(0), None);
        assert_eq!(sender.answered(), Some(Kind::Beam));
        assert_eq!(sender.next(0).unwrap(), b"G1X3Y3\n");
        assert!(!sender.is_empty());
        assert_eq!(
            (sender.answered(), sender.answered(), sender.answered()),
            (Some(Kind::Beam), Some(Kind::Beam), None)
        );
        assert!(sender.is_empty());
    }

    #[test]
    fn a_reset_overtakes_all_lines_and_questions_are_not_repeated_at_once() {
        let mut sender = Sender::default();
        sender.set_room(20);
        sender.push("G1X1Y1", Kind::Beam);
        sender.ask(0);
        sender.reset();
        assert_eq!(sender.next(0).unwrap(), [RESET]);
        assert_eq!(sender.next(0).unwrap(), b"?G1X1Y1\n");
        sender.ask(10);
        assert_eq!(sender.next(10), None);
        sender.ask(STATUS_LOST_US);
        assert_eq!(sender.next(STATUS_LOST_US).unwrap(), b"?");
        sender.heard_status();
        sender.ask(STATUS_LOST_US + 1);
        assert_eq!(sender.next(STATUS_LOST_US + 1).unwrap(), b"?");
    }
}
