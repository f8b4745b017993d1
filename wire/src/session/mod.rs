//! The reliable session: order, loss, credit, urgency, silence. A pure state machine: no I/O, no clock.
//!
//! Bytes from the line go in, whole frames for the line come out. The owner passes the time in microseconds since any fixed
//! start. After every input the owner calls `transmit` while the line takes bytes and `event` until it is empty; it calls
//! `handle_timeout` at `next_timeout_us`. The [crate's example](crate) shows it.
//!
//! [`DeviceSession`] is the device's end. The host's end is part of `layerd`; both are built on [`Endpoint`], which carries data
//! reliably, and [`Line`], which converts between bytes and frames.

mod device;
mod endpoint;
mod incoming;
mod line;
mod outgoing;
mod timer;

pub use device::{DeviceEvent, DeviceSession, DeviceSettings};
pub use endpoint::{Endpoint, Terms};
pub use line::Line;
pub use outgoing::FalseAck;

/// A peer that was not heard for this long is lost: eight heartbeats.
pub const DEAD_MAN_US: u64 = 2_000_000;

/// An acknowledgement is sent at least this often, so that the peer hears something. On a line that loses 30 % of all frames, eight
/// in a row are lost once in an hour and a half. With 500 ms, four in a row would be lost once in a minute and a half.
pub const HEARTBEAT_US: u64 = 250_000;

/// An acknowledgement waits at most this long for more data: well below the 13.6 ms in which a 3 Mbaud line fills a 4 KiB window.
pub const ACK_DELAY_US: u64 = 5_000;

/// Most urgent frames without an answer. They are answered within 100 ms, so more means that nothing is answered. Then the oldest
/// is dropped, never the newest.
pub const MAX_URGENTS: usize = 16;

/// A message that was not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SendError {
    /// The queue is full; try again after acknowledgements.
    #[error("the send queue is full")]
    Full,
    /// Longer than a frame.
    #[error("a message of {bytes} bytes does not fit a frame, which takes {limit}")]
    TooLarge {
        /// Encoded length.
        bytes: usize,
        /// What fits.
        limit: usize,
    },
    /// No session.
    #[error("there is no session with the other end")]
    NotConnected,
}

/// Counts since the session object was made (for the host: since the first of a chain of sessions).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Bytes handed to the line.
    pub bytes_sent: u64,
    /// Bytes taken from the line.
    pub bytes_received: u64,
    /// Frames handed to the line.
    pub frames_sent: u64,
    /// Whole frames taken from the line.
    pub frames_received: u64,
    /// Data frames sent again.
    pub retransmitted_frames: u64,
    /// Times that a gap caused data to be sent again.
    pub fast_retransmits: u64,
    /// Times the retransmission timer ran out.
    pub timeouts: u64,
    /// Frames with a wrong checksum.
    pub crc_errors: u64,
    /// Bytes between delimiters that are not a frame, and frames with a malformed payload.
    pub malformed_frames: u64,
    /// Reports of an unknown kind, which the host ignores. They are not bad frames.
    pub unknown_reports: u64,
    /// Frames of another session.
    pub stale_frames: u64,
    /// Data frames that had been received before.
    pub duplicate_frames: u64,
    /// Data frames dropped because one before them was missing.
    pub gap_frames: u64,
    /// Data frames dropped because the receive buffer was full.
    pub overrun_frames: u64,
    /// Urgent frames sent again.
    pub repeated_urgents: u64,
    /// Smoothed round trip, microseconds; 0 before the first sample.
    pub round_trip_us: u64,
    /// Sent data bytes that the peer may not have read yet.
    pub flight_bytes: u64,
    /// Highest value of `flight_bytes`.
    pub peak_flight_bytes: u64,
}

/// Microseconds that `bytes` take on an 8N1 line (ten bits a byte).
pub fn line_time_us(bytes: usize, baud: u32) -> u64 {
    (bytes as u64 * 10_000_000).div_ceil(u64::from(baud.max(1)))
}

/// Bytes that an 8N1 line carries in `us` microseconds.
pub fn line_bytes(us: u64, baud: u32) -> usize {
    usize::try_from(us.saturating_mul(u64::from(baud)) / 10_000_000).unwrap_or(usize::MAX)
}
