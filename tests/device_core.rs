//! The firmware of the simulated DLP under virtual time: what it refuses, and when there is light.

mod device_common;
mod properties;

use device_common::{Bench, capabilities, id, picture};
use layerd::device::encoding::{encode, picture_crc32};
use layerd::link::message::{
    Encoding, ExposureId, Fault, HostMessage, MachineCapabilities, Refusal, Reply, Request, Urgent, VatCapabilities,
    VatReply, VatRequest,
};
use proptest::prelude::*;

#[test]
fn an_exposure_shines_for_its_time_and_is_written_before_it_is_reported() {
    let mut bench = Bench::new();
    bench.upload(0, id(0));
    let number = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1500, light_pwm: 255 }));
    assert!(bench.core.state().light_on);
    assert_eq!(bench.core.state().exposing, Some(id(0)));
    bench.advance(1_499_999);
    assert!(bench.core.state().light_on, "not a microsecond too short");
    // Asked late, the device has still switched off in time.
    bench.advance(700_001);
    assert_eq!(bench.reply(number), Some(Reply::Vat(VatReply::Exposed { id: id(0), duration_ms: 1500 })));
    assert_eq!(bench.events(), ["hello", "light_on", "light_off", "exposed"]);
    assert_eq!(bench.records[3].t_ms - bench.records[1].t_ms, 1500);
    assert_eq!(bench.pictures, [(0, picture(0))]);
    let state = bench.core.state();
    assert_eq!((state.last_exposed, state.light_on, state.slots), (Some(id(0)), false, vec![None, None]));
}

#[test]
fn what_must_not_be_exposed_is_refused_and_stays_dark() {
    let mut bench = Bench::new();
    bench.upload(0, id(3));
    bench.expose(id(3), 100);
    bench.upload(0, id(3));
    bench.upload(1, id(4));
    let expose = |id, duration_ms, light_pwm| Request::Vat(VatRequest::Expose { id, duration_ms, light_pwm });
    let cases = [
        (expose(id(3), 100, 255), Refusal::AlreadyExposed),
        (expose(id(2), 100, 255), Refusal::AlreadyExposed),
        (expose(id(4), 0, 255), Refusal::BadDuration),
        (expose(id(4), 100, 0), Refusal::BadDuration),
        (expose(id(4), capabilities().max_exposure_ms + 1, 255), Refusal::BadDuration),
        (expose(id(5), 100, 255), Refusal::NoSuchLayer),
    ];
    for (request, refusal) in cases {
        let number = bench.request(request);
        assert_eq!(bench.reply(number), Some(Reply::Refused(refusal)), "{request:?}");
        assert!(!bench.core.state().light_on);
    }
    assert_eq!(bench.core.statistics().refused, 6);
    // The same layer number of another job is another exposure.
    let mut other = id(0);
    other.job += 1;
    bench.upload(0, other);
    bench.expose(other, 100);
    assert_eq!(bench.core.state().last_exposed, Some(other));
}

#[test]
fn the_plate_moves_only_homed_inside_its_travel_and_in_the_dark() {
    let mut bench = Bench::new();
    let go = |position_um, speed_um_s| Request::Vat(VatRequest::Move { position_um, speed_um_s });
    let number = bench.request(go(1000, 1000));
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::NotHomed)));
    let home = bench.request(Request::Vat(VatRequest::Home));
    let state = bench.core.state();
    assert_eq!((state.position_um, state.moving), (None, true), "before its end the first homing knows no position");
    bench.advance(10_000_000);
    assert_eq!(bench.reply(home), Some(Reply::Vat(VatReply::Moved { position_um: 0 })));
    let MachineCapabilities::Vat(VatCapabilities { max_position_um, .. }) = capabilities().machine;
    for wrong in [go(-1, 1000), go(max_position_um + 1, 1000), go(1000, 0)] {
        let number = bench.request(wrong);
        assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::BadMove)));
    }
    let lift = bench.request(go(5000, 1000));
    bench.advance(2_500_000);
    let state = bench.core.state();
    assert_eq!((state.position_um, state.moving), (Some(2500), true));
    bench.upload(0, id(0));
    let expose = Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1000, light_pwm: 255 });
    let number = bench.request(expose);
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::Busy)), "no light while the plate moves");
    bench.advance(2_500_000);
    assert_eq!(bench.reply(lift), Some(Reply::Vat(VatReply::Moved { position_um: 5000 })));
    bench.request(expose);
    let number = bench.request(go(0, 1000));
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::Busy)), "no move while there is light");
    let here = bench.request(Request::State);
    assert!(matches!(bench.reply(here), Some(Reply::State(state)) if state.light_on));
}

#[test]
fn a_damaged_or_misplaced_layer_is_refused() {
    let mut bench = Bench::new();
    let mut bytes = Vec::new();
    encode(&picture(0), Encoding::Group4, &mut bytes).expect("bits");
    let begin = |slot, encoding, encoded_bytes, decoded_crc32| Request::LayerBegin {
        slot,
        id: id(0),
        encoding,
        encoded_bytes,
        decoded_crc32,
    };
    let crc32 = picture_crc32(&picture(0));
    let length = bytes.len() as u32;
    let cases = [
        (begin(2, Encoding::Group4, length, crc32), Refusal::NoSuchLayer),
        (begin(0, Encoding::RawGrey, length, crc32), Refusal::BadEncoding),
        (begin(0, Encoding::Group4, 0, crc32), Refusal::BadLayer),
        (begin(0, Encoding::Group4, length, crc32 ^ 1), Refusal::BadLayer),
        (begin(0, Encoding::Group4, length - 1, crc32), Refusal::BadLayer),
        (begin(0, Encoding::RawBit, length, crc32), Refusal::BadLayer),
    ];
    for (request, refusal) in cases {
        let number = bench.request(request);
        bench.data(&bytes);
        assert_eq!(bench.reply(number), Some(Reply::Refused(refusal)), "{request:?}");
        assert_eq!(bench.core.state().slots, [None, None]);
    }
    // A raw layer of a wrong length is refused where that shows: by what goes beyond the picture, or at its end.
    let mut raw = Vec::new();
    encode(&picture(0), Encoding::RawBit, &mut raw).expect("bits");
    let whole = raw.len() as u32;
    let long = bench.request(begin(0, Encoding::RawBit, whole + 9, crc32));
    bench.data(&raw);
    assert_eq!(bench.reply(long), None, "all of it is within the picture");
    bench.data(&[0]);
    assert_eq!(bench.reply(long), Some(Reply::Refused(Refusal::BadLayer)));
    let short = bench.request(begin(0, Encoding::RawBit, whole - 1, crc32));
    bench.data(&raw[..raw.len() - 2]);
    assert_eq!(bench.reply(short), None, "it is not over");
    bench.data(&raw[raw.len() - 2..raw.len() - 1]);
    assert_eq!(bench.reply(short), Some(Reply::Refused(Refusal::BadLayer)));
    // A layer that is given up for another is not whole; the other one is taken.
    let first = bench.request(begin(0, Encoding::Group4, length, crc32));
    bench.data(&bytes[..3]);
    bench.upload(1, id(0));
    assert_eq!(bench.reply(first), Some(Reply::Refused(Refusal::BadLayer)));
    assert_eq!(bench.core.state().slots, [None, Some(id(0))]);
    // The slot that shines takes nothing, the other one does.
    bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1000, light_pwm: 1 }));
    let number = bench.request(begin(1, Encoding::Group4, length, crc32));
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::SlotBusy)));
    bench.upload(0, id(1));
}

#[test]
fn an_abort_is_dark_at_once_and_lasts_until_a_hello() {
    let mut bench = Bench::new();
    bench.upload(0, id(0));
    bench.upload(1, id(1));
    let shining = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1000, light_pwm: 255 }));
    bench.advance(400_000);
    assert!(!bench.urgent(Urgent::Abort));
    assert_eq!(bench.reply(shining), Some(Reply::Refused(Refusal::CutShort)));
    let state = bench.core.state();
    assert_eq!((state.light_on, state.cut_short), (false, Some((id(0), 400))));
    assert_eq!((state.slots, state.last_exposed), (vec![None, None], None));
    let home = bench.request(Request::Vat(VatRequest::Home));
    assert_eq!(bench.reply(home), Some(Reply::Refused(Refusal::NotReady)));
    bench.advance(5_000_000);
    assert!(bench.pictures.is_empty(), "what was cut short is not exposed");
    // Then the plate can be lifted.
    bench.hello();
    let home = bench.request(Request::Vat(VatRequest::Home));
    bench.advance(5_000_000);
    assert_eq!(bench.reply(home), Some(Reply::Vat(VatReply::Moved { position_um: 0 })));
    let lift = bench.request(Request::Vat(VatRequest::Move { position_um: 60_000, speed_um_s: 1000 }));
    bench.advance(1_000_000);
    assert!(!bench.urgent(Urgent::Abort));
    assert_eq!(bench.reply(lift), Some(Reply::Refused(Refusal::CutShort)));
    assert_eq!((bench.core.state().position_um, bench.core.state().moving), (Some(1000), false));
}

#[test]
fn light_off_cuts_short_and_work_goes_on() {
    let mut bench = Bench::new();
    bench.upload(0, id(0));
    bench.upload(1, id(1));
    let shining = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1000, light_pwm: 255 }));
    bench.advance(250_000);
    assert!(!bench.urgent(Urgent::LightOff));
    assert_eq!(bench.reply(shining), Some(Reply::Refused(Refusal::CutShort)));
    assert_eq!(bench.core.state().cut_short, Some((id(0), 250)));
    bench.expose(id(1), 100);
}

#[test]
fn a_hold_lets_what_runs_end_and_the_next_begin_only_after_the_release() {
    let mut bench = Bench::new();
    bench.upload(0, id(0));
    bench.upload(1, id(1));
    let first = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1000, light_pwm: 255 }));
    assert!(bench.urgent(Urgent::Hold), "a hold leaves the light on");
    bench.advance(1_000_000);
    assert!(matches!(bench.reply(first), Some(Reply::Vat(VatReply::Exposed { .. }))));
    let second = bench.request(Request::Vat(VatRequest::Expose { id: id(1), duration_ms: 1000, light_pwm: 255 }));
    let third = bench.request(Request::Vat(VatRequest::Home));
    assert_eq!(bench.reply(third), Some(Reply::Refused(Refusal::Busy)), "one request waits, not more");
    bench.advance(60_000_000);
    assert!(!bench.core.state().light_on && bench.reply(second).is_none());
    assert!(bench.urgent(Urgent::Release));
    bench.advance(1_000_000);
    assert!(matches!(bench.reply(second), Some(Reply::Vat(VatReply::Exposed { .. }))));
}

#[test]
fn a_silent_host_lets_the_exposure_end_and_nothing_begin() {
    let mut bench = Bench::new();
    bench.upload(0, id(0));
    bench.upload(1, id(1));
    let shining = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 3000, light_pwm: 255 }));
    bench.advance(2_000_000);
    bench.silence();
    assert!(bench.core.state().light_on, "once begun, an exposure ends by the device's clock");
    bench.advance(1_000_000);
    assert!(!bench.core.state().light_on);
    assert_eq!(bench.reply(shining), None, "that session has ended");
    let number = bench.request(Request::Vat(VatRequest::Expose { id: id(1), duration_ms: 10, light_pwm: 255 }));
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::NotReady)));
    let state = bench.hello();
    assert_eq!((state.last_exposed, state.exposing, state.slots), (Some(id(0)), None, vec![None, Some(id(1))]));
    assert_eq!(bench.events(), ["hello", "light_on", "host_silent", "light_off", "exposed", "refused", "hello"]);
    bench.expose(id(1), 10);
}

#[test]
fn a_reset_forgets_all_but_what_was_exposed_and_where_the_plate_rests() {
    let mut bench = Bench::new();
    bench.upload(0, id(0));
    bench.expose(id(0), 100);
    bench.upload(0, id(1));
    bench.upload(1, id(2));
    let home = bench.request(Request::Vat(VatRequest::Home));
    bench.advance(5_000_000);
    assert!(bench.reply(home).is_some());
    bench.request(Request::Vat(VatRequest::Expose { id: id(1), duration_ms: 1000, light_pwm: 255 }));
    bench.advance(300_000);
    let boot_id = bench.core.state().boot_id;
    bench.reset(boot_id + 1);
    assert!(!bench.core.state().light_on);
    let state = bench.hello();
    assert_eq!((state.boot_id, state.last_exposed), (boot_id + 1, Some(id(0))));
    assert_eq!((state.cut_short, state.slots, state.position_um), (Some((id(1), 300)), vec![None, None], Some(0)));
    bench.upload(0, id(0));
    let again = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 100, light_pwm: 255 }));
    assert_eq!(bench.reply(again), Some(Reply::Refused(Refusal::AlreadyExposed)), "nothing is exposed twice");
    bench.request(Request::Vat(VatRequest::Move { position_um: 5000, speed_um_s: 1000 }));
    bench.advance(1_000_000);
    bench.reset(boot_id + 2);
    assert_eq!(bench.hello().position_um, None, "a plate in motion is lost");
}

#[test]
fn a_fault_is_dark_and_reported() {
    let mut bench = Bench::new();
    bench.upload(0, id(0));
    bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1000, light_pwm: 255 }));
    let fault = Fault { code: 9, text: "door open".into() };
    bench.fault(Some(fault.clone()));
    assert_eq!((bench.core.state().light_on, bench.core.state().fault), (false, Some(fault.clone())));
    assert_eq!(bench.faults, [Some(fault)]);
    let number = bench.request(Request::Vat(VatRequest::Home));
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::NotReady)));
    bench.fault(None);
    assert!(bench.request(Request::Vat(VatRequest::Home)) > number && bench.core.state().moving);
}

/// A device with layer 1 exposed, layer 2 in slot 0, and homed.
fn busy_bench() -> Bench {
    let mut bench = Bench::new();
    let home = bench.request(Request::Vat(VatRequest::Home));
    bench.advance(5_000_000);
    assert_eq!(bench.reply(home), Some(Reply::Vat(VatReply::Moved { position_um: 0 })));
    bench.upload(0, id(1));
    bench.expose(id(1), 100);
    bench.upload(0, id(2));
    bench
}

fn fault() -> Option<Fault> {
    Some(Fault { code: 9, text: "door open".into() })
}

fn refused_with(bench: &mut Bench, request: &Request, refusal: Refusal, when: &str) {
    let number = bench.request(*request);
    assert_eq!(bench.reply(number), Some(Reply::Refused(refusal)), "{when}: {request:?}");
}

/// In each row everything that would refuse a later row applies as well.
#[test]
fn of_several_refusals_the_first_in_the_documents_order_wins() {
    let begin = |slot, encoding, encoded_bytes| Request::LayerBegin {
        slot,
        id: id(3),
        encoding,
        encoded_bytes,
        decoded_crc32: 0,
    };
    let rows = [
        (begin(9, Encoding::RawGrey, 0), Refusal::NoSuchLayer),
        (begin(0, Encoding::RawGrey, 0), Refusal::SlotBusy),
        (begin(1, Encoding::RawGrey, 0), Refusal::BadEncoding),
        (begin(1, Encoding::Group4, 0), Refusal::BadLayer),
    ];
    let mut bench = busy_bench();
    bench.request(Request::Vat(VatRequest::Expose { id: id(2), duration_ms: 1000, light_pwm: 255 }));
    for (request, refusal) in rows {
        // Each also ends the layer on its way, which is told first.
        let on_its_way = bench.request(begin(1, Encoding::Group4, 500));
        refused_with(&mut bench, &request, refusal, "while a layer shines");
        assert_eq!(bench.reply(on_its_way), Some(Reply::Refused(Refusal::BadLayer)));
        let order: Vec<u32> = bench.replies.iter().rev().take(2).map(|(number, _)| *number).collect();
        assert_eq!(order, [on_its_way + 1, on_its_way]);
    }
    bench.fault(fault());
    refused_with(&mut bench, &begin(9, Encoding::RawGrey, 0), Refusal::NotReady, "fault");

    let expose = |layer, duration_ms| Request::Vat(VatRequest::Expose { id: id(layer), duration_ms, light_pwm: 255 });
    let mut bench = busy_bench();
    bench.request(Request::Vat(VatRequest::Move { position_um: 50_000, speed_um_s: 1000 }));
    refused_with(&mut bench, &expose(0, 0), Refusal::Busy, "moving");
    refused_with(
        &mut bench,
        &Request::Vat(VatRequest::Move { position_um: -1, speed_um_s: 0 }),
        Refusal::Busy,
        "moving",
    );
    refused_with(&mut bench, &Request::Vat(VatRequest::Home), Refusal::Busy, "moving");
    bench.fault(fault());
    for request in [
        expose(0, 0),
        Request::Vat(VatRequest::Move { position_um: -1, speed_um_s: 0 }),
        Request::Vat(VatRequest::Home),
    ] {
        refused_with(&mut bench, &request, Refusal::NotReady, "fault");
    }
    bench.fault(None);
    refused_with(&mut bench, &expose(0, 0), Refusal::BadDuration, "exposed before, in no slot, no time");
    refused_with(&mut bench, &expose(0, 100), Refusal::AlreadyExposed, "exposed before, in no slot");
    refused_with(&mut bench, &expose(5, 100), Refusal::NoSuchLayer, "in no slot");
    let mut bench = Bench::new();
    let home = bench.request(Request::Vat(VatRequest::Home));
    refused_with(
        &mut bench,
        &Request::Vat(VatRequest::Move { position_um: -1, speed_um_s: 0 }),
        Refusal::Busy,
        "homing",
    );
    assert!(!bench.urgent(Urgent::Abort) && bench.reply(home).is_some());
    refused_with(
        &mut bench,
        &Request::Vat(VatRequest::Move { position_um: -1, speed_um_s: 0 }),
        Refusal::NotReady,
        "aborted",
    );
    bench.hello();
    refused_with(
        &mut bench,
        &Request::Vat(VatRequest::Move { position_um: -1, speed_um_s: 0 }),
        Refusal::NotHomed,
        "not homed",
    );
}

#[test]
fn the_passes_of_a_layer_are_exposed_in_ascending_order_and_each_only_once() {
    let pass = |layer, pass| ExposureId { pass, ..id(layer) };
    let mut bench = Bench::new();
    bench.upload(0, pass(0, 0));
    bench.expose(pass(0, 0), 100);
    bench.upload(0, pass(0, 2));
    let wrong = Request::Vat(VatRequest::Expose { id: pass(0, 1), duration_ms: 100, light_pwm: 255 });
    refused_with(&mut bench, &wrong, Refusal::NoSuchLayer, "a slot holds one pass");
    bench.expose(pass(0, 2), 100);
    assert_eq!(bench.core.state().last_exposed, Some(pass(0, 2)));
    for repeat in [pass(0, 2), pass(0, 1), pass(0, 0)] {
        bench.upload(0, repeat);
        let wrong = Request::Vat(VatRequest::Expose { id: repeat, duration_ms: 100, light_pwm: 255 });
        refused_with(&mut bench, &wrong, Refusal::AlreadyExposed, "a repeat");
    }
    bench.upload(0, pass(1, 0));
    bench.expose(pass(1, 0), 100);
}

#[test]
fn a_held_request_is_checked_at_its_release_as_if_it_had_just_come() {
    let expose = |layer, duration_ms| Request::Vat(VatRequest::Expose { id: id(layer), duration_ms, light_pwm: 255 });
    let mut bench = busy_bench();
    bench.urgent(Urgent::Hold);
    let waits = bench.request(expose(2, 0));
    assert_eq!(bench.reply(waits), None, "not checked yet");
    refused_with(&mut bench, &expose(2, 100), Refusal::Busy, "one waits");
    bench.urgent(Urgent::Release);
    assert_eq!(bench.reply(waits), Some(Reply::Refused(Refusal::BadDuration)));
    bench.urgent(Urgent::Hold);
    let waits = bench.request(expose(2, 100));
    bench.fault(fault());
    refused_with(&mut bench, &expose(2, 100), Refusal::NotReady, "a fault comes before a hold");
    assert_eq!(bench.reply(waits), None);
    bench.urgent(Urgent::Release);
    assert_eq!(bench.reply(waits), Some(Reply::Refused(Refusal::NotReady)));
    assert!(!bench.core.state().light_on);
}

#[test]
fn a_layer_on_its_way_outlives_a_fault_but_neither_a_hello_nor_an_abort() {
    let bytes = |layer| {
        let mut bytes = Vec::new();
        encode(&picture(layer), Encoding::Group4, &mut bytes).expect("bits");
        bytes
    };
    let begin = |bench: &mut Bench, layer| {
        bench.request(Request::LayerBegin {
            slot: 1,
            id: id(layer),
            encoding: Encoding::Group4,
            encoded_bytes: bytes(layer).len() as u32,
            decoded_crc32: picture_crc32(&picture(layer)),
        })
    };
    let mut bench = busy_bench();
    let number = begin(&mut bench, 3);
    bench.data(&bytes(3)[..5]);
    bench.fault(fault());
    bench.data(&bytes(3)[5..]);
    assert_eq!(bench.reply(number), Some(Reply::Done));
    assert_eq!(bench.core.state().slots, [Some(id(2)), Some(id(3))]);
    bench.fault(None);
    for end in [
        |bench: &mut Bench| {
            bench.hello();
        },
        |bench: &mut Bench| bench.silence(),
    ] {
        let number = begin(&mut bench, 4);
        bench.data(&bytes(4)[..5]);
        end(&mut bench);
        bench.data(&bytes(4)[5..]);
        assert_eq!((bench.reply(number), &bench.core.state().slots[1]), (None, &None), "void, without an answer");
        bench.hello();
    }
    let number = begin(&mut bench, 4);
    bench.urgent(Urgent::Abort);
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::NotReady)));
    bench.hello();
    bench.data(&bytes(4));
    assert_eq!(bench.core.state().slots, [None, None]);
}

#[test]
fn of_two_slots_with_one_layer_the_lower_is_exposed_and_freed() {
    let mut bench = Bench::new();
    bench.upload(1, id(0));
    bench.upload(0, id(0));
    assert_eq!(bench.core.state().slots, [Some(id(0)), Some(id(0))]);
    bench.expose(id(0), 100);
    assert_eq!(bench.core.state().slots, [None, Some(id(0))]);
    let again = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 100, light_pwm: 255 }));
    assert_eq!(bench.reply(again), Some(Reply::Refused(Refusal::AlreadyExposed)));
    bench.upload(1, id(1));
}

#[derive(Clone, Debug)]
enum Step {
    Message(HostMessage),
    Urgent(Urgent),
    Advance(u64),
    Silence,
    Hello,
    Reset,
}

fn step() -> impl Strategy<Value = Step> {
    let layer = 0u32..6;
    let request = prop_oneof![
        4 => (layer, prop_oneof![Just(0u32), 1u32..3000, Just(400_000)])
            .prop_map(|(layer, duration_ms)| Request::Vat(VatRequest::Expose { id: id(layer), duration_ms, light_pwm: 200 })),
        1 => Just(Request::Vat(VatRequest::Home)),
        1 => (-5i32..70_000, 0u32..30_000).prop_map(|(position_um, speed_um_s)| Request::Vat(VatRequest::Move { position_um, speed_um_s })),
        1 => Just(Request::State),
    ];
    let urgent = prop_oneof![Just(Urgent::Abort), Just(Urgent::LightOff), Just(Urgent::Hold), Just(Urgent::Release)];
    prop_oneof![
        6 => request.prop_map(|request| Step::Message(HostMessage::Request { number: 0, request })),
        2 => prop::collection::vec(any::<u8>(), 0..40).prop_map(|bytes| Step::Message(HostMessage::LayerData(bytes))),
        1 => urgent.prop_map(Step::Urgent),
        4 => (0u64..4_000_000).prop_map(Step::Advance),
        1 => Just(Step::Silence),
        3 => Just(Step::Hello),
        1 => Just(Step::Reset),
    ]
}

proptest! {
    #![proptest_config(properties::cases(300))]

    /// Whatever a host does: light on and off alternate, never for longer than the device's maximum, and of one job the
    /// layers exposed only ascend.
    #[test]
    fn light_is_bounded_and_nothing_is_exposed_twice(steps in prop::collection::vec((step(), 0u32..6), 1..60)) {
        let mut bench = Bench::new();
        for (step, layer) in steps {
            if bench.core.state().slots.contains(&None) {
                bench.try_upload(id(layer));
            }
            match step {
                Step::Message(message) => bench.message(message),
                Step::Urgent(urgent) => {
                    let light_on = bench.urgent(urgent);
                    prop_assert!(!(light_on && matches!(urgent, Urgent::Abort | Urgent::LightOff)));
                }
                Step::Advance(us) => bench.advance(us),
                Step::Silence => bench.silence(),
                Step::Hello => { bench.hello(); }
                Step::Reset => bench.reset(77),
            }
        }
        bench.advance(10_000_000_000);
        prop_assert!(!bench.core.state().light_on);
        let (mut lit_since, mut last) = (None, None);
        for record in &bench.records {
            match record.event {
                "light_on" => {
                    prop_assert_eq!(lit_since, None);
                    lit_since = Some(record.t_ms);
                }
                "light_off" => {
                    let since = lit_since.take();
                    prop_assert!(since.is_some_and(|since| record.t_ms - since <= u64::from(capabilities().max_exposure_ms)));
                }
                "moved" => prop_assert_eq!(lit_since, None),
                "exposed" => {
                    prop_assert!(record.layer > last, "{:?} after {:?}", record.layer, last);
                    last = record.layer;
                }
                _ => {}
            }
        }
        prop_assert_eq!(lit_since, None);
    }
}
