//! A laser machine at the end of a line: its facts, and the lies that only a laser machine tells.

use layerd::device::encoding::encode_vectors;
use layerd::layer::{LaserParameters, MarkClass, Vectors};
use layerd::link::message::{
    Capabilities, DeviceMessage, Encoding, MachineCapabilities, PowderCapabilities, PowderReply, PowderRequest,
    PowderState, Refusal, Reply, Report, Request, Urgent,
};
use layerd_wire::encoding::VectorEncoding;

use crate::bench::{Bench, id};
use crate::machine::{Character, FactKind, Incident, Interlock, KnownLayer, Lie, Machine};
use crate::parts::{BAUD, Filling, Kind};
use crate::plan::characters;
use crate::rng::Rng;

const SECOND_US: u64 = 1_000_000;
/// Vectors of a layer, each marked in 100 ms and connected with the next.
const VECTORS: u32 = 10;
const VECTOR_US: u64 = 100_000;
const LASER_MS: u32 = VECTORS * 100;
/// Seeds for each character.
const SEEDS: u64 = 3;

fn capabilities() -> Capabilities {
    let powder = PowderCapabilities {
        field_um: [10_000, 10_000],
        max_power_mw: 100_000,
        layer_height_um: [20, 100],
        max_position_um: 20_000,
        buffer_bytes: 1024,
    };
    Capabilities {
        encodings: vec![Encoding::Vectors],
        machine: MachineCapabilities::Powder(powder),
        ..crate::bench::capabilities()
    }
}

/// The bytes of a layer, and its checksum.
fn layer() -> (Vec<u8>, u32) {
    let mut vectors = Vectors::default();
    let points: Vec<_> = (0..=VECTORS as i32).map(|number| [1_000 + 800 * number, 5_000]).collect();
    vectors.push_path(MarkClass::Contour, &points);
    let laser =
        LaserParameters { power_mw: 50_000, mark_speed_um_s: 8_000, jump_speed_um_s: 1_000_000, ..Default::default() };
    let mut bytes = Vec::new();
    let sum = encode_vectors(&vectors, VectorEncoding::Plain, [10_000; 2], &[laser; 6], &mut bytes).expect("fits");
    (bytes, sum.crc32)
}

/// A machine of this character, greeted.
fn greeted(character: Character, seed: u64) -> Bench {
    let known = KnownLayer { crc32: layer().1, vectors: VECTORS, laser_ms: LASER_MS };
    let mut bench = Bench::with(Machine::new(capabilities(), BAUD, character, seed).knowing(vec![known]), seed);
    bench.run_until(|bench| !bench.welcomes.is_empty());
    bench
}

fn send(bench: &mut Bench, number: u32) {
    let (bytes, crc32) = layer();
    bench.send_layer(0, number, (Encoding::Vectors, &bytes, crc32));
}

/// A liar from the first occasion on, with powder spread for layer 0, which it holds.
fn lying(lie: Lie, count: u32) -> Bench {
    let mut bench = greeted(Character::Liar { lie, first: 1, count }, 5);
    ready(&mut bench);
    bench
}

fn ready(bench: &mut Bench) {
    assert_eq!(bench.ask(Request::Powder(PowderRequest::Home)), Reply::Powder(PowderReply::Moved { position_um: 0 }));
    let down = PowderRequest::Move { position_um: 50, speed_um_s: 1000 };
    assert_eq!(bench.ask(Request::Powder(down)), Reply::Powder(PowderReply::Moved { position_um: 50 }));
    assert_eq!(bench.ask(Request::Powder(PowderRequest::Recoat)), Reply::Powder(PowderReply::Recoated));
    send(bench, 0);
    bench.run_for(SECOND_US);
}

fn mark(from_vector: u32) -> Request {
    Request::Powder(PowderRequest::Mark { id: id(0), from_vector, most_ms: 20_000 })
}

fn marked(vectors: u32, laser_ms: u32) -> Reply {
    Reply::Powder(PowderReply::Marked { id: id(0), vectors, laser_ms, starved_ms: 0 })
}

fn powder(bench: &mut Bench) -> PowderState {
    bench.state().powder.expect("a powder machine")
}

/// The vectors that the laser was on, and whether each was marked to its end.
fn on_vectors(bench: &Bench) -> Vec<(u32, bool)> {
    let vector = |fact: &FactKind| match fact {
        FactKind::Vector { vector, is_whole, .. } => Some((vector.number, *is_whole)),
        _ => None,
    };
    bench.facts.iter().filter_map(|fact| vector(&fact.what)).collect()
}

#[test]
fn a_layer_is_marked_vector_by_vector() {
    let mut bench = greeted(Character::Honest, 5);
    ready(&mut bench);
    assert_eq!(bench.ask(mark(0)), marked(VECTORS, LASER_MS));
    bench.run_for(SECOND_US);
    assert_eq!(on_vectors(&bench), (0..VECTORS).map(|number| (number, true)).collect::<Vec<_>>());
    assert_eq!(bench.saw(|fact| *fact == FactKind::MarkedWhole { id: id(0), vectors: VECTORS }), 1);
    assert_eq!((bench.saw(|fact| *fact == FactKind::Recoated), bench.lights_us().len()), (1, 1));
    let spans = bench.facts.iter().filter_map(|fact| match fact.what {
        FactKind::Vector { began_us, ended_us, .. } => Some(ended_us - began_us),
        _ => None,
    });
    assert!(
        spans.clone().all(|span_us| span_us.abs_diff(VECTOR_US) < VECTOR_US / 4),
        "{:?}",
        spans.collect::<Vec<_>>()
    );
}

#[test]
fn orders_and_interlocks_stop_within_a_vector_and_silence_at_its_end() {
    type Stop = fn(&mut Bench);
    let open: Stop = |bench| bench.machine.strike(Incident::InterlockOpens(Interlock::Oxygen), bench.now_us);
    let stops: [(Stop, bool); 4] = [
        (|bench| assert_eq!(bench.urgent(Urgent::Abort), 1), false),
        (|bench| assert_eq!(bench.urgent(Urgent::LightOff), 1), false),
        (open, false),
        (|bench| bench.renew(), true),
    ];
    for (number, (stop, is_whole)) in stops.into_iter().enumerate() {
        let mut bench = greeted(Character::Honest, 5);
        ready(&mut bench);
        bench.request(mark(0));
        bench.run_until(|bench| on_vectors(bench).len() == 3);
        stop(&mut bench);
        bench.run_for(2 * SECOND_US);
        let seen = on_vectors(&bench);
        let (last, before) = seen.split_last().expect("vectors");
        assert!(last.1 == is_whole && before.iter().all(|(_, is_whole)| *is_whole), "{number}: {seen:?}");
        assert!(!bench.machine.is_lit() && seen.len() < VECTORS as usize, "{number}");
        assert_eq!(bench.saw(|fact| matches!(fact, FactKind::CutShort { .. })), 1, "{number}");
    }
}

#[test]
fn powder_is_missing_or_forgotten() {
    let mut bench = lying(Lie::NoPowder, 1);
    assert_eq!((powder(&mut bench).recoated, bench.saw(|fact| *fact == FactKind::Recoated)), (true, 0));
    let mut bench = lying(Lie::ForgetsPowder, 1);
    assert_eq!([(); 2].map(|()| powder(&mut bench).recoated), [false, true]);
    assert_eq!(bench.saw(|fact| *fact == FactKind::Recoated), 1);
}

#[test]
fn a_pushed_plate_needs_new_powder() {
    let mut bench = greeted(Character::Honest, 5);
    ready(&mut bench);
    bench.machine.strike(Incident::PlateMovedByHand { to_um: 60 }, bench.now_us);
    assert!(!powder(&mut bench).recoated);
    assert_eq!(bench.ask(mark(0)), Reply::Refused(Refusal::NotRecoated));
}

#[test]
fn another_number_of_vectors_is_told() {
    for offset in [-1, 1_000, i32::MIN] {
        let mut bench = lying(Lie::WrongNextVector { offset }, 1);
        bench.request(mark(0));
        bench.run_until(|bench| on_vectors(bench).len() == 3);
        bench.renew();
        // The laser ends its vector.
        bench.run_for(SECOND_US);
        let [told, truth] = [(); 2].map(|()| powder(&mut bench).next_vector);
        assert_eq!((told, truth as usize), (truth.saturating_add_signed(offset), on_vectors(&bench).len()), "{offset}");
    }
    let mut bench = lying(Lie::WrongCount { offset: -1 }, 1);
    assert_eq!(bench.ask(mark(0)), marked(VECTORS - 1, LASER_MS));
}

#[test]
fn another_room_is_told() {
    let bench = lying(Lie::WrongRoom { offset: 2_000 }, 1);
    let mut honest = greeted(Character::Honest, 5);
    ready(&mut honest);
    let rooms = |mut bench: Bench| -> Vec<u32> {
        bench.ask(mark(0));
        bench.run_for(SECOND_US);
        let room = |message: &DeviceMessage| match message {
            DeviceMessage::Report(Report::Room { taken_bytes }) => Some(*taken_bytes),
            _ => None,
        };
        bench.heard.iter().filter_map(|(_, message)| room(message)).collect()
    };
    let (told, right) = (rooms(bench), rooms(honest));
    let (Some(first), Some(right_first)) = (told.first(), right.first()) else { panic!("{told:?} {right:?}") };
    assert_eq!((*first, &told[1..]), (right_first + 2_000, &right[1..]));
}

#[test]
fn a_layer_is_marked_twice_and_reported_once() {
    let mut bench = lying(Lie::MarksTwice, 1);
    let began_us = bench.now_us;
    assert_eq!(bench.ask(mark(0)), marked(VECTORS, 2 * LASER_MS));
    assert!(bench.now_us - began_us >= 2 * u64::from(LASER_MS) * 1000);
    bench.run_for(SECOND_US);
    assert!(!bench.machine.is_lit() && bench.lights_us().len() == 2, "{:?}", bench.lights_us());
}

#[test]
fn a_layer_is_said_to_be_of_another_job() {
    let mut bench = lying(Lie::OtherJob, 1);
    bench.ask(mark(0));
    let jobs = [(); 2].map(|()| bench.state().last_exposed.map(|told| told.job));
    assert_eq!(jobs, [Some(id(0).job ^ 1), Some(id(0).job)]);
}

#[test]
fn a_report_comes_before_the_layer_is_marked() {
    // The set-up homes, moves and recoats.
    let lie = Lie::RepliesEarly { by_us: 300_000 };
    let mut bench = greeted(Character::Liar { lie, first: 4, count: 1 }, 5);
    ready(&mut bench);
    assert_eq!(bench.ask(mark(0)), marked(VECTORS, LASER_MS));
    assert!(bench.machine.is_lit() && on_vectors(&bench).len() < VECTORS as usize);
}

/// Whatever a laser machine does and whatever happens to it, in the end it is dark, and light ends as it began.
#[test]
fn every_character_comes_to_rest() {
    for (name, draw) in characters(Kind::Laser(Filling::Zigzag)) {
        let mut vectors = 0;
        for seed in 0..SEEDS {
            let mut rng = Rng::new(seed);
            let mut bench = Bench::with(Machine::new(capabilities(), BAUD, draw(&mut rng), seed), seed);
            for round in 0..5 {
                bench.run_for(SECOND_US);
                bench.request(Request::Powder(PowderRequest::Home));
                bench.run_for(2 * SECOND_US);
                bench.request(Request::Powder(PowderRequest::Recoat));
                bench.run_for(3 * SECOND_US + rng.below(2 * SECOND_US));
                send(&mut bench, round);
                let mark = PowderRequest::Mark { id: id(round), from_vector: 0, most_ms: 20_000 };
                bench.request(Request::Powder(mark));
                bench.run_for(rng.below(SECOND_US));
                let to_um = rng.below(500) as i32;
                let incident = rng.pick(&[
                    Incident::Reset,
                    Incident::InterlockOpens(Interlock::LaserPower),
                    Incident::InterlockCloses(Interlock::LaserPower),
                    Incident::PlateMovedByHand { to_um },
                    Incident::PowerCut { off_us: SECOND_US },
                ]);
                bench.machine.strike(incident, bench.now_us);
                bench.run_for(rng.below(2 * SECOND_US));
                bench.urgent(if round == 3 { Urgent::Abort } else { Urgent::LightOff });
                bench.machine.strike(Incident::InterlockCloses(Interlock::LaserPower), bench.now_us);
            }
            bench.run_for(90 * SECOND_US);
            assert!(!bench.machine.is_lit(), "{name}, seed {seed}");
            let ons = bench.saw(|fact| matches!(fact, FactKind::LightOn { .. }));
            assert_eq!(ons, bench.lights_us().len(), "{name}, seed {seed}");
            assert!(bench.facts.is_sorted_by_key(|fact| fact.at_us), "{name}, seed {seed}");
            vectors += on_vectors(&bench).len();
        }
        assert!(vectors > 0, "{name}: no vector");
    }
}
