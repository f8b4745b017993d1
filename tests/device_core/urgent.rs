//! Urgent orders: abort, light off, hold and release.

use layerd::link::message::{Refusal, Reply, Request, Urgent, VatReply, VatRequest};

use crate::device_common::{Bench, id};
use crate::{busy_bench, fault, refused_with};

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
