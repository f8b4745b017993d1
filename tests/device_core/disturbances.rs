//! A silent host, a reset and a fault: when there is light, and what the device remembers.

use layerd::link::message::{Refusal, Reply, Request, VatRequest};

use crate::device_common::{Bench, id};
use crate::fault;

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
    bench.fault(fault());
    assert_eq!((bench.core.state().light_on, bench.core.state().fault), (false, fault()));
    assert_eq!(bench.faults, [fault()]);
    let number = bench.request(Request::Vat(VatRequest::Home));
    assert_eq!(bench.reply(number), Some(Reply::Refused(Refusal::NotReady)));
    bench.fault(None);
    assert!(bench.request(Request::Vat(VatRequest::Home)) > number && bench.core.state().moving);
}
