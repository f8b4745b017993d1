//! What the host makes of a device that does not do its part: each cause is told by its own name. The device is written by
//! hand, frame by frame, in virtual time.

mod link_pair;

use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, ExposureId, HostMessage, Reply, Request, Urgent, VatRequest,
};
use layerd::link::session::{HelloRefusal, Hindrance, HostEvent, HostSession, HostSettings, LostReason};
use layerd_wire::{
    Ack, Decoded, Frame, FrameDecoder, FrameKind, HelloRefused, VERSIONS, VersionRange, Welcome, WireError,
    encode_device_message, encode_frame,
};

const SESSION: u32 = 7;
const BAUD: u32 = 3_000_000;
const WINDOW_BYTES: u32 = 4096;

/// A device that says only what a test tells it to.
struct Script {
    host: HostSession,
    now_us: u64,
    decoder: FrameDecoder,
    /// What the host sent since it was last looked at.
    heard: Vec<Frame>,
    sequence: u32,
}

impl Script {
    /// Welcomed with these.
    fn new(capabilities: Capabilities, state: DeviceState) -> Self {
        let mut script = Self::greeting();
        let welcome = Welcome { version: 1, capabilities, state };
        script.say(FrameKind::Welcome, 0, &welcome.encode());
        script
    }

    /// No answer yet.
    fn greeting() -> Self {
        let host = HostSession::new(SESSION, HostSettings { baud: BAUD, escaped: false }, 0);
        let mut script = Self { host, now_us: 0, decoder: FrameDecoder::new(1024), heard: Vec::new(), sequence: 0 };
        script.wait(1_000);
        script
    }

    fn ordinary() -> Self {
        let mut script = Self::new(link_pair::capabilities(WINDOW_BYTES, 1024), DeviceState::default());
        assert!(matches!(script.host.event(), Some(HostEvent::Connected { .. })));
        script
    }

    fn say(&mut self, kind: FrameKind, sequence: u32, payload: &[u8]) {
        self.host.receive(&encode_frame(kind, SESSION, sequence, payload), self.now_us);
    }

    fn report(&mut self, payload: &[u8]) {
        self.say(FrameKind::Data, self.sequence, payload);
        self.sequence += 1;
    }

    fn ack(&mut self, next_sequence: u32, last_heard: u32, free_bytes: u32) {
        let ack = Ack { next_sequence, gap: false, last_heard, free_bytes };
        self.say(FrameKind::Ack, next_sequence, &ack.encode());
    }

    /// Time passes; the host sends what it may.
    fn wait(&mut self, us: u64) {
        let end_us = self.now_us + us;
        while self.now_us < end_us {
            self.now_us += 1_000;
            self.host.handle_timeout(self.now_us);
            while let Some(bytes) = self.host.transmit(self.now_us) {
                let mut input = &bytes[..];
                while let Some(Ok(Decoded { frame, .. })) = self.decoder.next_frame(&mut input) {
                    self.heard.push(frame);
                }
            }
        }
    }

    /// The highest number of a data frame the host sent so far.
    fn newest(&self) -> Option<u32> {
        self.heard.iter().filter(|frame| frame.kind == FrameKind::Data).map(|frame| frame.sequence).max()
    }

    fn fill_queue(&mut self) {
        let piece = HostMessage::LayerData(vec![9; self.host.largest_layer_data_bytes()]);
        while link_pair::queue(&mut self.host, &piece) {}
    }

    fn request(&mut self, number: u32) {
        self.host.send(&HostMessage::Request { number, request: Request::Vat(VatRequest::Home) }).expect("room");
    }
}

#[test]
fn a_device_without_room_is_told_from_one_that_does_not_hear() {
    let mut full = Script::ordinary();
    full.request(1);
    full.fill_queue();
    full.wait(10_000);
    let newest = full.newest().expect("data was sent");
    // It took all of a window, and never has room again.
    for _ in 0..8 {
        full.ack(newest + 1, newest, 0);
        full.wait(250_000);
    }
    assert!(full.host.event().is_none(), "the session stands");
    assert!(
        matches!(full.host.hindrance(), Some(Hindrance::NoCredit { waited_ms: 1_000..3_000, free_bytes: 0 })),
        "{:?}",
        full.host.hindrance()
    );
    let text = full.host.hindrance().expect("no credit").to_string();
    assert!(text.contains("room for 0 bytes") && text.contains("restart the device"), "{text}");
    let number = 1;
    full.host.send_urgent(number, Urgent::Abort, full.now_us);
    full.heard.clear();
    full.wait(1_000);
    let is_urgent = |frame: &Frame| frame.kind == FrameKind::Urgent && frame.sequence == number;
    assert!(full.heard.iter().any(is_urgent), "an abort needs no credit");

    let mut deaf = Script::ordinary();
    deaf.request(1);
    for _ in 0..8 {
        deaf.ack(0, u32::MAX, WINDOW_BYTES);
        deaf.wait(250_000);
    }
    assert!(matches!(deaf.host.hindrance(), Some(Hindrance::Unacknowledged { waited_ms: 1_000.. })));
    let text = deaf.host.hindrance().expect("nothing came through").to_string();
    assert!(text.contains("acknowledged nothing") && text.contains("cable"), "{text}");
    // One that hears again hinders nothing.
    let newest = deaf.newest().expect("data was sent");
    deaf.ack(newest + 1, newest, WINDOW_BYTES);
    deaf.wait(10_000);
    assert_eq!(deaf.host.hindrance(), None);
}

#[test]
fn a_slow_line_is_measured_and_a_short_wait_is_no_hindrance() {
    let mut slow = Script::ordinary();
    // A frame of 1000 bytes in 100 ms; the rate allows thirty of them.
    for sequence in 0..60 {
        slow.fill_queue();
        slow.wait(100_000);
        assert!(!matches!(slow.host.hindrance(), Some(Hindrance::NoCredit { .. } | Hindrance::Unacknowledged { .. })));
        slow.ack(sequence + 1, sequence, WINDOW_BYTES);
    }
    let Some(Hindrance::Slow { bytes_s, line_bytes_s: 300_000 }) = slow.host.hindrance() else {
        panic!("{:?}", slow.host.hindrance());
    };
    assert!((8_000..12_000).contains(&bytes_s), "{bytes_s} bytes a second");
}

#[test]
fn acknowledging_what_was_never_sent_ends_the_session_with_that_reason() {
    let mut script = Script::ordinary();
    script.request(1);
    script.wait(1_000);
    // Just right: one frame was sent.
    script.ack(1, 0, WINDOW_BYTES);
    assert!(script.host.event().is_none());
    // Older than the newest: late, and of no meaning.
    script.ack(0, u32::MAX, WINDOW_BYTES);
    assert!(script.host.event().is_none());
    script.ack(2, 0, WINDOW_BYTES);
    let Some(HostEvent::Lost(reason @ LostReason::FalseAck { acknowledged: 2, sent: 1 })) = script.host.event() else {
        panic!("a false acknowledgement");
    };
    assert!(reason.to_string().contains("does not follow the protocol"), "{reason}");
    // What waits to be sent was not sent, either.
    let mut script = Script::ordinary();
    script.fill_queue();
    script.wait(1_000);
    let unsent = script.newest().expect("data was sent") + 2;
    script.ack(unsent, 0, WINDOW_BYTES);
    assert!(matches!(script.host.event(), Some(HostEvent::Lost(LostReason::FalseAck { .. }))));
}

#[test]
fn reports_of_an_unknown_kind_are_counted_for_themselves_and_change_nothing() {
    let mut script = Script::ordinary();
    for kind in 2..12 {
        script.report(&[0x82, kind, 1, 2, 3]);
    }
    assert_eq!(script.host.event(), None);
    let statistics = script.host.statistics();
    assert_eq!((statistics.unknown_reports, statistics.malformed_frames, statistics.crc_errors), (10, 0, 0));
    script.report(&encode_device_message(&DeviceMessage::Reply { number: 3, reply: Reply::Done }));
    assert!(matches!(script.host.event(), Some(HostEvent::Message(_))));
}

#[test]
fn a_version_that_the_host_did_not_offer_is_refused_whatever_follows() {
    for (chosen, rest) in [(0, &b""[..]), (2, b"of a far future"), (u16::MAX, &[0; 300])] {
        let mut script = Script::greeting();
        script.say(FrameKind::Welcome, 0, &[&u16::to_le_bytes(chosen), rest].concat());
        let refusal = HelloRefusal::NotOffered { host: VERSIONS, chosen };
        assert_eq!(script.host.event(), Some(HostEvent::Refused(refusal.clone())), "{rest:?}");
        let text = refusal.to_string();
        assert!(text.contains(&format!("chose version {chosen} of")) && text.contains("offered version 1"), "{text}");
    }
    let mut script = Script::greeting();
    script.say(FrameKind::Welcome, 0, &1_u16.to_le_bytes());
    assert!(matches!(script.host.event(), Some(HostEvent::Refused(HelloRefusal::BadWelcome(WireError::Short { .. })))));
}

#[test]
fn without_a_common_version_the_operator_is_told_both_ranges_and_what_to_update() {
    for (lowest, highest, words) in [
        (2, 3, "the device speaks versions 2 to 3 of the protocol, this host speaks version 1: update layerd"),
        (1, 4, "it refuses a version that both speak"),
    ] {
        let mut script = Script::greeting();
        let device = VersionRange { lowest, highest };
        script.say(FrameKind::HelloRefused, 0, &HelloRefused::Version { device }.encode());
        let refusal = HelloRefusal::Version { host: VERSIONS, device };
        assert_eq!(script.host.event(), Some(HostEvent::Refused(refusal.clone())));
        assert!(refusal.to_string().contains(words), "{refusal}");
    }
}

#[test]
fn a_refusal_that_makes_no_sense_is_told_as_that() {
    let refused_by = |payload: &[u8]| {
        let mut script = Script::greeting();
        script.say(FrameKind::HelloRefused, 0, payload);
        let Some(HostEvent::Refused(refusal)) = script.host.event() else { panic!("{payload:?} is a refusal") };
        refusal
    };
    for (lowest, highest) in [(0, 0), (0, 1), (3, 2), (1, 0)] {
        let device = VersionRange { lowest, highest };
        let refusal = refused_by(&HelloRefused::Version { device }.encode());
        assert_eq!(refusal, HelloRefusal::NoVersion { device });
        let words = format!("states for itself the versions from {lowest} to {highest}, which is no range");
        assert!(refusal.to_string().contains(&words), "{refusal}");
    }
    for payload in [&b""[..], &[1, 1, 0], &[9], &[2, 0]] {
        let refusal = refused_by(payload);
        assert!(matches!(refusal, HelloRefusal::BadRefusal(_)), "{payload:?}: {refusal:?}");
        let text = refusal.to_string();
        assert!(text.contains("its reason makes no sense") && !text.contains("welcome"), "{text}");
    }
    let text = refused_by(&HelloRefused::Limits.encode()).to_string();
    for words in ["window of 8192 bytes", "frames of 1024 bytes", "only 640 of each", "update the device's firmware"] {
        assert!(text.contains(words), "{text}");
    }
}

#[test]
fn both_ends_agree_on_the_highest_common_version() {
    let range = |lowest, highest| VersionRange { lowest, highest };
    for (host, device, common) in [
        (range(1, 1), range(1, 1), Some(1)),
        (range(1, 3), range(2, 9), Some(3)),
        (range(2, 9), range(1, 3), Some(3)),
        (range(1, 2), range(3, 4), None),
        (range(3, 4), range(1, 2), None),
        (range(5, 4), range(1, 9), None),
        (range(0, u16::MAX), range(7, 7), Some(7)),
    ] {
        assert_eq!(host.highest_common(device), common, "{host} and {device}");
        assert_eq!(device.highest_common(host), common, "{device} and {host}");
    }
}

#[test]
fn a_machine_of_an_unknown_kind_is_refused_by_its_kind_whatever_follows() {
    let capabilities = link_pair::capabilities(WINDOW_BYTES, 1024);
    let lists_bytes = capabilities.name.len() + capabilities.encodings.len();
    let mut welcome = Welcome { version: 1, capabilities, state: DeviceState::default() }.encode();
    // Behind version, name, slots, window, largest frame, encodings and longest exposure.
    let kind_at = 2 + 1 + 1 + 4 + 2 + 1 + 4 + lists_bytes;
    assert_eq!(welcome[kind_at], 1, "a vat");
    for (kind, length) in [(0, welcome.len()), (4, kind_at + 1), (255, welcome.len())] {
        welcome[kind_at] = kind;
        let mut script = Script::greeting();
        script.say(FrameKind::Welcome, 0, &welcome[..length]);
        let refusal = HelloRefusal::UnknownMachine { kind };
        assert_eq!(script.host.event(), Some(HostEvent::Refused(refusal.clone())));
        assert!(refusal.to_string().contains(&format!("kind {kind}, which this host does not know")), "{refusal}");
    }
}

#[test]
fn slots_left_out_of_a_state_are_empty_and_more_than_there_are_make_no_sense() {
    let held = Some(ExposureId::first_pass(1, 2));
    let of = |slots: &[Option<ExposureId>]| DeviceState { slots: slots.to_vec(), ..DeviceState::default() };
    let capabilities = link_pair::capabilities(WINDOW_BYTES, 1024);
    for (stated, meant) in [(of(&[]), [None; 2]), (of(&[held]), [held, None]), (of(&[None, held]), [None, held])] {
        let mut script = Script::new(capabilities.clone(), stated.clone());
        let Some(HostEvent::Connected { state, .. }) = script.host.event() else { panic!("connected") };
        assert_eq!(state.slots, meant);
        script.report(&encode_device_message(&DeviceMessage::Reply { number: 1, reply: Reply::State(stated) }));
        let Some(HostEvent::Message(DeviceMessage::Reply { reply: Reply::State(state), .. })) = script.host.event()
        else {
            panic!("a state");
        };
        assert_eq!(state.slots, meant);
    }
    let many = of(&[None, None, held]);
    let mut script = Script::new(capabilities, many.clone());
    let bad = WireError::BadValue { field: "slots", value: 3 };
    assert_eq!(script.host.event(), Some(HostEvent::Refused(HelloRefusal::BadWelcome(bad))));
    let mut script = Script::ordinary();
    script.report(&encode_device_message(&DeviceMessage::Reply { number: 1, reply: Reply::State(many) }));
    assert_eq!(script.host.event(), Some(HostEvent::Lost(LostReason::BadMessage(bad))));
}
