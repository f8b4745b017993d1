//! Host and device sessions over a simulated line with a virtual clock and seeded faults.

mod link_pair;
mod properties;

use layerd::link::message::{DeviceMessage, DeviceState, HostMessage, Refusal, Reply, Request, Urgent};
use layerd::link::session::{HostEvent, HostSession, HostSettings, LostReason};
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings};
use layerd_wire::{
    FrameDecoder, FrameKind, Hello, HelloRefused, VERSIONS, VersionRange, Welcome, decode_device_message, encode_frame,
    encode_urgent,
};
use link_pair::{Faults, Pair, capabilities, queue};
use proptest::prelude::*;

/// An order that is unanswered, and light: the next session must not be delayed.
#[test]
fn a_session_is_pressing_while_an_urgent_order_is_open_or_there_is_light() {
    let mut pair = Pair::new(1, 115_200, 4096, 1024, Faults::default());
    pair.connect(1_000_000);
    assert!(!pair.host.is_pressing());
    for light_on in [true, false] {
        let number = pair.send_urgent(Urgent::Abort);
        assert!(pair.host.is_pressing() && pair.host.successor(9, pair.now_us).is_pressing());
        pair.run_for(50_000);
        pair.device.urgent_done(number, light_on);
        while !pair.host_events().iter().any(|event| matches!(event, HostEvent::UrgentDone { .. })) {
            pair.step();
        }
        assert_eq!((pair.host.is_pressing(), pair.host.successor(9, pair.now_us).is_pressing()), (light_on, light_on));
    }
}

/// Sends `count` pieces of layer data with a request after every tenth, while the device answers each request.
/// Returns when all are answered; panics once `limit_us` of virtual time have passed.
fn transfer(pair: &mut Pair, count: u32, limit_us: u64) {
    pair.connect(limit_us);
    let (mut next, mut number, mut answered, mut arrived) = (0_u32, 0_u32, 0_u32, 0_u32);
    while answered < count / 10 {
        assert!(pair.now_us < limit_us, "{next} sent, {arrived} arrived, {answered} answered at {} us", pair.now_us);
        while next < count {
            let mut piece = next.to_le_bytes().to_vec();
            // Lengths from 4 bytes to what fits, contents with zeros and with escapes.
            let length = 4 + (next as usize * 37) % (pair.host.largest_layer_data_bytes() - 3);
            piece.resize(length, (next % 20) as u8);
            if !queue(&mut pair.host, &HostMessage::LayerData(piece)) {
                break;
            }
            next += 1;
            if next.is_multiple_of(10) {
                number += 1;
                let request = HostMessage::Request { number, request: Request::State };
                pair.host.send(&request).expect("requests have room of their own");
            }
        }
        pair.step();
        for event in pair.device_events() {
            match event {
                DeviceEvent::Message(HostMessage::LayerData(piece)) => {
                    assert_eq!(piece[..4], arrived.to_le_bytes(), "in order, once");
                    assert!(piece[4..].iter().all(|&byte| u32::from(byte) == arrived % 20), "unharmed");
                    arrived += 1;
                }
                DeviceEvent::Message(HostMessage::Request { number, request: Request::State }) => {
                    assert_eq!(number * 10, arrived, "requests keep their place among the data");
                    let reply = DeviceMessage::Reply { number, reply: Reply::Done };
                    pair.device.send(&reply).expect("replies are few");
                }
                other => panic!("unexpected {other:?}"),
            }
        }
        for event in pair.host_events() {
            let HostEvent::Message(DeviceMessage::Reply { number, reply: Reply::Done }) = event else {
                panic!("unexpected {event:?}");
            };
            answered += 1;
            assert_eq!(number, answered, "replies in order, once");
        }
    }
    assert_eq!(arrived, count);
}

#[test]
fn a_clean_line_sends_nothing_twice_and_keeps_busy() {
    for (baud, window) in [(115_200, 4096), (3_000_000, 4096), (3_000_000, 1500), (9_600, 4096)] {
        let mut pair = Pair::new(1, baud, window, 1024, Faults::default());
        transfer(&mut pair, 400, 600_000_000);
        let statistics = pair.host.statistics();
        assert_eq!((statistics.retransmitted_frames, statistics.timeouts, statistics.fast_retransmits), (0, 0, 0));
        assert!(pair.peak_unread_bytes <= window as usize, "{} of {window}", pair.peak_unread_bytes);
    }
}

fn any_faults() -> impl Strategy<Value = Faults> {
    // Where three frames of ten are lost, one session in thousands rightly falls silent.
    let mixed = (0.0..0.1, 0.0..0.1, 0.0..0.5, 0_u64..20_000);
    prop_oneof![
        (0.0..0.2).prop_map(|lose| Faults { lose, ..Faults::default() }),
        (0.0..0.2).prop_map(|corrupt| Faults { corrupt, ..Faults::default() }),
        mixed.prop_map(|(lose, corrupt, duplicate, delay_us)| Faults { lose, corrupt, duplicate, delay_us }),
    ]
}

proptest! {
    #![proptest_config(properties::cases(60))]

    #[test]
    fn everything_arrives_once_and_in_order_whatever_the_line_does(
        faults in any_faults(),
        seed in any::<u64>(),
        window in 80_u32..8192,
        largest_frame_bytes in 64_u16..2048,
        baud in prop::sample::select(vec![115_200, 460_800, 3_000_000]),
        escaped in any::<bool>(),
    ) {
        let mut pair = Pair::new(seed, baud, window, largest_frame_bytes, faults);
        if escaped {
            pair.escape();
        }
        transfer(&mut pair, 200, 400_000_000);
        let peak = pair.host.statistics().peak_flight_bytes;
        prop_assert!(peak <= window.into(), "{peak} bytes in flight, the window is {window}");
    }

    #[test]
    fn losses_alone_never_put_more_on_the_line_than_the_device_has_room_for(
        seed in any::<u64>(),
        lose in 0.05..0.20,
        window in 512_u32..4096,
    ) {
        let mut pair = Pair::new(seed, 115_200, window, 256, Faults { lose, ..Faults::default() });
        transfer(&mut pair, 200, 200_000_000);
        prop_assert!(pair.peak_unread_bytes <= window as usize, "{} unread", pair.peak_unread_bytes);
        prop_assert!(pair.host.statistics().retransmitted_frames > 0);
    }
}

#[test]
fn escaped_lines_carry_no_flow_control_bytes() {
    let mut pair = Pair::new(3, 115_200, 4096, 512, Faults { lose: 0.05, ..Faults::default() });
    pair.escape();
    transfer(&mut pair, 300, 200_000_000);
    assert!(!pair.saw_flow_control, "0x11 or 0x13 on the line");
}

#[test]
fn urgent_frames_are_answered_within_100_ms_on_a_saturated_line() {
    for baud in [115_200, 3_000_000] {
        let mut pair = Pair::new(5, baud, 4096, 1024, Faults::default());
        pair.connect(1_000_000);
        let mut worst_us = 0;
        for round in 0..30 {
            // Saturates the line, then asks at a moment that shifts against the frames.
            let begin_us = pair.now_us + 150_000 + round * 1_371;
            let mut asked = None;
            loop {
                let piece = HostMessage::LayerData(vec![0xA5; pair.host.largest_layer_data_bytes()]);
                while queue(&mut pair.host, &piece) {}
                if asked.is_none() && pair.now_us >= begin_us {
                    asked = Some((pair.send_urgent(Urgent::LightOff), pair.now_us));
                }
                pair.step();
                for event in pair.device_events() {
                    if let DeviceEvent::Urgent { number, urgent } = event {
                        assert_eq!(urgent, Urgent::LightOff);
                        pair.device.urgent_done(number, false);
                    }
                }
                let done = pair.host_events().into_iter().find_map(|event| match event {
                    HostEvent::UrgentDone { number, light_on: false } => Some(number),
                    _ => None,
                });
                if let (Some(done), Some((number, at_us))) = (done, asked) {
                    assert_eq!(done, number);
                    worst_us = worst_us.max(pair.now_us - at_us);
                    break;
                }
            }
        }
        assert!(worst_us <= 100_000, "{worst_us} us at {baud} baud");
        eprintln!("urgent answered within {worst_us} us at {baud} baud");
    }
}

#[test]
fn urgent_frames_survive_loss_and_are_carried_out_once() {
    let mut pair = Pair::new(8, 3_000_000, 4096, 512, Faults { lose: 0.30, duplicate: 0.30, ..Faults::default() });
    pair.connect(10_000_000);
    let (mut carried_out, mut answered) = (Vec::new(), Vec::new());
    for urgent in [Urgent::Hold, Urgent::LightOff, Urgent::Release] {
        let number = pair.send_urgent(urgent);
        let give_up_us = pair.now_us + 1_500_000;
        while !answered.contains(&number) && pair.now_us < give_up_us {
            pair.step();
            for event in pair.device_events() {
                if let DeviceEvent::Urgent { number, urgent } = event {
                    carried_out.push(urgent);
                    pair.device.urgent_done(number, false);
                }
            }
            for event in pair.host_events() {
                if let HostEvent::UrgentDone { number, .. } = event {
                    answered.push(number);
                }
            }
        }
    }
    assert_eq!(carried_out, [Urgent::Hold, Urgent::LightOff, Urgent::Release]);
    assert_eq!(answered, [1, 2, 3]);
}

#[test]
fn an_answered_abort_ends_what_was_ordered_before_it() {
    let mut pair = Pair::new(4, 115_200, 4096, 512, Faults::default());
    pair.connect(1_000_000);
    pair.send_urgent(Urgent::Abort);
    let second = pair.send_urgent(Urgent::Abort);
    // The answer to the first is lost.
    while !pair
        .device_events()
        .iter()
        .any(|event| matches!(event, DeviceEvent::Urgent { number, .. } if *number == second))
    {
        pair.step();
    }
    pair.device.urgent_done(second, false);
    pair.run_for(50_000);
    assert_eq!(pair.host_events(), [HostEvent::UrgentDone { number: second, light_on: false }]);
    pair.host = pair.host.successor(77, pair.now_us);
    pair.connect(pair.now_us + 1_000_000);
    pair.run_for(200_000);
    assert!(pair.device_events().is_empty(), "nothing old is sent in the next session");
}

#[test]
fn silence_ends_the_session_at_both_ends_and_a_successor_starts_another() {
    let mut pair = Pair::new(2, 115_200, 4096, 512, Faults::default());
    pair.connect(1_000_000);
    pair.run_for(10_000_000);
    assert!(pair.host_events().is_empty() && pair.device_events().is_empty(), "heartbeats keep an idle session");
    pair.cut = true;
    let cut_us = pair.now_us;
    let number = pair.send_urgent(Urgent::Abort);
    pair.run_for(1_400_000);
    assert!(pair.host_events().is_empty() && pair.device_events().is_empty(), "not before two seconds");
    pair.run_for(700_000);
    assert_eq!(pair.host_events(), [HostEvent::Lost(LostReason::Silent)]);
    assert_eq!(pair.device_events(), [DeviceEvent::HostSilent]);
    assert!(pair.now_us - cut_us < 2_200_000);
    pair.run_for(5_000_000);
    assert!(pair.device_events().is_empty(), "silence is told once");
    pair.cut = false;
    pair.host = pair.host.successor(77, pair.now_us);
    pair.connect(pair.now_us + 1_000_000);
    pair.run_for(50_000);
    let urgent = DeviceEvent::Urgent { number, urgent: Urgent::Abort };
    assert_eq!(pair.device_events(), [urgent], "an unanswered abort goes over to the next session");
}

#[test]
fn a_device_that_forgot_the_session_says_so_at_once() {
    let mut pair = Pair::new(2, 115_200, 4096, 512, Faults::default());
    pair.connect(1_000_000);
    pair.reset_device();
    pair.host.send(&HostMessage::LayerData(vec![1, 2, 3])).expect("connected");
    pair.run_for(50_000);
    assert_eq!(pair.host_events(), [HostEvent::Lost(LostReason::DeviceForgot)]);
    assert!(pair.device_events().is_empty(), "data of an unknown session is not delivered");
}

#[test]
fn a_delayed_hello_does_not_bring_an_old_session_back() {
    let mut pair = Pair::new(2, 115_200, 4096, 512, Faults::default());
    let settings = HostSettings { baud: 115_200, escaped: false };
    let old_hello = HostSession::new(pair.host.session_id(), settings, 0).transmit(0).expect("hello");
    pair.connect(1_000_000);
    // Of the session that runs: changes nothing.
    pair.device.receive(&old_hello, pair.now_us);
    assert!(pair.device_events().is_empty());
    pair.host = pair.host.successor(99, pair.now_us);
    pair.connect(2_000_000);
    // Of the one before.
    pair.device.receive(&old_hello, pair.now_us);
    pair.run_for(3_000_000);
    assert!(pair.device_events().is_empty() && pair.host_events().is_empty());
    assert!(pair.host.is_connected());
}

#[test]
fn nobody_there_and_garbage_are_told_apart() {
    let settings = HostSettings { baud: 115_200, escaped: false };
    let mut host = HostSession::new(1, settings, 0);
    let mut hellos = 0;
    for now_us in (0..2_000_000).step_by(10_000) {
        hellos += usize::from(host.transmit(now_us).is_some());
        host.handle_timeout(now_us);
        assert_eq!(host.event(), None, "not before two seconds");
    }
    host.handle_timeout(2_000_000);
    assert_eq!(host.event(), Some(HostEvent::Lost(LostReason::NoAnswer { garbage_frames: 0 })));
    assert_eq!(hellos, 8, "one each 250 ms");
    let mut host = HostSession::new(1, settings, 0);
    host.receive(b"\0ok T:20\n\0Marlin ready\0", 1_000);
    host.handle_timeout(2_000_000);
    assert_eq!(host.event(), Some(HostEvent::Lost(LostReason::NoAnswer { garbage_frames: 2 })));
    assert_eq!(host.next_timeout_us(), None);
}

#[test]
fn a_device_that_takes_nothing_is_not_overrun() {
    let mut pair = Pair::new(4, 3_000_000, 1024, 256, Faults { lose: 0.05, ..Faults::default() });
    pair.connect(5_000_000);
    let mut sent = 0_u32;
    for _ in 0..3_000 {
        loop {
            let mut piece = sent.to_le_bytes().to_vec();
            piece.resize(200, 7);
            if !queue(&mut pair.host, &HostMessage::LayerData(piece)) {
                break;
            }
            sent += 1;
        }
        pair.step();
    }
    // The owner took no event: what was received fits the window.
    let mut arrived = 0_u32;
    while let Some(DeviceEvent::Message(HostMessage::LayerData(piece))) = pair.device.event() {
        assert_eq!(piece[..4], arrived.to_le_bytes());
        arrived += 1;
    }
    assert!(arrived > 0 && arrived as usize * 200 <= 1024, "{arrived} pieces of 200 bytes held");
    // Now it takes all: everything queued arrives.
    let limit_us = pair.now_us + 20_000_000;
    while arrived < sent {
        assert!(pair.now_us < limit_us, "{arrived} of {sent}");
        pair.step();
        for event in pair.device_events() {
            let DeviceEvent::Message(HostMessage::LayerData(piece)) = event else { panic!("unexpected {event:?}") };
            assert_eq!(piece[..4], arrived.to_le_bytes());
            arrived += 1;
        }
    }
}

#[test]
fn limits_of_a_device_are_kept() {
    let mut pair = Pair::new(4, 115_200, 100, 4096, Faults::default());
    pair.connect(1_000_000);
    let limit = pair.host.largest_layer_data_bytes();
    assert!(limit < 100, "a frame is no larger than the window");
    let error = pair.host.send(&HostMessage::LayerData(vec![0; limit + 1])).expect_err("too large");
    assert_eq!(
        error.to_string(),
        format!("a message of {} bytes does not fit a frame, which takes {}", limit + 2, limit + 1)
    );
    assert_eq!(capabilities(100, 4096).window_bytes, 100);
}

#[test]
fn a_request_that_cannot_be_read_is_answered_by_its_number_and_delivered_to_nobody() {
    let frame = |kind, sequence, payload: &[u8]| encode_frame(kind, 7, sequence, payload);
    let mut device = DeviceSession::new(capabilities(4096, 1024), DeviceSettings { baud: 115_200, escaped: false }, 0);
    let hello = Hello { versions: VERSIONS, window_bytes: 8192, largest_frame_bytes: 1024 };
    device.receive(&frame(FrameKind::Hello, 0, &hello.encode()), 0);
    assert!(matches!(device.event(), Some(DeviceEvent::Hello { .. })));
    device.welcome(&DeviceState::default(), 0);
    // Unknown; too short; too long; a layer in an encoding that nobody knows.
    let begin = [&[1, 4, 0, 0, 0, 2, 0][..], &[0; 13], &[9], &[1, 0, 0, 0], &[0; 4]].concat();
    let requests = [&[1, 1, 0, 0, 0, 77][..], &[1, 2, 0, 0, 0, 0x22, 1], &[1, 3, 0, 0, 0, 0x21, 0], &begin];
    for (sequence, request) in (0..).zip(requests) {
        device.receive(&frame(FrameKind::Data, sequence, request), 1000);
        assert_eq!(device.event(), None, "{request:?}");
    }
    let (mut decoder, mut replies) = (FrameDecoder::new(1024), Vec::new());
    while let Some(bytes) = device.transmit(10_000) {
        let mut input = &bytes[..];
        while let Some(Ok(decoded)) = decoder.next_frame(&mut input) {
            if decoded.frame.kind == FrameKind::Data {
                replies.push(decode_device_message(&decoded.frame.payload).expect("a reply"));
            }
        }
    }
    let unknown = |number| DeviceMessage::Reply { number, reply: Reply::Refused(Refusal::Unknown) };
    assert_eq!(replies, (1..=4).map(unknown).collect::<Vec<_>>());
}

#[test]
fn a_device_answers_a_hello_with_the_highest_version_that_both_speak() {
    let hello = |lowest, highest| Hello {
        versions: VersionRange { lowest, highest },
        window_bytes: 8192,
        largest_frame_bytes: 1024,
    };
    let answer_to = |payload: &[u8]| {
        let settings = DeviceSettings { baud: 115_200, escaped: false };
        let mut device = DeviceSession::new(capabilities(4096, 1024), settings, 0);
        device.receive(&encode_frame(FrameKind::Hello, 7, 0, payload), 0);
        while device.event().is_some() {
            device.welcome(&DeviceState::default(), 0);
        }
        let bytes = device.transmit(0).expect("an answer");
        FrameDecoder::new(1024).next_frame(&mut &bytes[..]).expect("a frame").expect("a good one").frame
    };
    // A host of a later version may append what this device does not know.
    for payload in [hello(1, 1).encode(), [hello(1, 9).encode(), vec![7; 40]].concat(), hello(0, 1).encode()] {
        let answer = answer_to(&payload);
        assert_eq!(answer.kind, FrameKind::Welcome);
        assert_eq!(Welcome::decode(&answer.payload).expect("a welcome").version, 1);
    }
    for payload in [hello(2, 9).encode(), hello(0, 0).encode(), hello(2, 1).encode()] {
        let answer = answer_to(&payload);
        assert_eq!(answer.kind, FrameKind::HelloRefused);
        assert_eq!(HelloRefused::decode(&answer.payload), Ok(HelloRefused::Version { device: VERSIONS }));
    }
}

#[test]
fn an_urgent_frame_outside_the_session_is_not_carried_out() {
    let settings = DeviceSettings { baud: 115_200, escaped: false };
    let mut device = DeviceSession::new(capabilities(4096, 1024), settings, 0);
    let hello = Hello { versions: VERSIONS, window_bytes: 8192, largest_frame_bytes: 1024 };
    let answered = |device: &mut DeviceSession, now_us| {
        let mut answers = Vec::new();
        while let Some(bytes) = device.transmit(now_us) {
            let decoded = FrameDecoder::new(1024).next_frame(&mut &bytes[..]).expect("a frame").expect("a good one");
            answers.push((decoded.frame.kind, decoded.frame.session_id));
        }
        answers
    };
    for urgent in [Urgent::Abort, Urgent::LightOff] {
        let now_us = 100_000 * urgent as u64;
        device.receive(&encode_frame(FrameKind::Urgent, 9, 1, &encode_urgent(urgent)), now_us);
        assert_eq!(device.event(), None, "{urgent:?}");
        assert_eq!(answered(&mut device, now_us), [(FrameKind::NoSession, 9)], "{urgent:?} without a session");
    }
    device.receive(&encode_frame(FrameKind::Hello, 7, 0, &hello.encode()), 300_000);
    while device.event().is_some() {
        device.welcome(&DeviceState::default(), 300_000);
    }
    assert_eq!(answered(&mut device, 300_000)[0], (FrameKind::Welcome, 7));
    device.receive(&encode_frame(FrameKind::Urgent, 9, 1, &encode_urgent(Urgent::Abort)), 300_000);
    assert_eq!(device.event(), None);
    assert!(answered(&mut device, 300_000).contains(&(FrameKind::NoSession, 9)), "of another session");
}

#[test]
fn the_retransmission_time_lies_between_its_bounds_at_every_rate() {
    // Rate, window, and the time of the first retransmission: twice 25 ms and the line time of what is put in flight, at most
    // 500 ms. In flight is at most 250 ms of line time, but at least a frame, which lasts 20 ms here or has 64 bytes.
    let cases = [
        (3_000_000, 4096, 2 * (25_000 + 13_654)),
        (3_000_000, 60_000, 2 * (25_000 + 200_000)),
        (115_200, 256, 2 * (25_000 + 22_223)),
        (115_200, 8192, 500_000),
        (9_600, 64, 2 * (25_000 + 66_667)),
        (9_600, 8192, 500_000),
    ];
    for (baud, window_bytes, expected_us) in cases {
        let mut pair = Pair::new(1, baud, window_bytes, 1024, Faults::default());
        pair.connect(5_000_000);
        pair.run_for(1_000_000);
        pair.host.send(&HostMessage::Request { number: 1, request: Request::State }).expect("room");
        let begin_us = pair.now_us;
        let mut host = pair.host;
        while host.transmit(begin_us).is_some() {}
        // Nothing is acknowledged.
        let sent = host.statistics().retransmitted_frames;
        let mut now_us = begin_us;
        while host.statistics().retransmitted_frames == sent {
            now_us += 500;
            assert!(now_us < begin_us + 1_500_000, "{baud} baud, window {window_bytes}");
            host.handle_timeout(now_us);
            while host.transmit(now_us).is_some() {}
        }
        let found_us = now_us - begin_us;
        assert!(found_us.abs_diff(expected_us) <= 500, "{baud} baud, window {window_bytes}: {found_us} us");
    }
}
