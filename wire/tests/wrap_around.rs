//! Sequence numbers that wrap around, with frames lost before and after: two endpoints in virtual time.

use std::collections::VecDeque;

use layerd_wire::session::{Endpoint, Line, Statistics, Terms};
use layerd_wire::{Ack, FrameKind};

/// One end, and the frames on their way to it.
struct End {
    endpoint: Endpoint,
    line: Line,
    coming: VecDeque<Vec<u8>>,
}

impl End {
    fn new() -> Self {
        let terms = Terms {
            session_id: 7,
            baud: 115_200,
            peer_window_bytes: 256,
            frame_bytes: 64,
            own_window_bytes: 256,
            first_sequence: u32::MAX - 20,
        };
        let line = Line::new(64, false, Statistics::default());
        Self { endpoint: Endpoint::new(&terms, 0), line, coming: VecDeque::new() }
    }

    /// Takes the frames that came.
    fn take(&mut self, now_us: u64) {
        for bytes in std::mem::take(&mut self.coming) {
            for decoded in self.line.receive(&bytes) {
                self.endpoint.heard(now_us);
                match decoded.frame.kind {
                    FrameKind::Data => self.endpoint.receive_data(decoded, &mut self.line, now_us),
                    FrameKind::Ack => {
                        let ack = Ack::decode(decoded.frame.sequence, &decoded.frame.payload).expect("well formed");
                        self.endpoint.receive_ack(&ack, &mut self.line, now_us).expect("of what was sent");
                    }
                    other => panic!("unexpected {other:?}"),
                }
            }
        }
    }
}

#[test]
fn sequences_wrap_around() {
    let (mut host, mut device) = (End::new(), End::new());
    let (mut sent, mut received) = (0_u32, Vec::new());
    for now_us in (0..3_000_000).step_by(1_000) {
        while sent < 60 && host.endpoint.send(&sent.to_le_bytes(), true).is_ok() {
            sent += 1;
        }
        // Every seventh frame is lost, so that gaps and time-outs straddle the wrap-around.
        while let Some(frame) = host.endpoint.transmit(&mut host.line, now_us) {
            if host.line.statistics.frames_sent % 7 != 3 {
                device.coming.push_back(frame);
            }
        }
        device.take(now_us);
        while let Some(payload) = device.endpoint.take_received(now_us) {
            received.push(payload);
        }
        while let Some(frame) = device.endpoint.transmit(&mut device.line, now_us) {
            host.coming.push_back(frame);
        }
        host.take(now_us);
        assert!(!host.endpoint.handle_timeout(&mut host.line, now_us), "never silent");
        assert!(!device.endpoint.handle_timeout(&mut device.line, now_us), "never silent");
    }
    let expected: Vec<Vec<u8>> = (0..60_u32).map(|index| index.to_le_bytes().into()).collect();
    assert_eq!(received, expected);
    let lost = host.line.statistics;
    assert!(lost.fast_retransmits > 0 && lost.retransmitted_frames > 0, "{lost:?}");
}
