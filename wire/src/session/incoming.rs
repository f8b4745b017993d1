//! Data frames coming in: order, duplicates, room, and when to acknowledge. [`Endpoint`](super::Endpoint) uses it.

use crate::Ack;

use super::{ACK_DELAY_US, HEARTBEAT_US};

/// What became of a data frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Arrival {
    /// The next in order: deliver it.
    Next,
    /// Received before.
    Duplicate,
    /// A frame before it is missing.
    Gap,
    /// No room: the owner has not taken the earlier frames.
    Overrun,
}

/// State of the receiving half.
#[derive(Debug)]
pub(super) struct Incoming {
    next_sequence: u32,
    last_heard: u32,
    gap: bool,
    window_bytes: usize,
    /// Received, not yet taken by the owner.
    held_bytes: usize,
    /// Room last stated to the peer.
    stated_bytes: usize,
    unacknowledged_bytes: usize,
    ack_at_us: u64,
}

impl Incoming {
    /// Room for `window_bytes` of frames. The first acknowledgement is due at once: it confirms the handshake.
    pub(super) fn new(first_sequence: u32, window_bytes: usize, now_us: u64) -> Self {
        Self {
            next_sequence: first_sequence,
            last_heard: first_sequence.wrapping_sub(1),
            gap: false,
            window_bytes,
            held_bytes: 0,
            stated_bytes: window_bytes,
            unacknowledged_bytes: 0,
            ack_at_us: now_us,
        }
    }

    /// A data frame of `wire_bytes` came.
    pub(super) fn arrive(&mut self, sequence: u32, wire_bytes: usize, now_us: u64) -> Arrival {
        self.last_heard = sequence;
        self.unacknowledged_bytes += wire_bytes;
        // Four acknowledgements per window keep the line busy while each is on its way.
        let delay_us = if self.unacknowledged_bytes >= self.window_bytes / 4 { 0 } else { ACK_DELAY_US };
        self.acknowledge_within(delay_us, now_us);
        // Serial number arithmetic: up to 2^31 behind is old.
        let ahead = sequence.wrapping_sub(self.next_sequence);
        if ahead >= 1 << 31 {
            return Arrival::Duplicate;
        }
        if ahead == 0 && self.held_bytes + wire_bytes <= self.window_bytes {
            self.next_sequence = self.next_sequence.wrapping_add(1);
            self.gap = false;
            self.held_bytes += wire_bytes;
            return Arrival::Next;
        }
        if !self.gap {
            self.gap = true;
            self.acknowledge_within(0, now_us);
        }
        if ahead == 0 { Arrival::Overrun } else { Arrival::Gap }
    }

    /// The owner took a frame of `wire_bytes`.
    pub(super) fn release(&mut self, wire_bytes: usize, now_us: u64) {
        self.held_bytes = self.held_bytes.saturating_sub(wire_bytes);
        let grown = self.free_bytes().saturating_sub(self.stated_bytes);
        if grown >= self.window_bytes / 4 || (grown > 0 && self.held_bytes == 0) {
            self.acknowledge_within(0, now_us);
        }
    }

    /// When the next acknowledgement is due.
    pub(super) fn ack_at_us(&self) -> u64 {
        self.ack_at_us
    }

    /// The acknowledgement to send now; the next is due with the heartbeat.
    pub(super) fn acknowledge(&mut self, now_us: u64) -> Ack {
        self.stated_bytes = self.free_bytes();
        self.unacknowledged_bytes = 0;
        self.ack_at_us = now_us + HEARTBEAT_US;
        Ack {
            next_sequence: self.next_sequence,
            gap: self.gap,
            last_heard: self.last_heard,
            free_bytes: u32::try_from(self.stated_bytes).unwrap_or(u32::MAX),
        }
    }

    fn acknowledge_within(&mut self, delay_us: u64, now_us: u64) {
        self.ack_at_us = self.ack_at_us.min(now_us + delay_us);
    }

    fn free_bytes(&self) -> usize {
        self.window_bytes.saturating_sub(self.held_bytes)
    }
}
