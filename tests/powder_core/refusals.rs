//! What the machine refuses, and which refusal wins where several apply.

use layerd::layer::{LaserParameters, MarkClass, Vectors};
use layerd::link::message::{Encoding, PowderRequest, Refusal, Reply, Request, Urgent, VatRequest};

use crate::device_common::powder::{
    BUFFER_BYTES, LASER, MAX_MS, MAX_POWER_MW, Powder, door, id, mark, rings, sent, sent_with,
};

const MOVE: fn(i32, u32) -> Request =
    |position_um, speed_um_s| Request::Powder(PowderRequest::Move { position_um, speed_um_s });
const HOME: Request = Request::Powder(PowderRequest::Home);
const RECOAT: Request = Request::Powder(PowderRequest::Recoat);

#[test]
fn of_several_refusals_of_a_mark_the_first_in_the_documents_order_wins() {
    let mut powder = Powder::new();
    // Everything that is wrong at first is put right, one thing after the other.
    let wrong = mark(id(5), 9, 0);
    powder.set_door(true);
    powder.refused_with(wrong, Refusal::NotReady, "a fault");
    powder.set_door(false);
    powder.request(RECOAT);
    powder.refused_with(wrong, Refusal::Busy, "recoating");
    powder.refused_with(HOME, Refusal::Busy, "recoating");
    powder.refused_with(RECOAT, Refusal::Busy, "recoating");
    powder.refused_with(MOVE(-1, 0), Refusal::Busy, "recoating");
    powder.advance(4_000_000);
    powder.refused_with(wrong, Refusal::NotHomed, "not homed");
    powder.refused_with(MOVE(-1, 0), Refusal::NotHomed, "not homed");
    powder.request(HOME);
    powder.refused_with(RECOAT, Refusal::Busy, "moving");
    powder.advance(5_000_000);
    powder.refused_with(wrong, Refusal::NotRecoated, "no powder");
    for bad in [MOVE(-1, 1000), MOVE(50_001, 1000), MOVE(10, 0)] {
        powder.refused_with(bad, Refusal::BadMove, "outside its travel, or at no speed");
    }
    powder.recoat();
    powder.load(0, id(3), &sent(&rings(2)));
    powder.request(mark(id(3), 0, 1000));
    powder.mark_to_its_end();
    powder.refused_with(mark(id(3), 9, 0), Refusal::BadDuration, "no time");
    powder.refused_with(mark(id(3), 9, MAX_MS + 1), Refusal::BadDuration, "too long");
    powder.refused_with(mark(id(3), 9, 1000), Refusal::AlreadyExposed, "marked before");
    powder.refused_with(mark(id(2), 9, 1000), Refusal::AlreadyExposed, "before one that was marked");
    powder.refused_with(mark(id(5), 9, 1000), Refusal::NoSuchLayer, "in no slot");
    powder.load(1, id(5), &sent(&rings(2)));
    powder.refused_with(mark(id(5), 1, 1000), Refusal::WrongVector, "never marked");
    powder.request(mark(id(5), 0, 1000));
    assert_eq!(powder.core.state().exposing, Some(id(5)));
    powder.refused_with(mark(id(5), 0, 1000), Refusal::Busy, "being marked");
}

#[test]
fn a_layer_that_was_cut_short_goes_on_with_its_next_vector_alone() {
    let mut powder = Powder::ready();
    let layer = sent(&rings(3));
    powder.load(0, id(0), &layer);
    let number = powder.request(mark(id(0), 0, 1000));
    powder.advance(2700);
    powder.urgent(Urgent::LightOff);
    assert_eq!(powder.reply(number), Some(Reply::Refused(Refusal::CutShort)));
    let next = powder.next_vector();
    assert!(next > 0 && next < 12, "{next}");
    powder.refused_with(mark(id(0), next, 1000), Refusal::NoSuchLayer, "its bytes are gone");
    powder.load(0, id(0), &layer);
    for wrong in [0, next - 1, next + 1, u32::MAX] {
        powder.refused_with(mark(id(0), wrong, 1000), Refusal::WrongVector, "it would leave out or repeat vectors");
    }
    // Another layer has no memory of it.
    powder.load(1, id(1), &layer);
    powder.refused_with(mark(id(1), next, 1000), Refusal::WrongVector, "never marked");
    // A layer of the same name with fewer vectors has no such vector.
    powder.load(0, id(0), &sent(&Vectors::default()));
    powder.refused_with(mark(id(0), next, 1000), Refusal::WrongVector, "beyond the layer");
    powder.load(0, id(0), &layer);
    powder.request(mark(id(0), next, 1000));
    powder.mark_to_its_end();
    assert_eq!((powder.core.state().last_exposed, powder.core.state().cut_short), (Some(id(0)), None));
}

#[test]
fn of_several_refusals_of_a_layer_the_first_in_the_documents_order_wins() {
    let mut powder = Powder::ready();
    let begin = |slot, encoding, encoded_bytes| Request::LayerBegin {
        slot,
        id: id(7),
        encoding,
        encoded_bytes,
        decoded_crc32: 0,
    };
    powder.load(0, id(0), &sent(&rings(3)));
    powder.request(mark(id(0), 0, 1000));
    for (request, refusal) in [
        (begin(2, Encoding::RawBit, 0), Refusal::NoSuchLayer),
        (begin(0, Encoding::RawBit, 0), Refusal::SlotBusy),
        (begin(1, Encoding::RawBit, 0), Refusal::BadEncoding),
        (begin(1, Encoding::VectorsCoded, 0), Refusal::BadLayer),
    ] {
        let on_its_way = powder.request(begin(1, Encoding::Vectors, 500));
        powder.refused_with(request, refusal, "while a layer is marked");
        assert_eq!(powder.reply(on_its_way), Some(Reply::Refused(Refusal::BadLayer)), "not finished");
    }
    powder.set_door(true);
    powder.refused_with(begin(2, Encoding::RawBit, 0), Refusal::NotReady, "a fault");
}

#[test]
fn requests_of_a_vat_are_unknown() {
    let mut powder = Powder::ready();
    powder.urgent(Urgent::Hold);
    powder.refused_with(Request::Vat(VatRequest::Home), Refusal::Unknown, "not for its kind");
    let expose = VatRequest::Expose { id: id(0), duration_ms: 10, light_pwm: 255 };
    powder.refused_with(Request::Vat(expose), Refusal::Unknown, "not for its kind");
}

#[test]
fn layers_that_cannot_be_marked_are_refused_before_they_may_be() {
    let mut powder = Powder::ready();
    let good = sent(&rings(3));
    let mut wrong_crc = good.clone();
    wrong_crc.crc32 ^= 1;
    let mut cut = good.clone();
    cut.bytes.truncate(cut.bytes.len() - 1);
    let mut long = good.clone();
    long.bytes.push(0);
    let mut damaged = good.clone();
    damaged.bytes[60] ^= 0x40;
    let of = |laser| sent_with(&rings(3), Encoding::VectorsCoded, laser);
    let strong = of(LaserParameters { power_mw: MAX_POWER_MW + 1, ..LASER });
    let still = of(LaserParameters { mark_speed_um_s: 0, ..LASER });
    let slow = of(LaserParameters { mark_speed_um_s: 19, ..LASER });
    let stuck = of(LaserParameters { jump_speed_um_s: 0, ..LASER });
    let waits = of(LaserParameters { polygon_delay_us: u32::MAX, ..LASER });
    let mut point = Vectors::default();
    point.push_path(MarkClass::Point, &[[1, 1]]);
    let burns = sent_with(&point, Encoding::Vectors, LaserParameters { point_time_us: u32::MAX, ..LASER });
    for (bad, what) in [
        (wrong_crc, "CRC"),
        (cut, "cut off"),
        (long, "too long"),
        (damaged, "damaged"),
        (strong, "power"),
        (still, "speed 0"),
        (slow, "a vector of more than 10 s"),
        (stuck, "jumps at speed 0"),
        (waits, "a delay of an hour"),
        (burns, "a point of an hour"),
    ] {
        let number = powder.announce(0, id(0), &bad);
        powder.feed(&bad.bytes, 7);
        assert_eq!(powder.reply(number), Some(Reply::Refused(Refusal::BadLayer)), "{what}");
        assert_eq!(powder.core.state().slots, [None, None], "{what}");
        // Everything that came has left the buffer, and the host can know it: the next layer has all the room.
        powder.load(1, id(1), &good);
        powder.announce(1, id(1), &good);
        assert_eq!(powder.credit_bytes(), BUFFER_BYTES, "{what}");
    }
    powder.load(0, id(0), &of(LaserParameters { power_mw: MAX_POWER_MW, mark_speed_um_s: 20, ..LASER }));
}

#[test]
fn a_held_mark_begins_at_the_release() {
    let mut powder = Powder::ready();
    powder.load(0, id(0), &sent(&rings(3)));
    powder.urgent(Urgent::Hold);
    let number = powder.request(mark(id(0), 0, 1000));
    powder.refused_with(RECOAT, Refusal::Busy, "one request waits");
    powder.advance(1_000_000);
    assert!(powder.reply(number).is_none() && !powder.core.state().light_on);
    assert!(powder.urgent(Urgent::Release));
    assert!(powder.urgent(Urgent::Hold), "a hold leaves the laser on");
    powder.mark_to_its_end();
    assert!(matches!(powder.reply(number), Some(Reply::Powder(_))));
}

impl Powder {
    fn set_door(&mut self, open: bool) {
        self.fault(if open { door() } else { None });
    }
}
