//! Data frames on their way out: queued, in flight, acknowledged, lost. Go-back-N under a credit of bytes.
//! [`Endpoint`](super::Endpoint) uses it.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use crate::Ack;

/// What an acknowledgement changed.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Progress {
    /// Frames newly acknowledged.
    pub(super) frames: usize,
    /// Round trip of the newest of them, if it was sent only once.
    pub(super) round_trip_us: Option<u64>,
    /// Bytes of those frames.
    pub(super) bytes: usize,
    /// The first frame not acknowledged is known to be lost; sending starts again there.
    pub(super) lost: bool,
}

/// An acknowledgement of frames that were never sent. Its sender does not follow the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FalseAck {
    /// The first frame that was never sent.
    pub next_sequence: u32,
}

/// Frames not yet acknowledged, in order.
#[derive(Debug)]
pub(super) struct Outgoing {
    frames: VecDeque<Queued>,
    /// Sequence of `frames[0]`.
    first_sequence: u32,
    /// `frames[..cursor]` were sent since sending last went back.
    cursor: usize,
    /// `frames[..reached]` were sent at least once.
    reached: usize,
    queued_bytes: usize,
    /// Data frames in the order sent that the peer may not have read yet; a frame sent again stands here twice.
    flight: VecDeque<(u32, usize)>,
    flight_bytes: usize,
    window_bytes: usize,
    /// What the peer last said it has room for.
    credit_bytes: usize,
}

#[derive(Debug)]
struct Queued {
    bytes: Vec<u8>,
    sent_us: u64,
    transmissions: u32,
}

impl Outgoing {
    /// At most `window_bytes` are in flight.
    pub(super) fn new(first_sequence: u32, window_bytes: usize) -> Self {
        Self {
            frames: VecDeque::new(),
            first_sequence,
            cursor: 0,
            reached: 0,
            queued_bytes: 0,
            flight: VecDeque::new(),
            flight_bytes: 0,
            window_bytes,
            credit_bytes: window_bytes,
        }
    }

    /// Sequence of the next frame to push.
    pub(super) fn next_sequence(&self) -> u32 {
        // The queue is bounded by bytes, far below 2^32 frames.
        self.first_sequence.wrapping_add(self.frames.len() as u32)
    }

    /// Bytes queued or sent, and not acknowledged.
    pub(super) fn queued_bytes(&self) -> usize {
        self.queued_bytes
    }

    pub(super) fn flight_bytes(&self) -> usize {
        self.flight_bytes
    }

    /// The room that the peer states, if the next frame does not fit; `None` if nothing or something else stops it.
    pub(super) fn missing_credit(&self) -> Option<usize> {
        let frame = self.frames.get(self.cursor)?;
        (self.flight_bytes + frame.bytes.len() > self.credit_bytes && self.credit_bytes < self.window_bytes)
            .then_some(self.credit_bytes)
    }

    /// Queues the encoded frame of [`Self::next_sequence`].
    pub(super) fn push(&mut self, bytes: Vec<u8>) {
        self.queued_bytes += bytes.len();
        self.frames.push_back(Queued { bytes, sent_us: 0, transmissions: 0 });
    }

    /// The next frame, if credit allows it, and whether it was sent before.
    pub(super) fn transmit(&mut self, now_us: u64) -> Option<(&[u8], bool)> {
        let frame = self.frames.get_mut(self.cursor)?;
        let length = frame.bytes.len();
        if self.flight_bytes + length > self.window_bytes.min(self.credit_bytes) {
            return None;
        }
        self.flight.push_back((self.first_sequence.wrapping_add(self.cursor as u32), length));
        self.flight_bytes += length;
        self.cursor += 1;
        self.reached = self.reached.max(self.cursor);
        frame.sent_us = now_us;
        frame.transmissions += 1;
        Some((&frame.bytes, frame.transmissions > 1))
    }

    /// Takes an acknowledgement. One that is older than the newest changes nothing.
    ///
    /// # Errors
    /// [`FalseAck`].
    pub(super) fn acknowledge(&mut self, ack: &Ack, now_us: u64) -> Result<Progress, FalseAck> {
        let acknowledged = ack.next_sequence.wrapping_sub(self.first_sequence);
        // Serial number arithmetic: up to 2^31 behind is old.
        if acknowledged >= 1 << 31 {
            return Ok(Progress::default());
        }
        let acknowledged = acknowledged as usize;
        if acknowledged > self.reached {
            return Err(FalseAck { next_sequence: self.first_sequence.wrapping_add(self.reached as u32) });
        }
        let mut progress = Progress { frames: acknowledged, ..Progress::default() };
        for frame in self.frames.drain(..acknowledged) {
            self.queued_bytes -= frame.bytes.len();
            progress.bytes += frame.bytes.len();
            progress.round_trip_us = (frame.transmissions == 1).then(|| now_us.saturating_sub(frame.sent_us));
        }
        self.first_sequence = ack.next_sequence;
        self.cursor = self.cursor.saturating_sub(acknowledged);
        self.reached -= acknowledged;
        self.credit_bytes = usize::try_from(ack.free_bytes).unwrap_or(usize::MAX);
        self.forget_flight_through(ack.last_heard);
        // The line keeps the order, so the peer heard a later frame and does not have this one.
        let first_in_flight = self.flight.iter().any(|&(sequence, _)| sequence == self.first_sequence);
        if ack.gap && self.cursor > 0 && !first_in_flight {
            self.cursor = 0;
            progress.lost = true;
        }
        Ok(progress)
    }

    /// The peer read this frame, so earlier frames are read or lost. If it was sent twice, the first is assumed, to be safe.
    fn forget_flight_through(&mut self, last_heard: u32) {
        if let Some(position) = self.flight.iter().position(|&(sequence, _)| sequence == last_heard) {
            let read: usize = self.flight.drain(..=position).map(|(_, length)| length).sum();
            self.flight_bytes -= read;
        }
    }

    /// No acknowledgement came: everything in flight counts as lost.
    pub(super) fn give_up_flight(&mut self) {
        self.flight.clear();
        self.flight_bytes = 0;
        self.cursor = 0;
    }

    /// Whether frames wait for credit or for the line.
    pub(super) fn has_unsent(&self) -> bool {
        self.cursor < self.frames.len()
    }

    /// Whether sent frames are unread or unacknowledged.
    pub(super) fn is_waiting(&self) -> bool {
        !self.flight.is_empty() || self.cursor > 0
    }
}
