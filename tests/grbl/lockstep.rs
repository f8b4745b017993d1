//! A session and the model of a controller in virtual time: each byte takes its time on the line, and nothing depends on the host's speed.

use std::collections::VecDeque;

use layerd::device::{AxesMotion, ScanTimes, encoding};
use layerd::layer::{LaserParameters, MarkClass, Vectors};
use layerd::link::grbl::{GrblMachine, GrblSession};
use layerd::link::message::{
    DeviceMessage, DeviceState, Encoding, ExposureId, Fault as DeviceFault, HostMessage, PowderReply, PowderRequest,
    Refusal, Reply, Report, Request,
};
use layerd::link::session::HostEvent;
use layerd_wire::encoding::VectorEncoding;

use crate::grbl_model::{Facts, Fault, Firmware, Machine, Options};

const FIELD_UM: [u32; 2] = [40_000, 40_000];
const BAUD: u32 = 115_200;
/// How often both sides are looked at, microseconds.
const TICK_US: u64 = 200;
/// How long a byte takes on the line, microseconds.
const BYTE_US: f64 = 10.0 * 1e6 / BAUD as f64;
/// No layer here takes so long, microseconds: a host would give up.
const PATIENCE_US: u64 = 30_000_000;
/// The layer's depth, micrometres.
const DEPTH_UM: i32 = 300;

/// How a layer ended.
#[derive(Debug, PartialEq)]
enum End {
    Marked,
    Refused(Refusal),
    Fault(DeviceFault),
    Lost,
    TooLong,
}

/// A host that has one layer marked, and the machine.
struct Lockstep {
    session: GrblSession,
    machine: Machine,
    now_us: u64,
    /// Bytes on the line, with the time of their arrival, microseconds.
    line: VecDeque<(u64, u8)>,
    line_free_us: f64,
    waiting: VecDeque<Request>,
    layer: Vec<u8>,
    /// The request under way, and how it was answered.
    number: u32,
    end: Option<End>,
    /// When the line is lost, with what is on its way, and a session begins, microseconds.
    outage_us: Option<u64>,
    /// What the machine said of the layer after that.
    found: Option<DeviceState>,
}

fn grbl_machine() -> GrblMachine {
    GrblMachine {
        field_um: FIELD_UM,
        max_power_mw: 5_000,
        layer_height_um: [50, 200],
        max_position_um: 50_000,
        max_speed_um_s: 100_000,
        acceleration_um_s2: 500_000,
        recoat_gcode: vec!["M8".into(), "G4P0.5".into(), "M9".into()],
    }
}

fn lasers() -> [LaserParameters; MarkClass::ALL.len()] {
    MarkClass::ALL.map(|class| LaserParameters {
        power_mw: if class == MarkClass::Contour { 2_000 } else { 3_000 },
        mark_speed_um_s: if class == MarkClass::Contour { 40_000 } else { 60_000 },
        jump_speed_um_s: 100_000,
        point_time_us: 2_000,
        ..LaserParameters::default()
    })
}

/// Two rings, a zigzag, and some points.
fn vectors() -> Vectors {
    let mut vectors = Vectors::default();
    for centre_um in [[10_000.0, 10_000.0], [14_000.0, 10_000.0]] {
        let corner = |place: i32| {
            let angle = f64::from(place % 40) / 40.0 * std::f64::consts::TAU;
            [centre_um[0] + 1500.0 * angle.cos(), centre_um[1] + 1500.0 * angle.sin()].map(|um: f64| um.round() as i32)
        };
        vectors.push_path(MarkClass::Contour, &(0..=40).map(corner).collect::<Vec<_>>());
    }
    for line in 0..24 {
        let (left_um, right_um, y_um) = (9_000, 11_000, 9_000 + 80 * line);
        let ends =
            if line % 2 == 0 { [[left_um, y_um], [right_um, y_um]] } else { [[right_um, y_um], [left_um, y_um]] };
        vectors.push_path(MarkClass::Hatch, &ends);
    }
    for point in 0..4 {
        vectors.push_path(MarkClass::Point, &[[20_000 + 500 * point, 20_000]]);
    }
    vectors
}

/// Small squares, each of which goes to the controller whole.
fn squares() -> Vectors {
    let mut vectors = Vectors::default();
    for place in 0..12 {
        let [x, y] = [10_000 + 900 * (place % 4), 10_000 + 900 * (place / 4)];
        let corners = [[0, 0], [400, 0], [400, 400], [0, 400], [0, 0]];
        vectors.push_path(MarkClass::Contour, &corners.map(|[right, up]| [x + right, y + up]));
    }
    vectors
}

const LAYER: ExposureId = ExposureId::first_pass(7, 0);

/// The layer's bytes, and what announces them.
fn encoded(vectors: &Vectors) -> (Vec<u8>, Request) {
    let mut layer = Vec::new();
    let sum =
        encoding::encode_vectors(vectors, VectorEncoding::Plain, FIELD_UM, &lasers(), &mut layer).expect("encodes");
    let begin = Request::LayerBegin {
        slot: 0,
        id: LAYER,
        encoding: Encoding::Vectors,
        encoded_bytes: layer.len() as u32,
        decoded_crc32: sum.crc32,
    };
    (layer, begin)
}

fn mark(from_vector: u32) -> Request {
    Request::Powder(PowderRequest::Mark { id: LAYER, from_vector, most_ms: 50_000 })
}

impl Lockstep {
    fn new(options: Options) -> Self {
        Self::of(options, &vectors())
    }

    fn of(options: Options, vectors: &Vectors) -> Self {
        let (layer, begin) = encoded(vectors);
        let acts = [
            PowderRequest::Home,
            PowderRequest::Move { position_um: DEPTH_UM, speed_um_s: 5_000 },
            PowderRequest::Recoat,
        ];
        Self {
            session: GrblSession::new(1, 2, grbl_machine(), 0),
            machine: Machine::new(options),
            now_us: 0,
            line: VecDeque::new(),
            line_free_us: 0.0,
            waiting: std::iter::once(begin).chain(acts.map(Request::Powder)).chain([mark(0)]).collect(),
            layer,
            number: 0,
            end: None,
            outage_us: None,
            found: None,
        }
    }

    /// Runs until the layer has ended, and the machine stands.
    fn run(self) -> (End, Facts) {
        let (end, facts, _) = self.run_to_end();
        (end, facts)
    }

    /// As `run`; and what the machine said of the layer after the line was lost.
    fn run_to_end(mut self) -> (End, Facts, Option<DeviceState>) {
        while self.end.is_none() {
            self.tick();
            if self.now_us > PATIENCE_US {
                self.end = Some(End::TooLong);
            }
        }
        for _ in 0..3_000_000 / TICK_US {
            self.tick();
        }
        let facts = self.machine.facts();
        (self.end.take().unwrap_or(End::TooLong), facts, self.found)
    }

    fn tick(&mut self) {
        self.now_us += TICK_US;
        let now_us = self.now_us;
        if self.outage_us.take_if(|at_us| *at_us <= now_us).is_some() {
            self.line.clear();
            self.machine.take_output();
            self.session.begin(2, now_us);
        }
        self.session.handle_timeout(now_us);
        while self.line_free_us <= now_us as f64
            && let Some(bytes) = self.session.transmit(now_us)
        {
            self.line_free_us = self.line_free_us.max(now_us as f64);
            for byte in bytes {
                self.line_free_us += BYTE_US;
                self.line.push_back((self.line_free_us as u64, byte));
            }
        }
        while self.line.front().is_some_and(|(at_us, _)| *at_us <= now_us) {
            if let Some((at_us, byte)) = self.line.pop_front() {
                self.machine.receive(at_us, byte);
            }
        }
        self.machine.advance(now_us);
        let said = self.machine.take_output();
        if !said.is_empty() {
            self.session.receive(&said, now_us);
        }
        while let Some(event) = self.session.event() {
            self.hear(event);
        }
    }

    fn hear(&mut self, event: HostEvent) {
        match event {
            HostEvent::Connected { session_id: 2, state, .. } => {
                let from_vector = state.powder.as_ref().map_or(0, |powder| powder.next_vector);
                let is_whole = state.last_exposed == Some(LAYER);
                self.found = Some(state);
                let (layer, begin) = encoded(&squares());
                (self.layer, self.waiting) = (layer, [begin, mark(from_vector)].into());
                if is_whole { self.ended(End::Marked) } else { self.next() }
            }
            HostEvent::Connected { .. } => self.next(),
            HostEvent::Message(DeviceMessage::Reply { number, reply }) if number == self.number => match reply {
                Reply::Powder(PowderReply::Marked { .. }) => self.ended(End::Marked),
                Reply::Refused(refusal) => self.ended(End::Refused(refusal)),
                _ => self.next(),
            },
            HostEvent::Message(DeviceMessage::Report(Report::Fault(Some(fault)))) => self.ended(End::Fault(fault)),
            HostEvent::Lost(_) | HostEvent::Refused(_) => self.ended(End::Lost),
            HostEvent::Message(_) | HostEvent::UrgentDone { .. } => {}
        }
    }

    fn ended(&mut self, end: End) {
        self.end.get_or_insert(end);
    }

    fn next(&mut self) {
        let Some(request) = self.waiting.pop_front() else { return };
        self.number += 1;
        let data = matches!(request, Request::LayerBegin { .. })
            .then(|| HostMessage::LayerData(std::mem::take(&mut self.layer)));
        for message in std::iter::once(HostMessage::Request { number: self.number, request }).chain(data) {
            self.session.send(&message).expect("connected");
        }
    }
}

/// What the machine marked, in steps: from, to, `S` and feed.
fn marked(facts: &Facts) -> Vec<[i64; 6]> {
    let steps = |mm: f64| (mm * 250.0).round() as i64;
    let of = |mark: &crate::grbl_model::Mark| {
        let [from, to] = [mark.from_mm, mark.to_mm].map(|point| [steps(point[0]), steps(point[1])]);
        [from[0], from[1], to[0], to[1], mark.s.round() as i64, mark.feed_mm_per_min.round() as i64]
    };
    facts.marks.iter().map(of).collect()
}

#[test]
fn a_layer_takes_the_time_that_was_computed() {
    let motion = AxesMotion { max_speed_um_s: 100_000.0, acceleration_um_s2: 500_000.0, baud: BAUD };
    let computed_ms = u64::from(ScanTimes::of(&vectors(), &lasers(), Some(&motion)).mark_ms);
    for firmware in [Firmware::Grbl11, Firmware::GrblHal] {
        let (end, facts) = Lockstep::new(Options::new(firmware)).run();
        assert_eq!(end, End::Marked);
        assert_eq!(facts.marks.len(), 80 + 24 + 4);
        let took_ms = (facts.marks[facts.marks.len() - 1].ended_us - facts.marks[0].began_us) / 1000;
        assert!(took_ms.abs_diff(computed_ms) * 20 <= took_ms, "{firmware:?}: {took_ms} ms, computed {computed_ms} ms");
    }
}

/// How far the plate may move where it must not, millimetres: until the next position is looked at.
const STRAY_MM: f64 = 1.5;

/// The laser does not burn at rest, and a plate that moves by a wrong line is stopped.
fn assert_safe(facts: &Facts, what: &str) {
    assert!(facts.longest_at_rest_lit_us <= 30_000 && !facts.is_lit, "{what}");
    let ends = facts.jumps.iter().map(|jump| jump.to_mm[2]).chain(facts.marks.iter().map(|mark| mark.to_mm[2]));
    for z_mm in ends {
        let allowed = -f64::from(DEPTH_UM) / 1000.0 - STRAY_MM..=STRAY_MM;
        assert!(allowed.contains(&z_mm), "{what}: the plate went to Z{z_mm}");
    }
}

/// One bit makes a Z of an X, and the beam's jump a move of the plate; it is stopped, and the print ends.
#[test]
fn a_letter_that_names_another_axis_is_noticed_before_the_plate_has_gone_far() {
    let (_, right) = Lockstep::new(Options::new(Firmware::Grbl11)).run();
    let mut strayed = 0;
    for nth in (1..=right.received_bytes).step_by(3) {
        let fault = Fault::FlipByte { nth, mask: 2 };
        let (end, facts) = Lockstep::new(Options::new(Firmware::Grbl11).fault(fault.clone())).run();
        let what = format!("{fault:?}: {end:?}");
        assert_safe(&facts, &what);
        let depth_mm = -f64::from(DEPTH_UM) / 1000.0;
        let is_astray = facts.marks.iter().any(|mark| (mark.to_mm[2] - depth_mm).abs() > 0.02);
        strayed += usize::from(is_astray);
        assert!(!is_astray || end != End::Marked, "{what}: marked at another depth");
    }
    println!("{strayed} prints were stopped with the plate away from its depth");
}

/// Every byte of a print is lost or changed once, each in a print of its own. There is no checksum, so not all of it can be noticed. But
/// the plate is stopped when it leaves its place, the laser never burns at rest, and what is not noticed is one mark in the wrong place or
/// with the wrong power, not more.
#[test]
fn a_byte_that_is_lost_or_changed_is_noticed_or_does_little() {
    let (end, right) = Lockstep::new(Options::new(Firmware::Grbl11)).run();
    assert_eq!(end, End::Marked);
    let (bytes, right) = (right.received_bytes, marked(&right));
    let (mut harmless, mut noticed, mut unnoticed) = (0, 0, 0);
    let stride = 11;
    for (round, nth) in (1..=bytes).step_by(stride).enumerate() {
        let fault = match round % 2 {
            0 => Fault::LoseByte { nth },
            _ => Fault::FlipByte { nth, mask: 1 << (round / 2 % 7) },
        };
        let (end, facts) = Lockstep::new(Options::new(Firmware::Grbl11).fault(fault.clone())).run();
        let what = format!("{fault:?}: {end:?}");
        assert_safe(&facts, &what);
        let found = marked(&facts);
        match end {
            End::Marked if found == right => harmless += 1,
            End::Marked => {
                let wrong = right.iter().filter(|mark| !found.contains(mark)).count();
                assert!(wrong <= 2 && found.len().abs_diff(right.len()) <= 1, "{what}: {wrong} marks are wrong");
                unnoticed += 1;
            }
            // The host limits the time of every act. Here it is the recoater's.
            End::TooLong | End::Refused(_) | End::Fault(_) | End::Lost => noticed += 1,
        }
    }
    println!(
        "of {} bytes: {harmless} did nothing, {noticed} were noticed, {unnoticed} were not",
        harmless + noticed + unnoticed
    );
    assert!(noticed > unnoticed, "{noticed} noticed, {unnoticed} not");
}

/// A ring ends where it begins, so a beam that was stopped there does not tell whether the ring is marked. But a controller that came to
/// rest by itself has done all that it answered.
#[test]
fn a_lost_line_leaves_few_rings_in_doubt() {
    let (end, facts) = Lockstep::of(Options::new(Firmware::Grbl11), &squares()).run();
    assert_eq!((end, facts.marks.len()), (End::Marked, 48));
    let (from_us, to_us) = (facts.marks[0].began_us, facts.marks[47].ended_us);
    let right = marked(&facts);
    let (mut doubts, count) = (0, 60);
    for number in 0..count {
        let outage_us = from_us + (to_us - from_us) * number / count;
        let what = format!("lost after {outage_us} us");
        let mut lockstep = Lockstep::of(Options::new(Firmware::Grbl11), &squares());
        lockstep.outage_us = Some(outage_us);
        let (end, facts, found) = lockstep.run_to_end();
        assert_eq!(end, End::Marked, "{what}");
        let found = found.expect("a second session");
        if found.powder.is_some_and(|powder| powder.broken) {
            doubts += 1;
        } else {
            assert_eq!(marked(&facts), right, "{what}");
        }
        assert!(right.iter().all(|mark| marked(&facts).contains(mark)), "{what}");
    }
    println!("{doubts} of {count} lost lines left a doubt");
    // When no answer came yet to a ring that was sent.
    assert!(doubts * 3 < count, "{doubts} of {count}");
}
