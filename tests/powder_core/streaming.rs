//! Layers that are larger than the buffer: credit, head start, starvation, and what is found to be bad while it is marked.

use layerd::link::message::{Encoding, HostMessage, PowderReply, Refusal, Reply};

use crate::device_common::powder::{BUFFER_BYTES, LASER, Powder, Sent, id, mark, rings, sent, sent_with};

/// Reports come when the count has grown by this much.
const STEP_BYTES: u32 = 256;

fn large(encoding: Encoding) -> Sent {
    let layer = sent_with(&rings(800), encoding, LASER);
    assert!(layer.bytes.len() > 2 * BUFFER_BYTES as usize, "{}", layer.bytes.len());
    layer
}

#[test]
fn a_head_start_of_three_quarters_lets_a_large_layer_begin() {
    let layer = large(Encoding::Vectors);
    let mut powder = Powder::ready();
    let number = powder.announce(0, id(0), &layer);
    powder.refused_with(mark(id(0), 0, 1000), Refusal::NoSuchLayer, "nothing has come");
    let enough = BUFFER_BYTES as usize * 3 / 4;
    for byte in &layer.bytes[..enough - 1] {
        powder.message(HostMessage::LayerData(vec![*byte]));
    }
    assert_eq!((powder.reply(number), &powder.core.state().slots[0]), (None, &None));
    powder.message(HostMessage::LayerData(vec![layer.bytes[enough - 1]]));
    assert_eq!(powder.reply(number), Some(Reply::Done));
    assert_eq!(powder.core.state().slots[0], Some(id(0)));
    assert!(powder.rooms.is_empty(), "nothing has left the buffer: {:?}", powder.rooms);
}

#[test]
fn a_large_layer_streams_under_credit_and_every_report_is_exact() {
    for encoding in [Encoding::Vectors, Encoding::VectorsCoded] {
        let layer = large(encoding);
        let mut powder = Powder::ready();
        let begun = powder.announce(0, id(0), &layer);
        let rest = powder.feed(&layer.bytes, 1000);
        assert_eq!(powder.credit_bytes(), 0, "the host fills the buffer");
        assert_eq!(powder.reply(begun), Some(Reply::Done));
        let number = powder.request(mark(id(0), 0, 10_000));
        let rest = powder.stream(rest);
        let Some(Reply::Powder(PowderReply::Marked { vectors, laser_ms, starved_ms, .. })) = powder.reply(number)
        else {
            panic!("{:?}", powder.reply(number))
        };
        // 800 rings of four vectors of 200 µm and three polygon delays of 20 µs.
        assert_eq!((vectors, laser_ms, starved_ms), (3200, 688, 0), "{encoding:?}");
        assert!(rest.is_empty());
        let steps: Vec<u32> = powder.rooms.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let (last, others) = steps.split_last().expect("many reports");
        assert!(others.iter().all(|step| (STEP_BYTES..STEP_BYTES + 20).contains(step)), "{others:?}");
        assert!(*last < STEP_BYTES + 20 && powder.rooms[0] >= STEP_BYTES);
        assert_eq!(powder.rooms.last(), Some(&(layer.bytes.len() as u32)), "all of it, when it has left the buffer");
    }
}

#[test]
fn late_bytes_interrupt_no_vector_and_the_pause_is_counted() {
    let layer = large(Encoding::Vectors);
    let mut powder = Powder::ready();
    powder.announce(0, id(0), &layer);
    let rest = powder.feed(&layer.bytes, 1000);
    let number = powder.request(mark(id(0), 0, 10_000));
    // The laser takes all that is there, and waits between two vectors.
    powder.advance(1_000_000);
    let state = powder.core.state();
    assert_eq!((state.exposing, state.light_on), (Some(id(0)), false), "it waits");
    let at = powder.next_vector();
    assert!(powder.core.next_timeout_us().is_some(), "its time goes on");
    powder.advance(2_000_000);
    assert_eq!(powder.next_vector(), at, "no vector begins without its bytes");
    // The bytes come again, and it goes on with the next vector; from now on they are in time.
    let credit = powder.credit_bytes();
    assert!(credit > BUFFER_BYTES * 3 / 4, "a starving laser has emptied the buffer: {credit}");
    let rest = powder.feed(rest, 64);
    powder.stream(rest);
    let Some(Reply::Powder(PowderReply::Marked { vectors, laser_ms, starved_ms, .. })) = powder.reply(number) else {
        panic!("{:?}", powder.reply(number))
    };
    assert_eq!((vectors, laser_ms), (3200, 688), "of its light nothing is missing, and nothing came twice");
    assert!((2600..3000).contains(&starved_ms), "{starved_ms}");
    assert_eq!(powder.core.statistics().starved_ms, u64::from(starved_ms));
}

#[test]
fn layers_that_fit_share_the_buffer_and_the_second_waits_for_room() {
    let layer = sent(&rings(110));
    let size = layer.bytes.len() as u32;
    assert!((BUFFER_BYTES / 2 + 1..BUFFER_BYTES).contains(&size), "two do not fit: {size}");
    let mut powder = Powder::ready();
    powder.load(0, id(0), &layer);
    let second = powder.announce(1, id(1), &layer);
    let rest = powder.feed(&layer.bytes, 100);
    assert_eq!((rest.len() as u32, powder.credit_bytes()), (2 * size - BUFFER_BYTES, 0));
    assert_eq!(powder.reply(second), None, "a layer that fits has no head start");
    powder.request(mark(id(0), 0, 10_000));
    powder.mark_to_its_end();
    assert_eq!(powder.rooms.last(), Some(&size));
    assert!(powder.feed(rest, 100).is_empty());
    assert_eq!(powder.reply(second), Some(Reply::Done));
    powder.request(mark(id(1), 0, 10_000));
    powder.mark_to_its_end();
    assert_eq!(powder.core.state().last_exposed, Some(id(1)));
    assert_eq!((powder.rooms.last(), powder.credit_bytes()), (Some(&(2 * size)), BUFFER_BYTES));
}

#[test]
fn a_host_that_sends_more_than_its_credit_loses_the_layer_and_not_its_credit() {
    let layer = large(Encoding::Vectors);
    let mut powder = Powder::ready();
    // A whole small layer fills most of the buffer.
    let small = sent(&rings(110));
    powder.load(1, id(0), &small);
    let number = powder.announce(0, id(1), &layer);
    let credit = powder.credit_bytes() as usize;
    powder.data(&layer.bytes[..credit]);
    assert_eq!(powder.reply(number), None);
    powder.message(HostMessage::LayerData(vec![layer.bytes[credit]]));
    assert_eq!(powder.reply(number), Some(Reply::Refused(Refusal::BadLayer)), "a byte too many");
    assert_eq!(powder.core.state().slots, [None, Some(id(0))], "the other layer stays");
    let taken = BUFFER_BYTES + 1 - small.bytes.len() as u32;
    assert_eq!(powder.rooms, [taken], "its bytes have left the buffer");
    // What still comes of it is taken, too: small amounts with the next layer, more at once.
    powder.data(&layer.bytes[credit + 1..credit + 101]);
    assert_eq!(powder.rooms, [taken]);
    powder.announce(0, id(1), &layer);
    assert_eq!(powder.rooms, [taken, taken + 100]);
    powder.announce(0, id(1), &Sent { bytes: Vec::new(), ..layer.clone() });
    powder.data(&layer.bytes[..STEP_BYTES as usize]);
    assert_eq!(powder.rooms.last(), Some(&(taken + 100 + STEP_BYTES)));
    assert_eq!(powder.core.statistics().stray_bytes, 100 + u64::from(STEP_BYTES));
}

#[test]
fn bad_bytes_in_the_stream_end_the_marking_with_a_fault_that_says_so() {
    let good = large(Encoding::Vectors);
    let mut damaged = good.clone();
    // Heads of no meaning.
    let at = damaged.bytes.len() - 300;
    damaged.bytes[at..].fill(0x1f);
    let mut wrong_crc = good.clone();
    wrong_crc.crc32 ^= 1;
    let mut endless = good.clone();
    endless.bytes.pop();
    for (bad, words, is_whole) in
        [(damaged, "no meaning", false), (wrong_crc, "another CRC", true), (endless, "bytes end", true)]
    {
        let mut powder = Powder::ready();
        powder.announce(0, id(0), &bad);
        let rest = powder.feed(&bad.bytes, 1000);
        let number = powder.request(mark(id(0), 0, 10_000));
        powder.stream(rest);
        assert_eq!(powder.reply(number), Some(Reply::Refused(Refusal::CutShort)), "{words}");
        let fault = powder.faults.last().cloned().flatten().expect("a fault");
        assert!(fault.text.contains(words) && fault.text.starts_with("layer 0: "), "{}", fault.text);
        let state = powder.core.state();
        assert_eq!((state.last_exposed, state.cut_short.map(|(cut, _)| cut)), (None, Some(id(0))), "{words}");
        assert_eq!(powder.next_vector() == bad.vectors, is_whole, "{words}: {}", powder.next_vector());
        powder.advance(2_000_000);
        assert_eq!(powder.faults.last(), Some(&None), "it works again");
        // The right layer goes on where the bad one ended.
        let next = powder.next_vector();
        powder.announce(0, id(0), &good);
        let rest = powder.feed(&good.bytes, 1000);
        powder.request(mark(id(0), next, 10_000));
        powder.stream(rest);
        assert_eq!(powder.core.state().last_exposed, Some(id(0)), "{words}");
    }
}

#[test]
fn a_layer_that_is_given_up_while_it_is_marked_ends_at_a_vector() {
    let layer = large(Encoding::Vectors);
    let mut powder = Powder::ready();
    powder.announce(0, id(0), &layer);
    powder.feed(&layer.bytes, 1000);
    let number = powder.request(mark(id(0), 0, 10_000));
    powder.advance(100_000);
    let small = sent(&rings(3));
    let begun = powder.announce(1, id(1), &small);
    powder.advance(300);
    assert_eq!(powder.reply(number), Some(Reply::Refused(Refusal::CutShort)));
    assert!(powder.feed(&small.bytes, 100).is_empty());
    assert_eq!(powder.reply(begun), Some(Reply::Done));
    powder.announce(1, id(1), &small);
    assert_eq!(powder.credit_bytes(), BUFFER_BYTES);
}
