//! The plate: when it may move, and where to.

use layerd::link::message::{Refusal, Reply, Request, VatReply, VatRequest};

use crate::device_common::{Bench, capabilities, id};

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
    let max_position_um = capabilities().machine.max_position_um();
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
