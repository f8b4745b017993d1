//! A machine with several vats: which one is in place, when, and what that refuses.

use layerd::device::sim::DeviceCore;
use layerd::link::message::{
    ExposureId, MachineCapabilities, Refusal, Reply, Request, Urgent, VatReply, VatRequest, Vats, VatsState,
};

use crate::device_common::{Bench, capabilities, id};

const CHANGE_MS: u32 = 2000;

/// A homed device with three vats.
fn bench() -> Bench {
    let mut capabilities = capabilities();
    if let MachineCapabilities::Vat(vat) = &mut capabilities.machine {
        vat.vats = Vats { count: 3, change_ms: CHANGE_MS };
    }
    let mut bench = Bench::of(DeviceCore::new(capabilities, 5));
    bench.request(Request::Vat(VatRequest::Home));
    bench.advance(10_000_000);
    bench
}

fn change(vat: u8) -> Request {
    Request::Vat(VatRequest::Change { vat, wash_ms: 5000, drain_ms: 1000 })
}

fn in_place(bench: &Bench) -> Option<u8> {
    bench.core.state().vats.expect("it has several").in_place
}

#[test]
fn a_change_takes_its_time_and_nothing_else_happens_meanwhile() {
    let mut bench = bench();
    assert_eq!(in_place(&bench), Some(1));
    bench.upload(0, id(0));
    let changing = bench.request(change(2));
    assert_eq!((in_place(&bench), bench.reply(changing)), (None, None));
    let expose = Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 1000, light_pwm: 255 });
    for other in [expose, change(3), Request::Vat(VatRequest::Home)] {
        let number = bench.request(other);
        assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::Busy)));
    }
    bench.advance(7_999_000);
    assert_eq!((in_place(&bench), bench.reply(changing)), (None, None));
    bench.advance(1000);
    assert_eq!(bench.reply(changing), Some(Reply::Vat(VatReply::Changed { vat: 2 })));
    assert_eq!(bench.core.state().vats, Some(VatsState { in_place: Some(2) }));
    let number = bench.request(expose);
    bench.advance(1_000_000);
    assert_eq!(bench.reply(number), Some(Reply::Vat(VatReply::Exposed { id: id(0), duration_ms: 1000 })));
    let lit = bench.records.iter().find(|record| record.event == "exposed").expect("it is logged");
    assert_eq!((lit.vat, lit.pass), (Some(2), None));
    assert_eq!(bench.core.statistics().changes, 1);
}

#[test]
fn passes_of_a_layer_are_exposed_in_their_order_and_once() {
    let mut bench = bench();
    let passes = [0, 1].map(|pass| ExposureId { pass, ..id(0) });
    for (slot, id) in (0..).zip(passes) {
        bench.upload(slot, id);
    }
    for id in passes {
        let number = bench.request(Request::Vat(VatRequest::Expose { id, duration_ms: 500, light_pwm: 255 }));
        bench.advance(500_000);
        assert_eq!(bench.reply(number), Some(Reply::Vat(VatReply::Exposed { id, duration_ms: 500 })));
    }
    bench.upload(0, passes[0]);
    let again = bench.request(Request::Vat(VatRequest::Expose { id: passes[0], duration_ms: 500, light_pwm: 255 }));
    assert_eq!(bench.reply(again), Some(Reply::Refused(Refusal::AlreadyExposed)));
}

#[test]
fn no_vat_is_in_place_after_a_change_that_was_stopped() {
    let abort = |bench: &mut Bench| {
        bench.urgent(Urgent::Abort);
    };
    for stop in [abort as fn(&mut Bench), |bench| bench.reset(6)] {
        let mut bench = bench();
        bench.request(change(3));
        bench.advance(1_000_000);
        stop(&mut bench);
        bench.advance(60_000_000);
        bench.hello();
        assert_eq!(in_place(&bench), None);
        bench.upload(0, id(0));
        let number = bench.request(Request::Vat(VatRequest::Expose { id: id(0), duration_ms: 500, light_pwm: 255 }));
        assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::NoSuchVat)), "no light without a vat");
    }
    // Light off leaves a change alone: it is dark.
    let mut bench = bench();
    let changing = bench.request(change(3));
    bench.urgent(Urgent::LightOff);
    bench.advance(8_000_000);
    assert_eq!(bench.reply(changing), Some(Reply::Vat(VatReply::Changed { vat: 3 })));
}

#[test]
fn a_vat_that_is_not_there_is_refused() {
    let mut bench = bench();
    for vat in [0, 4, 255] {
        let number = bench.request(change(vat));
        assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::NoSuchVat)), "{vat}");
    }
    let mut single = Bench::new();
    let number = single.request(change(1));
    assert_eq!(single.reply(number), Some(Reply::Refused(Refusal::NoSuchVat)));
    assert_eq!(single.core.state().vats, None);
    let mut capabilities = capabilities();
    if let MachineCapabilities::Vat(vat) = &mut capabilities.machine {
        vat.vats = Vats { count: 2, change_ms: CHANGE_MS };
    }
    let mut unhomed = Bench::of(DeviceCore::new(capabilities, 5));
    let number = unhomed.request(change(2));
    assert_eq!(unhomed.reply(number), Some(Reply::Refused(Refusal::NotHomed)));
}
