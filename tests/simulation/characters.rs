//! Each character tells its lie, and the facts tell the truth.

use layerd::link::message::{
    DeviceMessage, MachineCapabilities, Refusal, Reply, Report, Request, Urgent, VatReply, VatRequest,
};

use crate::bench::{Bench, CLEAR_UM, EXPOSURE_MS, capabilities, id};
use crate::line::LineFault;
use crate::machine::character::Asked;
use crate::machine::{Character, FactKind, Incident, Interlock, Lie, all};
use crate::rng::Rng;

const SECOND_US: u64 = 1_000_000;
/// Seeds for each character.
const SEEDS: u64 = 6;
const EXPOSURE_US: u64 = EXPOSURE_MS as u64 * 1000;

fn exposed(layer: u32) -> Reply {
    Reply::Vat(VatReply::Exposed { id: id(layer), duration_ms: EXPOSURE_MS })
}

/// Exposes layer 0 and waits until all is over; how long there was light.
fn light_us(bench: &mut Bench) -> Vec<u64> {
    bench.expose(0);
    bench.run_for(20 * SECOND_US);
    bench.lights_us()
}

fn replies_to(bench: &Bench, number: u32) -> Vec<(u64, Reply)> {
    let reply = |(at_us, message): &(u64, DeviceMessage)| match message {
        DeviceMessage::Reply { number: found, reply } if *found == number => Some((*at_us, reply.clone())),
        _ => None,
    };
    bench.heard.iter().filter_map(reply).collect()
}

#[test]
fn every_character_draws_itself_under_its_name() {
    let mut names: Vec<_> = all().iter().map(|(name, _)| *name).collect();
    for (name, draw) in all() {
        for seed in 0..50 {
            let character = draw(&mut Rng::new(seed));
            assert_eq!(character.name(), *name);
            assert_eq!(character, draw(&mut Rng::new(seed)));
        }
    }
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), all().len());
}

/// Whatever it does and whatever happens to it and its line, the time goes on, light ends as it began, and in the end it is dark.
#[test]
fn every_character_comes_to_rest() {
    for (name, draw) in all() {
        let mut lights = 0;
        for seed in 0..SEEDS {
            let mut rng = Rng::new(seed);
            let mut bench = Bench::new(draw(&mut rng), seed);
            for round in 0..6 {
                bench.run_for(SECOND_US);
                bench.request(Request::Vat(VatRequest::Home));
                bench.upload(0, round);
                bench.run_for(rng.below(3 * SECOND_US));
                bench.expose(round);
                bench.request(Request::State);
                bench.run_for(rng.below(SECOND_US));
                harm(&mut bench, &mut rng);
                bench.run_for(rng.below(4 * SECOND_US));
                bench.urgent(if round == 3 { Urgent::Abort } else { Urgent::LightOff });
            }
            bench.run_for(90 * SECOND_US);
            assert!(!bench.machine.is_lit(), "{name}, seed {seed}");
            let ons = bench.saw(|fact| matches!(fact, FactKind::LightOn { .. }));
            assert_eq!(ons, bench.lights_us().len(), "{name}, seed {seed}");
            lights += ons;
            assert!(bench.facts.is_sorted_by_key(|fact| fact.at_us), "{name}, seed {seed}");
            let lied = bench.saw(|fact| matches!(fact, FactKind::Lied(_)));
            assert!(lied <= bench.machine.lies_told() as usize, "{name}, seed {seed}");
            assert!(!bench.machine.is_honest() || lied == 0);
        }
        assert!(lights >= SEEDS as usize, "{name}: only {lights} lights");
    }
}

/// Something happens to the machine or its line.
fn harm(bench: &mut Bench, rng: &mut Rng) {
    let (now_us, for_us) = (bench.now_us, rng.below(3 * SECOND_US));
    match rng.below(10) {
        0 => bench.machine.strike(Incident::Reset, now_us),
        1 => bench.machine.strike(Incident::PowerCut { off_us: for_us }, now_us),
        2 => bench.machine.strike(Incident::InterlockOpens(Interlock::Cover), now_us),
        3 => bench.machine.strike(Incident::InterlockCloses(Interlock::Cover), now_us),
        4 => bench.machine.strike(Incident::PlateMovedByHand { to_um: rng.below(70_000) as i32 }, now_us),
        5 => bench.line.fault(LineFault::Unplugged { for_us }, now_us),
        6 => bench.line.fault(LineFault::Stall { for_us }, now_us),
        7 => bench.line.fault(LineFault::Merge { hold_us: rng.range(1..=50_000), for_us }, now_us),
        8 => bench.line.fault(LineFault::Delay { extra_us: rng.below(SECOND_US), for_us }, now_us),
        _ => bench.renew(),
    }
}

#[test]
fn lit_when_dark() {
    let mut bench = Bench::lying(Lie::LitWhenDark, 3, 2);
    let said = [(); 4].map(|()| bench.state().light_on);
    // The welcome told the first state.
    assert_eq!(said, [false, true, true, false]);
    assert_eq!(bench.saw(|fact| matches!(fact, FactKind::LightOn { .. })), 0);
    assert_eq!(bench.machine.lies_told(), 2);
}

#[test]
fn dark_when_lit_and_nobody_can_change_it() {
    let mut bench = Bench::lying(Lie::DarkWhenLit { extra_us: SECOND_US }, 1, 1);
    let lit = bench.expose(0);
    assert_eq!(bench.answer(lit), exposed(0));
    let state = bench.state();
    assert!(bench.machine.is_lit() && !state.light_on && state.exposing.is_none());
    bench.urgent(Urgent::LightOff);
    bench.run_for(2 * SECOND_US);
    assert_eq!((bench.lights_us(), &bench.urgents), (vec![EXPOSURE_US + SECOND_US], &vec![(1, false)]));
}

#[test]
fn a_lamp_stays_on_until_it_is_put_off() {
    let mut bench = Bench::lying(Lie::LampStays { extra_us: 5 * SECOND_US }, 1, 1);
    assert_eq!(light_us(&mut bench), [EXPOSURE_US + 5 * SECOND_US]);
    let mut bench = Bench::lying(Lie::LampStays { extra_us: 5 * SECOND_US }, 1, 1);
    let lit = bench.expose(0);
    assert_eq!(bench.answer(lit), exposed(0));
    assert!(bench.machine.is_lit() && bench.state().light_on);
    bench.urgent(Urgent::LightOff);
    bench.run_until(|bench| bench.urgents == [(1, false)]);
    assert!(!bench.machine.is_lit() && !bench.state().light_on && bench.lights_us()[0] < EXPOSURE_US + SECOND_US);
}

#[test]
fn a_wrong_dose_or_layer_is_reported() {
    let mut bench = Bench::lying(Lie::WrongDose { percent: 90 }, 1, 1);
    let lit = bench.expose(0);
    let told = VatReply::Exposed { id: id(0), duration_ms: EXPOSURE_MS * 9 / 10 };
    assert_eq!(bench.answer(lit), Reply::Vat(told));
    assert_eq!((bench.lights_us(), bench.exposed()), (vec![EXPOSURE_US], vec![0]));
    let mut bench = Bench::lying(Lie::WrongLayer { offset: 1 }, 1, 1);
    let lit = bench.expose(0);
    assert_eq!((bench.answer(lit), bench.exposed()), (exposed(1), vec![0]));
}

#[test]
fn a_wrong_position_is_reported_until_the_next_move() {
    // The set-up homes and moves.
    let mut bench = Bench::lying(Lie::WrongPosition { offset_um: -60 }, 3, 1);
    let down = bench.move_to(1000);
    assert_eq!(bench.answer(down), Reply::Vat(VatReply::Moved { position_um: 940 }));
    assert_eq!((bench.state().position_um, bench.machine.plate_um()), (Some(940), 1000));
    let down = bench.move_to(500);
    assert_eq!(bench.answer(down), Reply::Vat(VatReply::Moved { position_um: 500 }));
    assert_eq!((bench.state().position_um, bench.machine.plate_um()), (Some(500), 500));
}

#[test]
fn a_plate_goes_elsewhere() {
    let mut bench = Bench::lying(Lie::MovesElsewhere { offset_um: -3000 }, 2, 1);
    for (to_um, at_um) in [(5000, 2000), (5000, 5000)] {
        let down = bench.move_to(to_um);
        assert_eq!(bench.answer(down), Reply::Vat(VatReply::Moved { position_um: at_um }));
        assert_eq!(bench.machine.plate_um(), at_um);
    }
    assert_eq!(bench.saw(|fact| matches!(fact, FactKind::PlateAt { um: 2000, homing: false })), 1);
    assert_eq!(bench.saw(|fact| *fact == FactKind::PlateLeaves { um: 0, to_um: CLEAR_UM, homing: false }), 1);
}

#[test]
fn replies_come_early_late_twice_or_never() {
    let mut bench = Bench::lying(Lie::RepliesEarly { by_us: EXPOSURE_US / 2 }, 3, 1);
    let lit = bench.expose(0);
    assert_eq!(bench.answer(lit), exposed(0));
    assert!(bench.machine.is_lit() && bench.exposed().is_empty());
    bench.run_for(SECOND_US);
    assert_eq!((replies_to(&bench, lit).len(), bench.lights_us()), (1, vec![EXPOSURE_US]));

    let mut bench = Bench::lying(Lie::RepliesLate { of: Asked::Exposure, by_us: 3 * SECOND_US }, 1, 1);
    let began_us = bench.now_us;
    let lit = bench.expose(0);
    assert_eq!(bench.answer(lit), exposed(0));
    assert!(bench.now_us - began_us >= EXPOSURE_US + 3 * SECOND_US && bench.lights_us() == [EXPOSURE_US]);

    for (lie, count) in [(Lie::RepliesTwice { of: Asked::Exposure }, 2), (Lie::RepliesNever { of: Asked::Exposure }, 0)]
    {
        let mut bench = Bench::lying(lie, 1, 1);
        let lit = bench.expose(0);
        bench.run_for(5 * SECOND_US);
        assert_eq!((replies_to(&bench, lit).len(), bench.exposed()), (count, vec![0]), "{lie:?}");
    }
    let mut bench = Bench::lying(Lie::WrongNumber { of: Asked::State, offset: 1000 }, 1, 1);
    let asked = bench.request(Request::State);
    bench.run_for(SECOND_US);
    assert_eq!((replies_to(&bench, asked).len(), replies_to(&bench, asked + 1000).len()), (0, 1));
}

#[test]
fn a_request_is_refused_and_may_be_carried_out_all_the_same() {
    for (obeys, layers) in [(false, vec![]), (true, vec![0])] {
        let lie = Lie::Refuses { of: Asked::Exposure, refusal: Refusal::NoSuchLayer, obeys };
        let mut bench = Bench::lying(lie, 1, 1);
        let lit = bench.expose(0);
        assert_eq!(bench.answer(lit), Reply::Refused(Refusal::NoSuchLayer));
        bench.run_for(5 * SECOND_US);
        assert_eq!((replies_to(&bench, lit).len(), bench.exposed()), (1, layers));
    }
}

#[test]
fn a_wrong_clock_lengthens_and_shortens_acts() {
    for percent in [250, 40] {
        let mut bench = Bench::lying(Lie::WrongClock { percent }, 3, 1);
        let lit = bench.expose(0);
        assert_eq!(bench.answer(lit), exposed(0));
        let right_us = EXPOSURE_US * u64::from(percent) / 100;
        assert!(bench.lights_us()[0].abs_diff(right_us) <= 3, "{:?} {right_us}", bench.lights_us());
        // The next act is right again.
        let began_us = bench.now_us;
        let down = bench.move_to(CLEAR_UM - 20_000);
        bench.answer(down);
        assert!((SECOND_US..SECOND_US + 100_000).contains(&(bench.now_us - began_us)));
    }
}

#[test]
fn a_flood_ends_after_its_count() {
    let mut bench = Bench::lying(Lie::Floods { states: false, every_us: 500 }, 3, 700);
    let before = bench.heard.len();
    bench.move_to(1000);
    bench.run_for(10 * SECOND_US);
    let reports = |(_, message): &&(u64, DeviceMessage)| matches!(message, DeviceMessage::Report(Report::Fault(None)));
    assert_eq!(bench.heard[before..].iter().filter(reports).count(), 700);
    let mut bench = Bench::lying(Lie::Floods { states: true, every_us: 20 }, 3, 700);
    bench.move_to(1000);
    bench.run_for(10 * SECOND_US);
    assert!(replies_to(&bench, u32::MAX).len() > 50, "bounded by the line, not silenced by it");
}

#[test]
fn a_machine_reboots_by_itself() {
    let mut bench =
        Bench::new(Character::Liar { lie: Lie::Reboots { every_us: 4 * SECOND_US }, first: 2, count: 2 }, 9);
    bench.run_for(30 * SECOND_US);
    let starts: Vec<_> = bench.facts.iter().filter(|fact| matches!(fact.what, FactKind::Started { .. })).collect();
    assert_eq!(starts.iter().map(|fact| fact.at_us).collect::<Vec<_>>(), [0, 8 * SECOND_US, 12 * SECOND_US]);
    assert_eq!(bench.welcomes.len(), 3);
}

#[test]
fn a_machine_forgets_what_it_exposed_and_where_its_plate_is() {
    let mut bench = Bench::lying(Lie::LosesMemory, 1, 1);
    let lit = bench.expose(0);
    assert_eq!(bench.answer(lit), exposed(0));
    for (welcomes, last_exposed, position_um) in [(2, None, None), (3, Some(id(0)), Some(0))] {
        bench.machine.strike(Incident::Reset, bench.now_us);
        bench.run_until(|bench| bench.welcomes.len() == welcomes);
        let (_, state) = &bench.welcomes[welcomes - 1];
        assert_eq!((state.last_exposed, state.position_um), (last_exposed, position_um));
        if welcomes == 2 {
            assert_eq!(bench.machine.plate_um(), CLEAR_UM);
            // Nothing keeps it from exposing the layer again.
            bench.upload(0, 0);
            let lit = bench.expose(0);
            assert_eq!(bench.answer(lit), exposed(0));
            bench.ask(Request::Vat(VatRequest::Home));
            assert_eq!((bench.machine.plate_um(), bench.exposed()), (0, vec![0, 0]));
        }
    }
}

#[test]
fn a_machine_comes_back_with_light() {
    let mut bench = Bench::lying(Lie::BackWithLight { for_us: 60 * SECOND_US }, 2, 1);
    assert!(!bench.machine.is_lit());
    bench.renew();
    bench.run_until(|bench| bench.welcomes.len() == 2);
    let (_, state) = &bench.welcomes[1];
    assert!(state.light_on && state.exposing.is_none() && bench.machine.is_lit());
    assert_eq!(bench.saw(|fact| *fact == FactKind::LightOn { id: None, commanded_ms: 0 }), 1);
    bench.urgent(Urgent::Abort);
    bench.run_until(|bench| bench.urgents == [(1, false)]);
    assert!(!bench.machine.is_lit());
}

#[test]
fn a_machine_is_another_one_for_a_session() {
    let mut bench = Bench::lying(Lie::OtherGeometry { wider_px: 8, higher_um: 5_000 }, 2, 1);
    bench.renew();
    bench.run_until(|bench| bench.welcomes.len() == 2);
    bench.renew();
    bench.run_until(|bench| bench.welcomes.len() == 3);
    let sizes: Vec<_> = bench
        .welcomes
        .iter()
        .map(|(told, _)| {
            let MachineCapabilities::Vat(vat) = &told.machine else { panic!("a vat") };
            (vat.width_px, vat.max_position_um)
        })
        .collect();
    assert_eq!(sizes, [(160, 60_000), (168, 65_000), (160, 60_000)]);
    assert_eq!(bench.welcomes[2].0, capabilities());
}

#[test]
fn urgent_orders_are_ignored_or_not_answered() {
    let light_off = |lie| {
        let mut bench = Bench::lying(lie, 1, 1);
        bench.expose(0);
        bench.run_until(|bench| bench.machine.is_lit());
        bench.urgent(Urgent::LightOff);
        bench.run_for(SECOND_US);
        (bench.urgents.clone(), bench.lights_us() == [EXPOSURE_US])
    };
    assert_eq!(light_off(Lie::IgnoresUrgent { answers: true }), (vec![(1, true)], true));
    assert_eq!(light_off(Lie::IgnoresUrgent { answers: false }), (vec![], true));
    assert_eq!(light_off(Lie::SilentUrgent), (vec![], false));
}

#[test]
fn a_state_forgets() {
    let mut bench = Bench::lying(Lie::ForgetsExposed, 1, 1);
    let lit = bench.expose(0);
    bench.answer(lit);
    assert_eq!([(); 2].map(|()| bench.state().last_exposed), [None, Some(id(0))]);
    let mut bench = Bench::lying(Lie::ForgetsSlots, 1, 1);
    assert_eq!([(); 2].map(|()| bench.state().slots[0]), [None, Some(id(0))]);
    let mut bench = Bench::lying(Lie::OtherBoot, 2, 1);
    let boot_id = bench.welcomes[0].1.boot_id;
    assert_eq!([(); 2].map(|()| bench.state().boot_id == boot_id), [false, true]);
}
