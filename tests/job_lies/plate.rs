//! Plate positions that cannot be right.

use super::assert_stopped_safely;
use crate::job_world::{CLEAR_UM, SECOND_US, World, world_exposing};
use layerd::device::{Act, VatAct};
use layerd::job::{Event, JobState, Record, ResumeChoice};
use layerd::link::message::{DeviceState, Refusal};

/// The first layer had light, whatever the device says of it: the plate must not go down to find its zero position.
#[test]
fn a_job_never_homes_after_a_layer_that_may_have_had_light() {
    for known in [true, false] {
        let mut world = world_exposing(0);
        if known {
            // The host is killed before the refusal; the device denies all.
            world.device_act = None;
            (world.device.exposing, world.device.light_on) = (None, false);
            world.crash();
        } else {
            world.lies.refuses_lit = Some((0, Refusal::NotReady, false));
        }
        while !world.journal.iter().any(|record| matches!(record, Record::NotExposed { .. } | Record::InDoubt { .. })) {
            assert!(world.next_event());
        }
        world.exposed = vec![0];
        world.device.boot_id += 1;
        world.device.position_um = None;
        world.device_act = None;
        world.device.moving = false;
        world.crash();
        if world.finished.is_some() {
            world.resume(ResumeChoice::Repeat);
        }
        let acts = world.acts.len();
        world.finish();
        assert_eq!(world.acts.len(), acts, "nothing moves: {:?}", world.acts);
        assert!(world.end().1.contains("no longer knows where its plate is"), "{:?}", world.end());
    }
}

#[test]
fn a_move_that_ends_too_soon_by_the_hosts_clock_stops_the_print() {
    for to_um in [150, 5150] {
        let mut world = world_exposing(if to_um == 150 { 1 } else { 2 });
        while !matches!(world.device_act, Some((_, Act::Vat(VatAct::Move { position_um, .. }))) if position_um == to_um)
        {
            assert!(world.next_event());
        }
        world.device_act.as_mut().expect("it moves").0 = world.now_us + 1000;
        let exposed = world.exposed.len();
        world.finish();
        assert_stopped_safely(&world);
        let to_mm = f64::from(to_um) / 1000.0;
        let words = format!("its plate arrived at {to_mm:.3} mm 1 ms after the order, which is too soon");
        assert!(world.end().1.contains(&words), "{:?}", world.end());
        assert_eq!(world.exposed.len(), exposed, "nothing more is exposed");
        world.resume(ResumeChoice::None);
        world.finish();
        assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
    }
    // Every move, also the lift clear.
    let mut world = world_exposing(2);
    while world.device.exposing.is_some() {
        assert!(world.next_event());
    }
    world.lies.hasty = true;
    world.finish();
    assert_eq!(world.end().0, JobState::Interrupted, "{:?}", world.end());
    assert!(world.end().1.contains("the plate was not lifted: the device says so too soon"), "{:?}", world.end());
    assert_eq!(world.end().1.matches("`time_scale`").count(), 1, "one cause is told once: {:?}", world.end());
    assert!(world.engine.progress().part_unparked);
}

#[test]
fn a_move_that_ends_elsewhere_stops_the_print_with_the_plate_lifted() {
    // Approach too low, too high; lift too low, too high.
    for (to_um, ends_at_um) in [(150, 120), (150, 400), (5150, 3000), (5150, 5180)] {
        let mut world = World::new();
        world.lies.misplaced = Some((to_um, ends_at_um));
        assert!(world.run());
        assert_stopped_safely(&world);
        let [ends_at_mm, to_mm] = [ends_at_um, to_um].map(|um| f64::from(um) / 1000.0);
        let words = format!("the plate is at {ends_at_mm:.3} mm instead of {to_mm:.3} mm");
        assert!(world.end().1.contains(&words), "{:?}", world.end());
        world.resume(ResumeChoice::None);
        world.finish();
        assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
    }
    // The lift clear itself: what can be done has been done.
    let mut world = World::new();
    world.lies.misplaced = Some((CLEAR_UM, 9000));
    assert!(world.run());
    assert!(
        world.end().0 == JobState::Interrupted && world.end().1.contains("the plate was not lifted"),
        "{:?}",
        world.end()
    );
    assert!(world.engine.progress().part_unparked);
}

#[test]
fn a_move_within_half_a_layer_is_where_it_should_be() {
    let mut world = World::new();
    world.lies.misplaced = Some((5150, 5175));
    assert!(world.run());
    assert_eq!(world.end(), (JobState::Completed, ""));
}

#[test]
fn a_plate_moved_by_hand_during_a_layer_stops_the_print() {
    let mut world = world_exposing(2);
    let moved = DeviceState { position_um: Some(900), ..world.device.clone() };
    world.engine.handle(Event::State(moved), world.now_us);
    world.carry_out();
    world.finish();
    assert_stopped_safely(&world);
    assert!(world.end().1.contains("its plate is at 0.900 mm; it was left at 0.150 mm"), "{:?}", world.end());
    assert_eq!(world.exposed, [0, 1, 2], "the exposure under way ends by itself");
}

/// The line holds the order back for longer than the move takes: a device must not gain that time.
#[test]
fn a_move_is_timed_from_when_its_order_left_the_host() {
    for honest in [true, false] {
        let mut world = world_exposing(1);
        world.line_holds_us = 6 * SECOND_US;
        while !matches!(world.device_act, Some((_, Act::Vat(VatAct::Move { position_um: 5100, .. })))) {
            assert!(world.next_event());
        }
        world.line_holds_us = 0;
        if !honest {
            world.device_act.as_mut().expect("it moves").0 = world.now_us + 1000;
        }
        world.finish();
        if honest {
            assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
            continue;
        }
        assert_stopped_safely(&world);
        let words = "its plate arrived at 5.100 mm 1 ms after the order, which is too soon";
        assert!(world.end().1.contains(words), "{:?}", world.end());
    }
}
