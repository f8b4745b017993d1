//! Reliable data in both directions; the same at both ends. `tests/wrap_around.rs` joins two of them.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use crate::{Ack, Decoded, FrameKind, encode_frame, payload_limit};

use super::incoming::{Arrival, Incoming};
use super::line::Line;
use super::outgoing::{FalseAck, Outgoing};
use super::timer::RetransmitTimer;
use super::{DEAD_MAN_US, SendError, line_bytes, line_time_us};

/// Most line time in flight. More is useless, because acknowledgements come back far sooner; and a window must cross a slow line well
/// within the dead-man time.
const WINDOW_TIME_US: u64 = 250_000;

/// Room in the queue that layer data may not use, so that layer data does not block requests. It holds several of the largest
/// request.
const RESERVE_BYTES: usize = 1024;

/// What both ends agreed on.
#[derive(Clone, Copy, Debug)]
pub struct Terms {
    /// The session.
    pub session_id: u32,
    /// Line rate, 8N1.
    pub baud: u32,
    /// Window that the peer stated, bytes.
    pub peer_window_bytes: usize,
    /// Largest frame to send, bytes; at most what the peer stated.
    pub frame_bytes: usize,
    /// Window stated to the peer, bytes.
    pub own_window_bytes: usize,
    /// Number of the first data frame in both directions: 0 in the protocol; tests of the wrap-around begin elsewhere.
    pub first_sequence: u32,
}

/// One end of an open session.
#[derive(Debug)]
pub struct Endpoint {
    session_id: u32,
    frame_bytes: usize,
    queue_limit_bytes: usize,
    outgoing: Outgoing,
    incoming: Incoming,
    /// Payloads received, with the wire bytes of their frames; bounded by the window.
    received: VecDeque<(Vec<u8>, usize)>,
    timer: RetransmitTimer,
    retransmit_at_us: Option<u64>,
    last_heard_us: u64,
}

impl Endpoint {
    /// An endpoint of a session that begins now.
    pub fn new(terms: &Terms, now_us: u64) -> Self {
        let frame_bytes = terms.frame_bytes.min(terms.peer_window_bytes);
        let window = terms.peer_window_bytes.min(line_bytes(WINDOW_TIME_US, terms.baud).max(frame_bytes));
        Self {
            session_id: terms.session_id,
            frame_bytes,
            // One window in flight and one ready to follow.
            queue_limit_bytes: 2 * window,
            outgoing: Outgoing::new(terms.first_sequence, window),
            incoming: Incoming::new(terms.first_sequence, terms.own_window_bytes, now_us),
            received: VecDeque::new(),
            timer: RetransmitTimer::new(line_time_us(window, terms.baud)),
            retransmit_at_us: None,
            last_heard_us: now_us,
        }
    }

    /// The session.
    pub fn session_id(&self) -> u32 {
        self.session_id
    }

    /// The longest payload of a data frame.
    pub fn payload_limit(&self) -> usize {
        payload_limit(self.frame_bytes)
    }

    /// Whether data waits for credit or for the line.
    pub fn has_unsent(&self) -> bool {
        self.outgoing.has_unsent()
    }

    /// Queues the payload of one data frame. `bulk` is for layer data, which leaves room in the queue for other messages.
    ///
    /// # Errors
    /// [`SendError::TooLarge`] or [`SendError::Full`]; then it is not queued.
    pub fn send(&mut self, payload: &[u8], bulk: bool) -> Result<(), SendError> {
        let limit = self.payload_limit();
        if payload.len() > limit {
            return Err(SendError::TooLarge { bytes: payload.len(), limit });
        }
        let frame = encode_frame(FrameKind::Data, self.session_id, self.outgoing.next_sequence(), payload);
        let reserve = if bulk { 0 } else { RESERVE_BYTES };
        if self.outgoing.queued_bytes() + frame.len() > self.queue_limit_bytes + reserve {
            return Err(SendError::Full);
        }
        self.outgoing.push(frame);
        Ok(())
    }

    /// A frame of this session came.
    pub fn heard(&mut self, now_us: u64) {
        self.last_heard_us = now_us;
    }

    /// A data frame came.
    pub fn receive_data(&mut self, decoded: Decoded, line: &mut Line, now_us: u64) {
        match self.incoming.arrive(decoded.frame.sequence, decoded.wire_bytes, now_us) {
            Arrival::Next => self.received.push_back((decoded.frame.payload, decoded.wire_bytes)),
            Arrival::Duplicate => line.statistics.duplicate_frames += 1,
            Arrival::Gap => line.statistics.gap_frames += 1,
            Arrival::Overrun => line.statistics.overrun_frames += 1,
        }
    }

    /// Bytes queued or sent, and not acknowledged.
    pub fn queued_bytes(&self) -> usize {
        self.outgoing.queued_bytes()
    }

    /// The room that the peer states, bytes, if the next frame does not fit; `None` if nothing or something else stops it.
    pub fn missing_credit(&self) -> Option<usize> {
        self.outgoing.missing_credit()
    }

    /// An acknowledgement came. Returns how many bytes it acknowledged.
    ///
    /// # Errors
    /// [`FalseAck`]; it changes nothing else.
    pub fn receive_ack(&mut self, ack: &Ack, line: &mut Line, now_us: u64) -> Result<usize, FalseAck> {
        let progress = self.outgoing.acknowledge(ack, now_us)?;
        if let Some(round_trip_us) = progress.round_trip_us {
            self.timer.sample(round_trip_us);
        } else if progress.frames > 0 {
            self.timer.progress();
        }
        if progress.lost {
            line.statistics.fast_retransmits += 1;
        }
        if !self.outgoing.is_waiting() {
            self.retransmit_at_us = None;
        } else if progress.frames > 0 || progress.lost {
            self.retransmit_at_us = Some(now_us + self.timer.timeout_us());
        }
        self.note_flight(line);
        Ok(progress.bytes)
    }

    /// The next payload received in order. Its room becomes free.
    pub fn take_received(&mut self, now_us: u64) -> Option<Vec<u8>> {
        let (payload, wire_bytes) = self.received.pop_front()?;
        self.incoming.release(wire_bytes, now_us);
        Some(payload)
    }

    /// The next frame for the line: an acknowledgement if one is due, else data if credit allows.
    pub fn transmit(&mut self, line: &mut Line, now_us: u64) -> Option<Vec<u8>> {
        if now_us >= self.incoming.ack_at_us() {
            let ack = self.incoming.acknowledge(now_us);
            return Some(line.frame(FrameKind::Ack, self.session_id, ack.next_sequence, &ack.encode()));
        }
        let (frame, again) = self.outgoing.transmit(now_us)?;
        line.statistics.retransmitted_frames += u64::from(again);
        let bytes = line.send(frame);
        self.retransmit_at_us.get_or_insert(now_us + self.timer.timeout_us());
        self.note_flight(line);
        Some(bytes)
    }

    /// When [`Self::handle_timeout`] or [`Self::transmit`] has something to do next.
    pub fn next_timeout_us(&self) -> u64 {
        let own = self.incoming.ack_at_us().min(self.last_heard_us + DEAD_MAN_US);
        self.retransmit_at_us.map_or(own, |at| at.min(own))
    }

    /// Handles timers. Returns `true` when the peer has been silent for too long.
    pub fn handle_timeout(&mut self, line: &mut Line, now_us: u64) -> bool {
        if self.retransmit_at_us.is_some_and(|at| now_us >= at) {
            self.outgoing.give_up_flight();
            self.timer.back_off();
            self.retransmit_at_us = None;
            line.statistics.timeouts += 1;
        }
        now_us >= self.last_heard_us + DEAD_MAN_US
    }

    fn note_flight(&self, line: &mut Line) {
        line.statistics.flight_bytes = self.outgoing.flight_bytes() as u64;
        line.statistics.peak_flight_bytes = line.statistics.peak_flight_bytes.max(line.statistics.flight_bytes);
        line.statistics.round_trip_us = self.timer.smoothed_us();
    }
}
