//! The order of refusals where several apply.

use layerd::link::message::{Encoding, Refusal, Reply, Request, Urgent, VatRequest};

use crate::device_common::{Bench, id};
use crate::{busy_bench, fault, refused_with};

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
