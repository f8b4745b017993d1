//! Layers on their way into a slot: damaged, misplaced, given up and cut off.

use layerd::device::encoding::{encode, picture_crc32};
use layerd::link::message::{Encoding, Refusal, Reply, Request, Urgent, VatRequest};

use crate::device_common::{Bench, id, picture};
use crate::{busy_bench, fault};

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
