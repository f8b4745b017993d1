//! One exposure: how long it shines, what is refused, and that nothing is exposed twice.

use layerd::link::message::{ExposureId, Refusal, Reply, Request, VatReply, VatRequest};

use crate::device_common::{Bench, capabilities, id, picture};
use crate::refused_with;

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
