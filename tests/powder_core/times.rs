//! The scan clock: jumps, marks, delays and points take exactly the times that the parameters say.

use layerd::layer::{LaserParameters, MarkClass, Vectors};
use layerd::link::message::{Encoding, PowderReply, PowderRequest, Reply, Request};

use crate::device_common::powder::{LASER, Powder, id, mark, sent, sent_with};

/// Two connected vectors, one beside them, and a point.
fn hand_made() -> Vectors {
    let mut vectors = Vectors::default();
    // The scanner is in the centre of the field, (10000, 5000): 5000 µm away, which is a jump of 1000 µs.
    vectors.push_path(MarkClass::Contour, &[[7000, 1000], [7300, 1000], [7300, 1400]]);
    vectors.push_path(MarkClass::Hatch, &[[7600, 1800], [7600, 1700]]);
    vectors.push_path(MarkClass::Point, &[[7600, 2700]]);
    vectors
}

#[test]
fn a_layer_takes_the_time_of_its_jumps_marks_and_delays() {
    let mut powder = Powder::ready();
    powder.load(0, id(0), &sent(&hand_made()));
    let number = powder.request(mark(id(0), 0, 1000));
    // When each vector ends: jump and its delay, then marks, the polygon delay, the mark delay and jumps of 500 µm and 1000 µm.
    let ends = [(1, 1000 + 100 + 300), (2, 20 + 400), (3, 50 + 100 + 100 + 100), (4, 50 + 200 + 100 + 400)];
    let mut total_us = 0;
    for (count, us) in ends {
        powder.advance(us - 1);
        assert_eq!(powder.next_vector(), count - 1, "a microsecond before its end");
        powder.advance(1);
        total_us += us;
        if count < 4 {
            assert_eq!(powder.next_vector(), count, "at its end");
            assert_eq!(powder.core.state().exposing, Some(id(0)));
            assert!(powder.core.state().light_on && powder.reply(number).is_none());
        }
    }
    // The polygon delay counts as light: 300 + 20 + 400 + 100 + 400 µs.
    let marked = PowderReply::Marked { id: id(0), vectors: 4, laser_ms: 1, starved_ms: 0 };
    assert_eq!(powder.reply(number), Some(Reply::Powder(marked)), "after {total_us} µs");
    let state = powder.core.state();
    assert_eq!((state.exposing, state.light_on, state.last_exposed), (None, false, Some(id(0))));
    assert_eq!((state.slots, state.cut_short, powder.next_vector()), (vec![None, None], None, 0));
    let events: Vec<_> = powder.events().into_iter().skip(3).collect();
    assert_eq!(events, ["laser_on", "laser_off", "marked"]);
    let record = powder.records.last().expect("an act");
    assert_eq!(
        (record.duration_ms, record.vectors, record.from_vector, record.starved_ms),
        (Some(1), Some(4), Some(0), Some(0))
    );
    assert_eq!(powder.core.statistics().vectors, 4);
    let told: Vec<_> = powder.vectors.iter().map(|told| (told.id, told.vector.number, told.is_whole)).collect();
    assert_eq!(told, [0, 1, 2, 3].map(|number| (id(0), number, true)));
    let spans: Vec<_> = powder.vectors.iter().map(|told| told.ended_us - told.began_us).collect();
    assert_eq!(spans, [300, 400, 100, 400]);
    let gaps: Vec<_> = powder.vectors.windows(2).map(|pair| pair[1].began_us - pair[0].ended_us).collect();
    assert_eq!(gaps, [20, 50 + 100 + 100, 50 + 200 + 100]);
    let marks = powder.vectors.iter().zip(hand_made().marks()).all(|(told, mark)| {
        (told.vector.class, told.vector.from_um, told.vector.to_um) == (mark.class, mark.from_um, mark.to_um)
    });
    assert!(marks && powder.vectors.iter().all(|told| told.laser == LASER), "{:?}", powder.vectors);
}

#[test]
fn the_laser_time_is_rounded_and_the_next_layer_begins_where_the_scanner_is() {
    let mut powder = Powder::ready();
    powder.load(0, id(0), &sent(&hand_made()));
    powder.request(mark(id(0), 0, 1000));
    powder.mark_to_its_end();
    // From the point (7600, 2700) no jump is needed, so there is no delay either: 1700 µs of light, rounded to 2 ms.
    let mut vectors = Vectors::default();
    vectors.push_path(MarkClass::Contour, &[[7600, 2700], [9300, 2700]]);
    powder.load(0, id(1), &sent(&vectors));
    let number = powder.request(mark(id(1), 0, 1000));
    powder.advance(1699);
    assert_eq!(powder.reply(number), None);
    powder.advance(1);
    let marked = PowderReply::Marked { id: id(1), vectors: 1, laser_ms: 2, starved_ms: 0 };
    assert_eq!(powder.reply(number), Some(Reply::Powder(marked)));
    // After homing, the scanner is in the centre again.
    powder.make_ready();
    let mut vectors = Vectors::default();
    vectors.push_path(MarkClass::Contour, &[[10_000, 5000], [10_100, 5000]]);
    powder.load(0, id(2), &sent(&vectors));
    let number = powder.request(mark(id(2), 0, 1000));
    powder.advance(100);
    assert!(powder.reply(number).is_some());
}

#[test]
fn a_layer_without_vectors_is_marked_at_once() {
    let mut powder = Powder::ready();
    powder.load(0, id(0), &sent(&Vectors::default()));
    let number = powder.request(mark(id(0), 0, 1000));
    let marked = PowderReply::Marked { id: id(0), vectors: 0, laser_ms: 0, starved_ms: 0 };
    assert_eq!(powder.reply(number), Some(Reply::Powder(marked)));
    assert_eq!(powder.pictures.len(), 1, "an empty picture");
}

#[test]
fn a_late_call_changes_no_time() {
    let marked_at = |step_us: u64| {
        let mut powder = Powder::ready();
        powder.load(0, id(0), &sent(&hand_made()));
        powder.request(mark(id(0), 0, 1000));
        for _ in 0..10_000 / step_us {
            powder.advance(step_us);
        }
        powder.records.last().cloned().expect("an act")
    };
    assert_eq!(marked_at(1), marked_at(10_000));
}

#[test]
fn each_class_has_its_own_speed() {
    let mut powder = Powder::ready();
    let slow = LaserParameters { mark_speed_um_s: 1000, jump_delay_us: 0, ..LASER };
    let mut vectors = Vectors::default();
    vectors.push_path(MarkClass::Contour, &[[10_000, 5000], [10_100, 5000]]);
    powder.load(0, id(0), &sent_with(&vectors, Encoding::VectorsCoded, slow));
    let number = powder.request(mark(id(0), 0, 1000));
    powder.advance(99_999);
    assert_eq!(powder.reply(number), None);
    powder.advance(1);
    let marked = PowderReply::Marked { id: id(0), vectors: 1, laser_ms: 100, starved_ms: 0 };
    assert_eq!(powder.reply(number), Some(Reply::Powder(marked)));
}

#[test]
fn recoater_and_plate_take_their_time_and_a_move_clears_the_powder() {
    let recoated = |powder: &Powder| powder.core.state().powder.expect("of powder").recoated;
    let mut powder = Powder::new();
    let number = powder.request(Request::Powder(PowderRequest::Recoat));
    powder.advance(3_999_999);
    assert_eq!((powder.reply(number), recoated(&powder)), (None, false));
    powder.advance(1);
    assert_eq!((powder.reply(number), recoated(&powder)), (Some(Reply::Powder(PowderReply::Recoated)), true));
    powder.request(Request::Powder(PowderRequest::Home));
    assert!(!recoated(&powder) && powder.core.state().moving);
    powder.advance(5_000_000);
    powder.recoat();
    let down = powder.request(Request::Powder(PowderRequest::Move { position_um: 50, speed_um_s: 1000 }));
    assert!(!recoated(&powder));
    powder.advance(50_000);
    assert_eq!(powder.reply(down), Some(Reply::Powder(PowderReply::Moved { position_um: 50 })));
    assert_eq!(powder.core.state().position_um, Some(50));
    assert_eq!(powder.events(), ["hello", "recoated", "moved", "recoated", "moved"]);
}
