//! Whatever a host sends, the laser is bounded, memory is, and no layer is marked twice.

use layerd::layer::Vectors;
use layerd::link::message::{Encoding, HostMessage, PowderRequest, Refusal, Reply, Request, Urgent};
use proptest::prelude::*;

use crate::device_common::powder::{MAX_MS, Powder, Sent, door, id, mark, rings, sent};
use crate::properties;

#[derive(Clone, Debug)]
enum Step {
    Message(HostMessage),
    /// A good layer of this many rings, of which only a part may come.
    Layer {
        slot: u8,
        layer: u32,
        rings: i32,
        share: f64,
    },
    Urgent(Urgent),
    Advance(u64),
    Silence,
    Hello,
    Reset,
    Fault(bool),
}

fn step() -> impl Strategy<Value = Step> {
    let request = prop_oneof![
        6 => (0u32..4, prop_oneof![4 => Just(0u32), 1 => 0u32..50], prop_oneof![Just(0u32), 1u32..3000, Just(MAX_MS + 1)])
            .prop_map(|(layer, from_vector, most_ms)| mark(id(layer), from_vector, most_ms)),
        1 => Just(Request::Powder(PowderRequest::Home)),
        3 => Just(Request::Powder(PowderRequest::Recoat)),
        1 => (-5i32..60_000, 0u32..30_000)
            .prop_map(|(position_um, speed_um_s)| Request::Powder(PowderRequest::Move { position_um, speed_um_s })),
        1 => (0u8..3, 0u32..4, any::<u32>(), any::<bool>()).prop_map(|(slot, layer, encoded_bytes, coded)| {
            let encoding = if coded { Encoding::VectorsCoded } else { Encoding::Vectors };
            Request::LayerBegin { slot, id: id(layer), encoding, encoded_bytes, decoded_crc32: 0 }
        }),
    ];
    let urgent = prop_oneof![Just(Urgent::Abort), Just(Urgent::LightOff), Just(Urgent::Hold), Just(Urgent::Release)];
    prop_oneof![
        6 => request.prop_map(|request| Step::Message(HostMessage::Request { number: 0, request })),
        2 => prop::collection::vec(any::<u8>(), 0..900).prop_map(|bytes| Step::Message(HostMessage::LayerData(bytes))),
        4 => (0u8..2, 0u32..4, 0i32..300, prop_oneof![3 => Just(1.0), 1 => 0.0..1.0f64])
            .prop_map(|(slot, layer, rings, share)| Step::Layer { slot, layer, rings, share }),
        1 => urgent.prop_map(Step::Urgent),
        3 => (0u64..6_000_000).prop_map(Step::Advance),
        3 => (0u64..3000).prop_map(Step::Advance),
        1 => Just(Step::Silence),
        2 => Just(Step::Hello),
        1 => Just(Step::Reset),
        1 => any::<bool>().prop_map(Step::Fault),
    ]
}

proptest! {
    #![proptest_config(properties::cases(200))]

    /// The laser goes on and off in turn, and never for longer than the commanded time and a vector; it is off while the plate moves; the
    /// layers marked only ascend; and the count of bytes taken never passes what was sent.
    #[test]
    fn the_laser_is_bounded_and_no_layer_is_marked_twice(steps in prop::collection::vec(step(), 1..60)) {
        let mut powder = Powder::ready();
        let mut on_line = 0u32;
        for step in steps {
            match step {
                Step::Message(message) => {
                    if let HostMessage::LayerData(bytes) = &message {
                        on_line += bytes.len() as u32;
                    }
                    powder.message(message);
                }
                Step::Layer { slot, layer, rings: count, share } => {
                    let layer_bytes = sent(&rings(count));
                    powder.announce(slot, id(layer), &layer_bytes);
                    let count = (layer_bytes.bytes.len() as f64 * share) as usize;
                    on_line += count as u32;
                    powder.data(&layer_bytes.bytes[..count]);
                }
                Step::Urgent(urgent) => {
                    let light_on = powder.urgent(urgent);
                    prop_assert!(!(light_on && matches!(urgent, Urgent::Abort | Urgent::LightOff)));
                }
                Step::Advance(us) => powder.advance(us),
                Step::Silence => powder.silence(),
                Step::Hello => {
                    powder.greet();
                    on_line = 0;
                }
                Step::Reset => powder.reset(77),
                Step::Fault(begins) => powder.fault(if begins { door() } else { None }),
            }
            if let Some(taken) = powder.rooms.last() {
                prop_assert!(*taken <= on_line, "{} bytes taken of {}", taken, on_line);
            }
        }
        powder.advance(1_000_000_000);
        prop_assert!(!powder.core.state().light_on && powder.core.exposure().is_none());
        let (mut lit_since, mut last) = (None, None);
        for record in &powder.records {
            match record.event {
                "laser_on" => {
                    prop_assert_eq!(lit_since, None);
                    lit_since = Some(record.t_ms);
                }
                "laser_off" => {
                    let since = lit_since.take();
                    prop_assert!(since.is_some_and(|since| record.t_ms - since <= u64::from(MAX_MS) + 10_000));
                }
                "moved" => prop_assert_eq!(lit_since, None),
                "marked" => {
                    prop_assert!(record.layer > last, "{:?} after {:?}", record.layer, last);
                    last = record.layer;
                }
                _ => {}
            }
        }
        prop_assert_eq!(lit_since, None);
    }

    /// Bytes of any kind announced as a layer give Done or a refusal, and never a panic; so do those that are marked while they come.
    #[test]
    fn no_bytes_do_harm(mut bytes in prop::collection::vec(any::<u8>(), 1..6000), good in 0usize..3000, coded in any::<bool>()) {
        let layer = sent(&rings(400));
        let good = good.min(bytes.len()).min(layer.bytes.len());
        bytes[..good].copy_from_slice(&layer.bytes[..good]);
        let encoding = if coded { Encoding::VectorsCoded } else { Encoding::Vectors };
        let mut powder = Powder::ready();
        let hostile = Sent { encoding, bytes, crc32: 0, vectors: 0, marks: Vec::new() };
        let number = powder.announce(0, id(0), &hostile);
        let mut rest = powder.feed(&hostile.bytes, 500);
        let act = powder.request(mark(id(0), 0, 1000));
        for _ in 0..200 {
            powder.advance(20_000);
            rest = powder.feed(rest, 500);
        }
        prop_assert!(!powder.core.state().light_on && powder.core.exposure().is_none());
        prop_assert!(powder.reply(act).is_some());
        prop_assert!(!matches!(powder.reply(number), Some(Reply::Refused(refusal)) if refusal != Refusal::BadLayer));
        // Another layer has all the room.
        powder.greet();
        powder.load(1, id(1), &sent(&Vectors::default()));
    }
}
