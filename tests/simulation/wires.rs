//! The line alone, and an honest machine at its end.

use layerd_wire::session::line_time_us;

use crate::bench::{Bench, CLEAR_UM, EXPOSURE_MS, id};
use crate::line::{KERNEL_BYTES, Line, LineFault};
use crate::machine::{Character, Fact, FactKind, Incident, Interlock};
use crate::parts::BAUD;

const SECOND_US: u64 = 1_000_000;
const NOISE: LineFault = LineFault::Noise {
    loss_per_million: 60_000,
    corrupt_per_million: 40_000,
    duplicate_per_million: 40_000,
    for_us: 100 * SECOND_US,
};

/// The times at which pieces arrive at the device, and the pieces.
fn arrivals(line: &mut Line, mut now_us: u64) -> Vec<(u64, Vec<u8>)> {
    let mut arrived = Vec::new();
    loop {
        arrived.extend(std::iter::from_fn(|| line.device_reads(now_us)).map(|piece| (now_us, piece)));
        let Some(next_us) = line.next_us(now_us) else { return arrived };
        now_us = next_us;
    }
}

fn frames(count: u8) -> Vec<u8> {
    (1..=count).flat_map(|number| [number, number, number, number, 0]).collect()
}

#[test]
fn frames_arrive_one_by_one_at_the_rate_of_the_line() {
    let mut line = Line::new(115_200, 3);
    assert_eq!(line.host_writes(&frames(3), 1000), 15);
    let arrived = arrivals(&mut line, 1000);
    let pieces: Vec<_> = arrived.iter().map(|(_, piece)| piece.as_slice()).collect();
    assert_eq!(pieces, [[1, 1, 1, 1, 0], [2, 2, 2, 2, 0], [3, 3, 3, 3, 0]]);
    let frame_us = line_time_us(5, 115_200);
    assert_eq!([arrived[1].0 - arrived[0].0, arrived[2].0 - arrived[1].0], [frame_us, frame_us]);
    assert!((frame_us + 50..=frame_us + 2_000).contains(&(arrived[0].0 - 1000)), "{arrived:?}");
}

#[test]
fn the_kernel_takes_what_it_has_room_for_and_tells_when_there_is_room_again() {
    let mut line = Line::new(115_200, 3);
    assert_eq!(line.host_writes(&[1; 5000], 0), KERNEL_BYTES);
    assert_eq!((line.host_writes(&[1; 10], 0), line.host_may_write(0)), (0, false));
    let mut now_us = 0;
    while !line.host_may_write(now_us) {
        now_us = line.next_us(now_us).expect("room");
    }
    let sent_us = line_time_us(KERNEL_BYTES - 256, 115_200);
    assert!(now_us.abs_diff(sent_us) <= 2, "{now_us} {sent_us}");
    assert!((250..=256).contains(&line.unsent_bytes(now_us)));
    // A line that stands still does not make room, and the kernel still takes what it has room for.
    line.fault(LineFault::Stall { for_us: SECOND_US }, now_us);
    assert_eq!(line.host_writes(&[1; 5000], now_us + SECOND_US / 2), KERNEL_BYTES - line.unsent_bytes(now_us).min(256));
}

#[test]
fn a_line_that_stands_still_loses_nothing() {
    let (mut still, mut right) = (Line::new(BAUD, 3), Line::new(BAUD, 3));
    for line in [&mut still, &mut right] {
        line.host_writes(&frames(2), 0);
    }
    still.fault(LineFault::Stall { for_us: 700 }, 1);
    let later: Vec<_> = arrivals(&mut right, 0).into_iter().map(|(at_us, piece)| (at_us + 700, piece)).collect();
    assert_eq!(arrivals(&mut still, 1), later);
}

#[test]
fn pieces_are_small_or_come_together() {
    let mut line = Line::new(BAUD, 3);
    line.fault(LineFault::Split { for_us: SECOND_US }, 0);
    line.host_writes(&frames(40), 0);
    let arrived = arrivals(&mut line, 0);
    assert!(arrived.iter().all(|(_, piece)| (1..=7).contains(&piece.len())) && arrived.len() > 40, "{arrived:?}");
    assert_eq!(arrived.into_iter().flat_map(|(_, piece)| piece).collect::<Vec<_>>(), frames(40));
    line.fault(LineFault::Merge { hold_us: 16_000, for_us: SECOND_US }, 2 * SECOND_US);
    line.host_writes(&frames(40), 2 * SECOND_US);
    let arrived = arrivals(&mut line, 2 * SECOND_US);
    assert!(arrived.iter().all(|(at_us, _)| *at_us == 2_016_000), "{arrived:?}");
}

#[test]
fn an_unplugged_line_loses_what_is_on_its_way_and_comes_back() {
    let mut line = Line::new(BAUD, 3);
    line.host_writes(&frames(3), 0);
    line.device_sends(&frames(1), 0);
    line.fault(LineFault::Unplugged { for_us: SECOND_US }, 5);
    assert_eq!((line.is_up(6), line.unpluggings(), line.host_writes(&frames(1), 6)), (false, 1, 0));
    line.device_sends(&frames(1), 500);
    assert!(arrivals(&mut line, 6).is_empty() && line.host_reads(100, SECOND_US + 5).is_empty());
    assert!(line.is_up(SECOND_US + 5));
    assert_eq!(line.host_writes(&frames(1), SECOND_US + 5), 5);
    assert_eq!(arrivals(&mut line, SECOND_US + 5).len(), 1);
}

#[test]
fn a_host_reads_as_much_as_it_wants() {
    let mut line = Line::new(BAUD, 3);
    line.device_sends(&frames(2), 0);
    assert!(!line.device_may_send(1) && !line.host_may_read(1) && line.host_reads(9, 1).is_empty());
    assert!(line.host_may_read(SECOND_US));
    assert_eq!(line.host_reads(7, SECOND_US), frames(2)[..7]);
    assert_eq!(line.host_reads(7, SECOND_US), frames(2)[7..]);
    assert!(line.host_reads(7, SECOND_US).is_empty());
}

fn noisy_print(seed: u64) -> Bench {
    let mut bench = Bench::new(Character::Honest, seed);
    bench.line.fault(NOISE, 0);
    bench.line.fault(LineFault::Delay { extra_us: 20_000, for_us: 100 * SECOND_US }, 0);
    bench.line.fault(LineFault::Split { for_us: SECOND_US }, 4 * SECOND_US);
    bench.print(3);
    bench
}

#[test]
fn an_honest_machine_prints_over_a_noisy_line() {
    for seed in 0..20 {
        let bench = noisy_print(seed);
        assert_eq!(bench.exposed(), [0, 1, 2], "seed {seed}");
        assert_eq!(bench.lights_us(), [u64::from(EXPOSURE_MS) * 1000; 3], "seed {seed}");
        let is_lit_move = |facts: &[Fact]| {
            let mut lit = false;
            facts.iter().any(|fact| {
                match fact.what {
                    FactKind::LightOn { .. } => lit = true,
                    FactKind::LightOff { .. } => lit = false,
                    FactKind::PlateLeaves { .. } => return lit,
                    _ => {}
                }
                false
            })
        };
        assert!(!is_lit_move(&bench.facts) && bench.facts.is_sorted_by_key(|fact| fact.at_us), "seed {seed}");
        assert_eq!((bench.machine.is_lit(), bench.machine.plate_um()), (false, 3_150));
        assert!(bench.machine.is_honest() && bench.saw(|fact| matches!(fact, FactKind::Lied(_))) == 0);
    }
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let (first, second, other) = (noisy_print(1), noisy_print(1), noisy_print(2));
    assert_eq!((first.steps, first.now_us, &first.facts), (second.steps, second.now_us, &second.facts));
    assert_eq!(first.heard, second.heard);
    assert_ne!(first.heard, other.heard);
}

/// A print costs a step for each frame and each act, not for each byte or millisecond.
#[test]
fn a_print_takes_few_steps() {
    let mut bench = Bench::new(Character::Honest, 1);
    bench.print(30);
    assert_eq!(bench.exposed().len(), 30);
    assert!(bench.steps < 30 * 100, "{} steps", bench.steps);
}

#[test]
fn a_power_cut_leaves_the_machine_dark_deaf_and_where_it_was() {
    let mut bench = Bench::new(Character::Honest, 4);
    bench.light_layer_1();
    let (boot_id, plate_um) = (bench.welcomes[0].1.boot_id, bench.machine.plate_um());
    bench.machine.strike(Incident::PowerCut { off_us: 10 * SECOND_US }, bench.now_us);
    assert!(!bench.machine.is_lit() && !bench.machine.is_on());
    let (off_us, welcomes) = (bench.now_us, bench.welcomes.len());
    bench.machine.strike(Incident::PlateMovedByHand { to_um: CLEAR_UM }, off_us);
    bench.run_until(|bench| bench.welcomes.len() > welcomes);
    assert!(bench.now_us > off_us + 10 * SECOND_US);
    let (_, state) = bench.welcomes.last().expect("a welcome");
    assert!(state.boot_id != boot_id && !state.light_on && state.position_um == Some(CLEAR_UM), "{state:?}");
    assert_eq!(state.cut_short.map(|(cut, _)| cut), Some(id(1)));
    assert_eq!(bench.saw(|fact| matches!(fact, FactKind::CutShort { .. })), 1);
    let pushed = FactKind::PlatePushed { from_um: plate_um, to_um: CLEAR_UM };
    assert_eq!(bench.saw(|fact| *fact == pushed), 1);
    assert_eq!(bench.saw(|fact| matches!(fact, FactKind::Started { .. })), 2);
}

#[test]
fn an_open_cover_puts_the_light_off_and_is_reported_as_a_fault() {
    let mut bench = Bench::new(Character::Honest, 4);
    bench.light_layer_1();
    bench.machine.strike(Incident::InterlockOpens(Interlock::Cover), bench.now_us);
    assert!(!bench.machine.is_lit());
    assert_eq!(bench.state().fault.map(|fault| fault.text), Some("the cover is open".into()));
    // A restart does not close it.
    bench.machine.strike(Incident::Reset, bench.now_us);
    let welcomes = bench.welcomes.len();
    bench.run_until(|bench| bench.welcomes.len() > welcomes);
    assert!(bench.state().fault.is_some());
    bench.machine.strike(Incident::InterlockCloses(Interlock::Cover), bench.now_us);
    assert_eq!(bench.state().fault, None);
}

#[test]
fn a_plate_can_be_pushed_only_while_it_rests() {
    let mut bench = Bench::new(Character::Honest, 4);
    bench.print(1);
    let push = |bench: &mut Bench, to_um| bench.machine.strike(Incident::PlateMovedByHand { to_um }, bench.now_us);
    push(&mut bench, 70_000);
    assert_eq!((bench.machine.plate_um(), bench.state().position_um), (60_000, Some(60_000)), "the end of its travel");
    let up = bench.move_to(0);
    bench.run_until(|bench| bench.machine.plate_um() < 60_000);
    push(&mut bench, 1000);
    assert!(bench.machine.plate_um() > 59_000, "{}", bench.machine.plate_um());
    bench.answer(up);
    assert_eq!(bench.saw(|fact| matches!(fact, FactKind::PlatePushed { .. })), 1);
    assert_eq!(bench.saw(|fact| *fact == FactKind::PlateLeaves { um: 60_000, to_um: 0, homing: false }), 1);
    assert_eq!(bench.facts.last().map(|fact| &fact.what), Some(&FactKind::PlateAt { um: 0, homing: false }));
}
