//! Why marking ends early: where the laser stops, what the machine remembers, and that every vector is marked exactly once.

use layerd::link::message::{Encoding, PowderRequest, Refusal, Reply, Request, Urgent};

use crate::device_common::powder::{BUFFER_BYTES, LASER, Powder, door, id, mark, rings, sent, sent_with};

/// Into the second vector of the first ring: jump from the centre, first vector, polygon delay, then 100 µs.
const IN_SECOND_US: u64 = JUMP_US + 100 + 200 + 20 + 100;
/// From (10000, 5000) to (100, 100) at 5 m/s.
const JUMP_US: u64 = 2209;

/// What ends a marking: its reason in the log, and how it happens.
type End = (&'static str, fn(&mut Powder));

fn marking() -> (Powder, u32) {
    let mut powder = Powder::ready();
    powder.load(0, id(0), &sent(&rings(3)));
    let number = powder.request(mark(id(0), 0, 1000));
    powder.advance(IN_SECOND_US);
    assert_eq!(powder.next_vector(), 1);
    (powder, number)
}

#[test]
fn urgent_orders_faults_and_resets_are_dark_within_the_call() {
    let ends: [End; 4] = [
        ("abort", |powder| assert!(!powder.urgent(Urgent::Abort))),
        ("light_off", |powder| assert!(!powder.urgent(Urgent::LightOff))),
        ("fault", |powder| powder.fault(door())),
        ("reset", |powder| powder.reset(77)),
    ];
    for (name, end) in ends {
        let (mut powder, number) = marking();
        end(&mut powder);
        let state = powder.core.state();
        assert_eq!((state.light_on, state.exposing), (false, None), "{name}");
        // 200 + 20 + 100 µs of light round to 0 ms. The vector that was interrupted is not marked whole.
        assert_eq!((state.cut_short, powder.next_vector()), (Some((id(0), 0)), 1), "{name}");
        assert!(state.powder.is_some_and(|powder| powder.broken), "{name}: part of it is marked");
        assert_eq!(state.slots, [None, None], "{name}");
        let told: Vec<_> = powder.vectors.iter().map(|told| (told.ended_us - told.began_us, told.is_whole)).collect();
        assert_eq!(told, [(200, true), (100, false)], "{name}");
        let off = powder.records.iter().find(|record| record.event == "laser_off").expect("a record");
        assert_eq!((off.reason.as_deref(), off.next_vector), (Some(name), Some(1)));
        if name == "reset" {
            assert_eq!(powder.reply(number), None, "its session is lost");
            assert_eq!(state.powder.map(|powder| powder.recoated), Some(false));
        } else {
            assert_eq!(powder.reply(number), Some(Reply::Refused(Refusal::CutShort)), "{name}");
            let size = sent(&rings(3)).bytes.len() as u32;
            assert_eq!(powder.rooms.last(), Some(&size), "{name}: its bytes have left the buffer");
        }
        powder.advance(100_000);
        assert_eq!(powder.next_vector(), 1, "{name}: nothing goes on");
        assert!(powder.pictures.is_empty());
    }
}

#[test]
fn silence_hello_and_the_longest_time_end_at_the_end_of_the_vector() {
    let ends: [End; 2] = [("host_silent", |powder| powder.silence()), ("hello", Powder::greet)];
    for (name, end) in ends {
        let (mut powder, number) = marking();
        end(&mut powder);
        assert!(powder.core.state().light_on, "{name}: it is on until its vector ends");
        powder.advance(99);
        assert!(powder.core.state().light_on && powder.next_vector() == 1, "{name}");
        powder.advance(1);
        let state = powder.core.state();
        assert_eq!((state.light_on, state.cut_short, powder.next_vector()), (false, Some((id(0), 0)), 2), "{name}");
        assert!(state.powder.is_some_and(|powder| !powder.broken), "{name}: no vector is marked in part");
        assert_eq!(powder.reply(number), None, "{name}: its session has ended");
        assert_eq!(state.slots, [None, None]);
        powder.advance(1_000_000);
        assert_eq!(powder.next_vector(), 2);
        powder.greet();
        assert_eq!(powder.credit_bytes(), BUFFER_BYTES);
    }
    let mut powder = Powder::ready();
    powder.load(0, id(0), &sent(&rings(3)));
    // The jump takes 2.2 ms, so 3 ms end in the fourth vector.
    let number = powder.request(mark(id(0), 0, 3));
    powder.advance(3000);
    assert_eq!((powder.next_vector(), powder.core.state().light_on), (3, true));
    powder.advance(JUMP_US + 100 + 4 * 200 + 3 * 20 - 3000);
    assert_eq!(powder.reply(number), Some(Reply::Refused(Refusal::CutShort)));
    assert_eq!((powder.next_vector(), powder.core.state().cut_short), (4, Some((id(0), 1))));
}

#[test]
fn between_two_vectors_there_is_nothing_to_wait_for() {
    let (mut powder, _) = marking();
    // Into the jump to the second ring.
    powder.advance(100 + 2 * 220 + 60);
    assert_eq!(powder.next_vector(), 4);
    powder.silence();
    assert_eq!((powder.core.state().light_on, powder.next_vector()), (false, 4));
}

#[test]
fn the_last_vector_makes_a_layer_whole_even_if_the_host_is_gone() {
    let (mut powder, _) = marking();
    let two_more_us = 2 * (50 + 250 / 5 + 100 + 4 * 200 + 3 * 20);
    powder.advance(100 + 2 * 220 + two_more_us - 100);
    assert_eq!(powder.next_vector(), 11);
    powder.silence();
    powder.mark_to_its_end();
    let state = powder.core.state();
    assert_eq!((state.last_exposed, state.cut_short), (Some(id(0)), None));
    assert_eq!(powder.pictures.len(), 1);
}

#[test]
fn a_recoater_and_a_plate_stop_with_an_abort_and_powder_must_be_spread_again() {
    let mut powder = Powder::ready();
    let recoat = powder.request(Request::Powder(PowderRequest::Recoat));
    powder.advance(1_000_000);
    powder.urgent(Urgent::LightOff);
    assert_eq!(powder.reply(recoat), None, "a recoater needs no light");
    powder.urgent(Urgent::Abort);
    assert_eq!(powder.reply(recoat), Some(Reply::Refused(Refusal::CutShort)));
    powder.greet();
    powder.load(0, id(0), &sent(&rings(1)));
    powder.refused_with(mark(id(0), 0, 10), Refusal::NotRecoated, "half of the powder");
    let down = powder.request(Request::Powder(PowderRequest::Move { position_um: 5000, speed_um_s: 1000 }));
    powder.advance(1_000_000);
    powder.fault(door());
    assert_eq!(powder.reply(down), Some(Reply::Refused(Refusal::CutShort)));
    assert_eq!(powder.core.state().position_um, Some(1000));
    powder.fault(None);
    powder.request(Request::Powder(PowderRequest::Move { position_um: 5000, speed_um_s: 1000 }));
    powder.advance(1_000_000);
    powder.reset(8);
    assert_eq!(powder.core.state().position_um, None, "a plate in motion is lost");
}

#[test]
fn what_was_cut_short_survives_a_reset() {
    let (mut powder, _) = marking();
    powder.silence();
    powder.mark_to_its_end();
    powder.reset(9);
    powder.greet();
    let state = powder.core.state();
    assert_eq!((state.cut_short, powder.next_vector(), state.position_um), (Some((id(0), 0)), 2, Some(0)));
    powder.recoat();
    let layer = sent(&rings(3));
    powder.load(0, id(0), &layer);
    powder.refused_with(mark(id(0), 0, 1000), Refusal::WrongVector, "two of its vectors are marked");
    powder.request(mark(id(0), 2, 1000));
    powder.mark_to_its_end();
    let whole = {
        let mut powder = Powder::ready();
        powder.load(0, id(0), &layer);
        powder.request(mark(id(0), 0, 1000));
        powder.mark_to_its_end();
        powder.pictures.clone()
    };
    assert_eq!(powder.pictures, whole, "the picture of a layer grows over all its acts");
}

/// The vectors that acts marked whole, by the log: from each act's first vector to the one before it ended.
fn marked_vectors(powder: &Powder) -> Vec<u32> {
    let mut marked = Vec::new();
    for record in &powder.records {
        match (record.event, record.from_vector, record.next_vector, record.vectors) {
            ("laser_off", Some(from), Some(next), _) | ("marked", Some(from), _, Some(next)) => {
                marked.extend(from..next);
            }
            _ => {}
        }
    }
    marked
}

/// A layer that is larger than the buffer is disturbed again and again. The host goes on with the next vector each time.
#[test]
fn a_layer_that_is_cut_again_and_again_has_every_vector_once() {
    let layer = sent_with(&rings(800), Encoding::VectorsCoded, LASER);
    let mut powder = Powder::ready();
    let disturb: [fn(&mut Powder); 4] = [
        |powder| powder.silence(),
        Powder::greet,
        |powder| powder.reset(3),
        // Not before the present vector has ended: it would be marked in part.
        |powder| powder.advance(10_000_000),
    ];
    let mut acts = 0;
    while powder.core.state().last_exposed.is_none() {
        acts += 1;
        assert!(acts < 100, "it does not end");
        powder.mark_to_its_end();
        powder.greet();
        powder.recoat();
        let next = powder.next_vector();
        let number = powder.announce((acts % 2) as u8, id(0), &layer);
        let mut rest = powder.feed(&layer.bytes, 100);
        assert_eq!(powder.reply(number), Some(Reply::Done));
        powder.request(mark(id(0), next, 40));
        for _ in 0..70 {
            powder.advance(777);
            rest = powder.feed(rest, 64);
        }
        disturb[acts % 4](&mut powder);
    }
    assert!(acts > 10, "{acts}");
    assert_eq!(marked_vectors(&powder), (0..layer.vectors).collect::<Vec<_>>());
}
