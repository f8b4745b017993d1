//! The golden bytes of `tests/vectors/v1.txt`, checked in both directions, and decoders fed with garbage.

mod properties;

use std::collections::BTreeMap;

use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, MachineCapabilities,
    PowderCapabilities, PowderReply, PowderRequest, PowderState, Refusal, Reply, Report, Request, Urgent,
    VatCapabilities, VatReply, VatRequest, Vats, VatsState,
};
use layerd_wire::{
    Ack, Decoded, Frame, FrameDecoder, FrameError, FrameKind, Hello, HelloRefused, MIN_HOST_FRAME_BYTES, Unescaper,
    UrgentDone, VERSIONS, VersionRange, Welcome, decode_device_message, decode_host_message, decode_urgent,
    encode_device_message, encode_frame, encode_host_message, encode_urgent, escape, payload_limit,
};
use proptest::prelude::*;

const SESSION: u32 = 0xA1B2_C3D4;
const JOB: u64 = 0x0123_4567_89AB_CDEF;

fn vectors() -> BTreeMap<&'static str, Vec<u8>> {
    let lines = include_str!("vectors/v1.txt").lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            let (name, hex) = line.split_once(' ').expect("name and bytes");
            let digits = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).expect("hexadecimal");
            (name, (0..hex.len()).step_by(2).map(digits).collect())
        })
        .collect()
}

fn decode(bytes: &[u8]) -> Frame {
    let mut input = bytes;
    let decoded = FrameDecoder::new(1024).next_frame(&mut input).expect("a frame").expect("a good frame");
    assert_eq!(decoded.wire_bytes, bytes.len());
    assert!(input.is_empty());
    decoded.frame
}

fn id(layer: u32) -> ExposureId {
    ExposureId::first_pass(JOB, layer)
}

/// A second exposure of layer 43.
fn second_pass() -> ExposureId {
    ExposureId { pass: 1, ..id(43) }
}

fn capabilities() -> Capabilities {
    Capabilities {
        name: "Simulated DLP 1.0".into(),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::RawBit, Encoding::Group4],
        max_exposure_ms: 60_000,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: 1920,
            height_px: 1080,
            pixel_nm: [50_000; 2],
            max_position_um: 200_000,
            vats: Vats::ONE,
        }),
    }
}

fn busy_state() -> DeviceState {
    DeviceState {
        boot_id: 0xDEAD_BEEF,
        last_exposed: Some(id(41)),
        exposing: Some(id(42)),
        cut_short: Some((ExposureId { job: 7, layer: 3, pass: 2 }, 1250)),
        light_on: true,
        position_um: Some(-150),
        moving: true,
        slots: vec![Some(id(43)), None],
        fault: Some(fault()),
        powder: None,
        vats: None,
    }
}

fn vats_capabilities() -> Capabilities {
    let mut capabilities = capabilities();
    if let MachineCapabilities::Vat(vat) = &mut capabilities.machine {
        vat.vats = Vats { count: 2, change_ms: 2500 };
    }
    capabilities
}

fn vats_state(in_place: Option<u8>) -> DeviceState {
    DeviceState { vats: Some(VatsState { in_place }), ..busy_state() }
}

fn powder_capabilities() -> Capabilities {
    Capabilities {
        name: "Simulated SLM 1.0".into(),
        encodings: vec![Encoding::Vectors, Encoding::VectorsCoded],
        max_exposure_ms: 600_000,
        machine: MachineCapabilities::Powder(PowderCapabilities {
            field_um: [120_000, 100_000],
            max_power_mw: 200_000,
            layer_height_um: [20, 100],
            max_position_um: 150_000,
            buffer_bytes: 65_536,
        }),
        ..capabilities()
    }
}

fn powder_state() -> DeviceState {
    let powder = Some(PowderState { next_vector: 1200, broken: true, recoated: true });
    DeviceState { position_um: Some(2200), powder, ..busy_state() }
}

fn fault() -> Fault {
    Fault { code: 12, text: "lamp too hot".into() }
}

fn host_messages() -> Vec<(&'static str, HostMessage)> {
    let request = |number, request| HostMessage::Request { number, request };
    let begin = Request::LayerBegin {
        slot: 1,
        id: id(43),
        encoding: Encoding::Group4,
        encoded_bytes: 70_000,
        decoded_crc32: 0xCBF4_3926,
    };
    let begin_vectors = Request::LayerBegin {
        slot: 0,
        id: id(43),
        encoding: Encoding::VectorsCoded,
        encoded_bytes: 150_000,
        decoded_crc32: 0xCBF4_3926,
    };
    vec![
        ("request_state", request(1, Request::State)),
        ("request_layer_begin", request(2, begin)),
        ("layer_data", HostMessage::LayerData((0..16).collect())),
        ("layer_data_long", HostMessage::LayerData(vec![0xFF; 300])),
        (
            "request_expose",
            request(3, Request::Vat(VatRequest::Expose { id: id(43), duration_ms: 2500, light_pwm: 255 })),
        ),
        ("request_home", request(4, Request::Vat(VatRequest::Home))),
        ("request_move", request(5, Request::Vat(VatRequest::Move { position_um: 5050, speed_um_s: 1000 }))),
        (
            "request_expose_second_pass",
            request(6, Request::Vat(VatRequest::Expose { id: second_pass(), duration_ms: 900, light_pwm: 128 })),
        ),
        ("request_layer_begin_vectors", request(7, begin_vectors)),
        ("request_powder_home", request(8, Request::Powder(PowderRequest::Home))),
        (
            "request_powder_move",
            request(9, Request::Powder(PowderRequest::Move { position_um: 2200, speed_um_s: 5000 })),
        ),
        (
            "request_mark",
            request(10, Request::Powder(PowderRequest::Mark { id: id(43), from_vector: 1200, most_ms: 20_000 })),
        ),
        ("request_recoat", request(11, Request::Powder(PowderRequest::Recoat))),
        ("request_change", request(12, Request::Vat(VatRequest::Change { vat: 2, wash_ms: 20_000, drain_ms: 10_000 }))),
    ]
}

fn device_messages() -> Vec<(&'static str, DeviceMessage)> {
    let reply = |number, reply| DeviceMessage::Reply { number, reply };
    let refused = |refusal| reply(6, Reply::Refused(refusal));
    let marked = PowderReply::Marked { id: id(43), vectors: 20_619, laser_ms: 17_300, starved_ms: 12 };
    vec![
        ("reply_done", reply(2, Reply::Done)),
        ("reply_state", reply(1, Reply::State(busy_state()))),
        ("reply_exposed", reply(3, Reply::Vat(VatReply::Exposed { id: id(43), duration_ms: 2500 }))),
        ("reply_moved", reply(5, Reply::Vat(VatReply::Moved { position_um: 5050 }))),
        ("reply_refused_1", refused(Refusal::NotReady)),
        ("reply_refused_2", refused(Refusal::AlreadyExposed)),
        ("reply_refused_3", refused(Refusal::BadDuration)),
        ("reply_refused_4", refused(Refusal::NoSuchLayer)),
        ("reply_refused_5", refused(Refusal::SlotBusy)),
        ("reply_refused_6", refused(Refusal::BadLayer)),
        ("reply_refused_7", refused(Refusal::BadEncoding)),
        ("reply_refused_8", refused(Refusal::BadMove)),
        ("reply_refused_9", refused(Refusal::NotHomed)),
        ("reply_refused_10", refused(Refusal::Busy)),
        ("reply_refused_11", refused(Refusal::CutShort)),
        ("reply_refused_12", refused(Refusal::Unknown)),
        ("report_fault", DeviceMessage::Report(Report::Fault(Some(fault())))),
        ("report_works_again", DeviceMessage::Report(Report::Fault(None))),
        ("reply_exposed_second_pass", reply(6, Reply::Vat(VatReply::Exposed { id: second_pass(), duration_ms: 900 }))),
        ("reply_powder_state", reply(1, Reply::State(powder_state()))),
        ("reply_powder_moved", reply(9, Reply::Powder(PowderReply::Moved { position_um: 2200 }))),
        ("reply_recoated", reply(11, Reply::Powder(PowderReply::Recoated))),
        ("reply_marked", reply(10, Reply::Powder(marked))),
        ("reply_refused_13", reply(10, Reply::Refused(Refusal::NotRecoated))),
        ("reply_refused_14", reply(10, Reply::Refused(Refusal::WrongVector))),
        ("report_room", DeviceMessage::Report(Report::Room { taken_bytes: 49_152 })),
        ("reply_changed", reply(12, Reply::Vat(VatReply::Changed { vat: 2 }))),
        ("reply_vats_state", reply(1, Reply::State(vats_state(Some(2))))),
        ("reply_refused_15", reply(12, Reply::Refused(Refusal::NoSuchVat))),
    ]
}

#[test]
fn messages_have_their_golden_bytes() {
    let vectors = vectors();
    for (sequence, (name, message)) in (0..).zip(host_messages()) {
        let bytes = encode_frame(FrameKind::Data, SESSION, sequence, &encode_host_message(&message));
        assert_eq!(bytes, vectors[name], "{name}");
        assert_eq!(decode_host_message(&decode(&vectors[name]).payload), Ok(message), "{name}");
    }
    for (sequence, (name, message)) in (0..).zip(device_messages()) {
        let bytes = encode_frame(FrameKind::Data, SESSION, sequence, &encode_device_message(&message));
        assert_eq!(bytes, vectors[name], "{name}");
        assert_eq!(decode_device_message(&decode(&vectors[name]).payload), Ok(message), "{name}");
    }
}

#[test]
fn control_frames_have_their_golden_bytes() {
    let vectors = vectors();
    let check = |name: &str, kind, sequence, payload: Vec<u8>| {
        assert_eq!(encode_frame(kind, SESSION, sequence, &payload), vectors[name], "{name}");
        assert_eq!(decode(&vectors[name]), Frame { kind, session_id: SESSION, sequence, payload }, "{name}");
    };
    let hello = Hello { versions: VERSIONS, window_bytes: 8192, largest_frame_bytes: 1024 };
    check("hello", FrameKind::Hello, 0, hello.encode());
    assert_eq!(Hello::decode(&decode(&vectors["hello"]).payload), Ok(hello));
    let later = Hello { versions: VersionRange { lowest: 1, highest: 3 }, ..hello };
    check("hello_of_a_later_host", FrameKind::Hello, 0, [later.encode(), vec![0xAA, 0xBB]].concat());
    assert_eq!(Hello::decode(&decode(&vectors["hello_of_a_later_host"]).payload), Ok(later));
    for (name, capabilities, state) in [
        ("welcome", capabilities(), busy_state()),
        ("welcome_fresh", capabilities(), DeviceState::default()),
        ("welcome_powder", powder_capabilities(), powder_state()),
        ("welcome_vats", vats_capabilities(), vats_state(None)),
    ] {
        let welcome = Welcome { version: 1, capabilities, state };
        check(name, FrameKind::Welcome, 0, welcome.encode());
        assert_eq!(Welcome::decode(&decode(&vectors[name]).payload), Ok(welcome), "{name}");
    }
    let version = HelloRefused::Version { device: VERSIONS };
    for (name, refused) in [("hello_refused_version", version), ("hello_refused_limits", HelloRefused::Limits)] {
        check(name, FrameKind::HelloRefused, 0, refused.encode());
        assert_eq!(HelloRefused::decode(&decode(&vectors[name]).payload), Ok(refused), "{name}");
    }
    check("no_session", FrameKind::NoSession, 0, Vec::new());
    for (name, gap, last_heard, free_bytes) in [("ack", false, 16, 4096), ("ack_gap", true, 19, 2048)] {
        let ack = Ack { next_sequence: 17, gap, last_heard, free_bytes };
        check(name, FrameKind::Ack, 17, ack.encode());
        assert_eq!(Ack::decode(17, &decode(&vectors[name]).payload), Ok(ack), "{name}");
    }
    let urgents = [
        ("urgent_abort", Urgent::Abort),
        ("urgent_light_off", Urgent::LightOff),
        ("urgent_hold", Urgent::Hold),
        ("urgent_release", Urgent::Release),
    ];
    for (number, (name, urgent)) in (1..).zip(urgents) {
        check(name, FrameKind::Urgent, number, encode_urgent(urgent));
        assert_eq!(decode_urgent(&decode(&vectors[name]).payload), Ok(urgent), "{name}");
    }
    for (name, number, light_on) in [("urgent_done_dark", 1, false), ("urgent_done_light", 3, true)] {
        check(name, FrameKind::UrgentDone, number, UrgentDone { light_on }.encode());
        assert_eq!(UrgentDone::decode(&decode(&vectors[name]).payload), Ok(UrgentDone { light_on }), "{name}");
    }
}

#[test]
fn escaped_frames_have_their_golden_bytes() {
    let vectors = vectors();
    let (plain, escaped) = (&vectors["layer_data_flow_control"], &vectors["layer_data_flow_control_escaped"]);
    assert_eq!(&escape(plain), escaped);
    assert_eq!(decode_host_message(&decode(plain).payload), Ok(HostMessage::LayerData((0x0E..0x16).collect())));
}

#[test]
fn every_vector_is_checked() {
    // 17 control frames, 2 escaped ones; a vector that no test names would protect nothing.
    assert_eq!(vectors().len(), host_messages().len() + device_messages().len() + 17 + 2);
}

#[test]
fn the_document_says_what_every_vector_holds() {
    let document = include_str!("../docs/protocol.md");
    let (_, words) = document.split_once("## Vectors").expect("a section");
    for name in vectors().keys() {
        // The refusals up to 12 share a row.
        let refusal = name.strip_prefix("reply_refused_").and_then(|number| number.parse::<u8>().ok());
        let row = if refusal.is_some_and(|number| number <= 12) {
            "| `reply_refused_1` to `reply_refused_12` |".into()
        } else {
            format!("| `{name}` ")
        };
        assert!(words.contains(&row), "docs/protocol.md has no row for the vector {name}");
    }
}

/// Lines of the document such as `hello on the line 0601…` and `hello decoded 01 d4c3b2a1 …`: a vector's name and its bytes.
#[test]
fn the_bytes_in_the_document_are_those_of_the_vectors() {
    let vectors = vectors();
    let mut shown = Vec::new();
    for line in include_str!("../docs/protocol.md").lines().filter(|line| line.starts_with("    ")) {
        let (name, rest) = line.trim().split_once(' ').unwrap_or_default();
        let Some(frame) = vectors.get(name) else { continue };
        let (what, digits) = ["on the line", "decoded"]
            .iter()
            .find_map(|what| rest.trim().strip_prefix(what).map(|digits| (*what, digits)))
            .unwrap_or_else(|| panic!("what are these bytes? {line}"));
        let bytes = if what == "decoded" {
            let Frame { kind, session_id, sequence, payload } = decode(frame);
            let sequence = sequence.to_le_bytes();
            let body = [&[kind as u8][..], &session_id.to_le_bytes(), &sequence, &payload].concat();
            [&body[..], &crc32fast::hash(&body).to_le_bytes()].concat()
        } else {
            frame.clone()
        };
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(digits.replace(' ', ""), hex, "{line}");
        shown.push((name, what));
    }
    for name in ["hello", "welcome_fresh", "request_expose", "urgent_abort", "request_mark", "report_room"] {
        assert!(shown.contains(&(name, "on the line")) && shown.contains(&(name, "decoded")), "{name}: {shown:?}");
    }
}

/// The tables of requests, replies and refusals.
#[test]
fn the_codes_in_the_document_are_those_on_the_line() {
    let (vectors, document) = (vectors(), include_str!("../docs/protocol.md"));
    // A request's or reply's code follows the kind of message and the number; a refusal's code follows that.
    let code = |vector: &str, at: usize| decode(&vectors[vector]).payload[at];
    for (vector, name) in [
        ("request_state", "State"),
        ("request_layer_begin", "LayerBegin"),
        ("request_expose", "Expose"),
        ("request_home", "Home"),
        ("request_move", "Move"),
        ("reply_done", "Done"),
        ("reply_state", "State"),
        ("reply_refused_1", "Refused"),
        ("reply_exposed", "Exposed"),
        ("reply_moved", "Moved"),
        ("request_powder_home", "Home"),
        ("request_powder_move", "Move"),
        ("request_recoat", "Recoat"),
        ("request_mark", "Mark"),
        ("reply_powder_state", "State"),
        ("reply_powder_moved", "Moved"),
        ("reply_recoated", "Recoated"),
        ("reply_marked", "Marked"),
        ("request_change", "Change"),
        ("reply_changed", "Changed"),
        ("reply_vats_state", "State"),
    ] {
        let row = format!("| 0x{:02X} {name} ", code(vector, 5));
        assert!(document.contains(&row), "docs/protocol.md has no row {row}");
    }
    for number in 1..=15 {
        let row = format!("| {} ", code(&format!("reply_refused_{number}"), 6));
        let refusals = document.lines().skip_while(|line| !line.starts_with("| refusal "));
        assert!(refusals.take(17).any(|line| line.starts_with(&row)), "docs/protocol.md has no refusal {number}");
    }
}

#[test]
fn a_largest_welcome_fits_a_host_frame() {
    let mut capabilities = capabilities();
    capabilities.name = "ä".repeat(64);
    capabilities.encodings = vec![Encoding::RawBit; 99];
    capabilities.layer_slots = 16;
    let mut state = busy_state();
    state.slots = vec![Some(id(1)); 99];
    state.fault = Some(Fault { code: 1, text: "ö".repeat(500) });
    let of_powder = Welcome {
        version: 1,
        capabilities: Capabilities { machine: powder_capabilities().machine, ..capabilities.clone() },
        state: DeviceState { powder: powder_state().powder, ..state.clone() },
    };
    let of_vats = Welcome {
        version: 1,
        capabilities: Capabilities { machine: vats_capabilities().machine, ..capabilities.clone() },
        state: DeviceState { vats: vats_state(Some(2)).vats, ..state.clone() },
    };
    let welcome = Welcome { version: 1, capabilities, state };
    let frame = encode_frame(FrameKind::Welcome, SESSION, 0, &welcome.encode());
    // The document says 539, 546 with several vats, and 553 of powder machines; the rest of the limit is for kinds of machines to come.
    assert_eq!(welcome.encode().len(), payload_limit(539));
    assert_eq!(of_vats.encode().len(), payload_limit(546));
    assert_eq!(of_powder.encode().len(), payload_limit(553));
    assert!(frame.len() <= 539 && MIN_HOST_FRAME_BYTES == 640);
    let read = Welcome::decode(&decode(&frame).payload).expect("cut off at limits and characters");
    assert_eq!(read.capabilities.name, "ä".repeat(32));
    assert_eq!(read.state.slots.len(), 16);
}

#[test]
fn a_decoder_finds_the_next_frame_after_damage() {
    let good = encode_frame(FrameKind::Data, SESSION, 1, b"good");
    let mut damaged = good.clone();
    damaged[3] ^= 0x20;
    let cases = [
        (damaged, FrameError::Checksum),
        (vec![0x09, 1, 2, 0], FrameError::Malformed),
        (vec![7; 64].into_iter().chain([0]).collect(), FrameError::TooLong),
        (encode_frame(FrameKind::Data, SESSION, 1, &[1; 60]), FrameError::TooLong),
    ];
    for (bytes, error) in cases {
        let stream = [bytes, vec![0, 0], good.clone()].concat();
        let mut input = &stream[..];
        let mut decoder = FrameDecoder::new(64);
        assert_eq!(decoder.next_frame(&mut input), Some(Err(error)));
        let found = decoder.next_frame(&mut input).expect("a frame").expect("a good one");
        assert_eq!(found.frame.payload, b"good");
        assert_eq!(decoder.next_frame(&mut input), None);
    }
}

proptest! {
    #![proptest_config(properties::cases(200))]

    #[test]
    fn frames_come_back_whatever_they_hold_and_however_they_are_split(
        payloads in prop::collection::vec(prop::collection::vec(prop_oneof![Just(0_u8), Just(0x11), any::<u8>()], 0..600), 1..5),
        piece in 1_usize..700,
        escaped in any::<bool>(),
    ) {
        let frames: Vec<Vec<u8>> =
            payloads.iter().map(|payload| encode_frame(FrameKind::Data, 5, 6, payload)).collect();
        for (frame, payload) in frames.iter().zip(&payloads) {
            prop_assert!(payload_limit(frame.len()) <= payload.len(), "a limit never promises more than fits");
            let worst = encode_frame(FrameKind::Data, !0, !0, &vec![1; payload_limit(frame.len())]);
            prop_assert!(worst.len() <= frame.len());
        }
        let stream = if escaped { escape(&frames.concat()) } else { frames.concat() };
        prop_assert!(!escaped || !stream.iter().any(|byte| matches!(byte, 0x11 | 0x13)));
        let (mut decoder, mut unescaper) = (FrameDecoder::new(1024), Unescaper::default());
        let mut found = Vec::new();
        for bytes in stream.chunks(piece) {
            let mut plain = Vec::new();
            if escaped { unescaper.push(bytes, &mut plain) } else { plain.extend_from_slice(bytes) }
            let mut input = &plain[..];
            while let Some(Ok(Decoded { frame, .. })) = decoder.next_frame(&mut input) {
                found.push(frame.payload);
            }
        }
        prop_assert_eq!(found, payloads);
    }

    #[test]
    fn garbage_never_panics(bytes in prop::collection::vec(prop_oneof![Just(0_u8), Just(1), any::<u8>()], 0..2000)) {
        let mut decoder = FrameDecoder::new(128);
        let mut input = &bytes[..];
        while let Some(decoded) = decoder.next_frame(&mut input) {
            prop_assert!(decoded.map_or(true, |decoded| decoded.wire_bytes <= 128));
        }
        // As payloads: an answer or an error, and what is read is written back the same.
        if let Ok(message) = decode_host_message(&bytes) {
            prop_assert_eq!(encode_host_message(&message), bytes.clone());
        }
        if let Ok(message) = decode_device_message(&bytes) {
            prop_assert_eq!(encode_device_message(&message), bytes.clone());
        }
        let _ = (Welcome::decode(&bytes), Hello::decode(&bytes), HelloRefused::decode(&bytes));
        let _ = (Ack::decode(1, &bytes), decode_urgent(&bytes), UrgentDone::decode(&bytes));
    }
}
