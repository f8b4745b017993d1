//! What keeps data from getting through in an open session. The acknowledgements show the cause.
//! `tests/link_causes.rs` shows each.

/// Shorter waits are normal: one retransmission takes up to 500 ms.
const MIN_WAIT_US: u64 = 1_000_000;
/// Throughput is measured over this time, while data waits.
const SPAN_US: u64 = 2_000_000;
/// A line is slow below this fraction of its rate. A small window and a slow adapter cost half of the rate, not three quarters.
const SLOW_DIVISOR: u64 = 4;

/// Why data gets through slowly or not at all although the device is heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Hindrance {
    /// The device states too little room for the next frame.
    #[error(
        "the device has taken no data for {} s: it states room for {free_bytes} bytes only. Its firmware does not free its \
         window, or hangs: restart the device",
        waited_ms / 1000
    )]
    NoCredit {
        /// How long, milliseconds.
        waited_ms: u64,
        /// Room it states, bytes.
        free_bytes: u64,
    },
    /// What was sent is not acknowledged.
    #[error(
        "the device is heard, but has acknowledged nothing of what was sent for {} s: check the cable to the device, and that \
         `baud` and `flow_control` are those of the device",
        waited_ms / 1000
    )]
    Unacknowledged {
        /// How long, milliseconds.
        waited_ms: u64,
    },
    /// Data gets through much slower than the line's rate allows.
    #[error(
        "the line is slow: {bytes_s} bytes a second get through, and its rate allows {line_bytes_s}. Check cable and adapter, \
         and whether the device keeps up"
    )]
    Slow {
        /// Measured over the last two seconds or more with data waiting, bytes a second.
        bytes_s: u64,
        /// What the line rate allows, bytes a second.
        line_bytes_s: u64,
    },
}

/// Watches how data gets through.
#[derive(Debug)]
pub(super) struct Watch {
    line_bytes_s: u64,
    /// Since when data waits without an acknowledgement.
    stuck_since_us: Option<u64>,
    /// Start of the measurement under way, and the bytes acknowledged since.
    span: Option<(u64, u64)>,
    /// The last measurement, while data waits.
    bytes_s: Option<u64>,
}

impl Watch {
    /// For a line of this rate, 8N1.
    pub(super) fn new(baud: u32) -> Self {
        Self { line_bytes_s: u64::from(baud) / 10, stuck_since_us: None, span: None, bytes_s: None }
    }

    /// Updates the measurement; to be called regularly. `is_waiting`: unacknowledged data is queued or sent.
    pub(super) fn look(&mut self, is_waiting: bool, now_us: u64) {
        if !is_waiting {
            (self.stuck_since_us, self.span, self.bytes_s) = (None, None, None);
            return;
        }
        self.stuck_since_us.get_or_insert(now_us);
        let (began_us, bytes) = *self.span.get_or_insert((now_us, 0));
        let span_us = now_us.saturating_sub(began_us);
        if span_us >= SPAN_US {
            self.bytes_s = Some(bytes.saturating_mul(1_000_000) / span_us);
            self.span = Some((now_us, 0));
        }
    }

    /// The device acknowledged frames with `bytes` bytes in total.
    pub(super) fn acknowledged(&mut self, bytes: usize, now_us: u64) {
        self.stuck_since_us = Some(now_us);
        if let Some((_, counted)) = &mut self.span {
            *counted += bytes as u64;
        }
    }

    /// What hinders data now. `free_bytes` is the room that the device states, if the next frame does not fit.
    pub(super) fn hindrance(&self, free_bytes: Option<usize>, now_us: u64) -> Option<Hindrance> {
        let waited_us = now_us.saturating_sub(self.stuck_since_us?);
        if waited_us >= MIN_WAIT_US {
            let waited_ms = waited_us / 1000;
            return Some(match free_bytes {
                Some(free_bytes) => Hindrance::NoCredit { waited_ms, free_bytes: free_bytes as u64 },
                None => Hindrance::Unacknowledged { waited_ms },
            });
        }
        let (bytes_s, line_bytes_s) = (self.bytes_s?, self.line_bytes_s);
        (bytes_s < line_bytes_s / SLOW_DIVISOR).then_some(Hindrance::Slow { bytes_s, line_bytes_s })
    }
}
