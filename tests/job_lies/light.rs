//! Light that was not commanded, or lasts too long.

use super::{GRACE_US, assert_stopped_safely, light_off_at_us};
use crate::job_world::{KEY, SECOND_US, World, steps_of_a_print, world_exposing};
use layerd::device::{Act, LightWatch, VatAct};
use layerd::job::{Action, Event, History, JobState, Record, ResumeChoice};
use layerd::link::message::{ExposureId, Urgent};

#[test]
fn light_that_outlasts_its_exposure_is_put_off() {
    let mut world = world_exposing(2);
    let began_us = world.now_us;
    world.device_act = None;
    world.finish();
    let off_us = light_off_at_us(&world).expect("put off");
    assert_eq!(off_us - began_us, 2 * SECOND_US + GRACE_US, "the commanded time and the grace");
    assert_stopped_safely(&world);
    assert!(world.end().1.contains("layer 2 is in doubt"), "{:?}", world.end());
    let told = "does not report the end of layer 2's exposure of 2000 ms; it was told to switch its light off";
    assert!(world.notices.iter().any(|text| text.contains(told)), "{:?}", world.notices);
}

/// Its line was cut during an exposure; the device comes back with the light on.
#[test]
fn a_device_that_comes_back_lit_is_dark_by_the_end_of_the_commanded_time() {
    for (away_us, off_after_us) in [(SECOND_US, 2 * SECOND_US + GRACE_US), (10 * SECOND_US, 10 * SECOND_US)] {
        let mut world = world_exposing(2);
        let began_us = world.now_us;
        world.device_act = None;
        world.drop_line(away_us);
        world.tell(Event::LineLost("cable".into()));
        let acts = world.acts.len();
        world.finish();
        let off_us = light_off_at_us(&world).expect("put off");
        assert!(off_us - began_us <= off_after_us + 1, "away for {away_us} µs: {} µs", off_us - began_us);
        assert!(off_us - began_us >= off_after_us, "the commanded time is its own: {} µs", off_us - began_us);
        assert_stopped_safely(&world);
        assert_eq!(world.acts.len() - acts, 1, "nothing but the lift: {:?}", world.acts);
    }
}

#[test]
fn a_device_that_comes_back_in_its_commanded_light_may_end_it() {
    let mut world = world_exposing(2);
    world.drop_line(SECOND_US);
    world.tell(Event::LineLost("cable".into()));
    world.finish();
    assert_eq!((world.end(), light_off_at_us(&world)), ((JobState::Completed, ""), None));
    assert!(world.all_exposed_once());
}

/// A crash of the host: the new process finds the exposure under way and does not know since when.
#[test]
fn light_found_after_a_crash_gets_its_commanded_time_once() {
    let mut world = world_exposing(2);
    world.device_act = None;
    world.crash();
    let found_us = world.reconnect_at_us.expect("the line comes back");
    world.finish();
    let off_us = light_off_at_us(&world).expect("put off");
    assert!(off_us - found_us <= 2 * SECOND_US + GRACE_US + 1, "{} µs", off_us - found_us);
    assert_stopped_safely(&world);
}

#[test]
fn an_exposure_of_an_earlier_start_of_the_device_is_put_off_at_once() {
    let mut world = world_exposing(2);
    world.device_act = None;
    world.device.boot_id += 1;
    world.crash();
    let found_us = world.reconnect_at_us.expect("the line comes back");
    world.finish();
    assert_eq!(light_off_at_us(&world), Some(found_us));
    assert_eq!(world.end().0, JobState::Interrupted);
}

#[test]
fn light_without_an_exposure_is_put_off_at_every_step_and_the_print_stops() {
    let others = Some(ExposureId::first_pass(KEY + 1, 3));
    for (step, exposing) in (1..steps_of_a_print() - 2).flat_map(|step| [(step, None), (step, others)]) {
        let mut world = World::new();
        world.tell(Event::Ready);
        while world.steps < step && world.finished.is_none() {
            assert!(world.next_event());
        }
        if world.finished.is_some() || world.device.exposing.is_some() || !world.line_up {
            continue;
        }
        (world.device.light_on, world.device.exposing) = (true, exposing);
        let acts = world.acts.len();
        world.engine.handle(Event::State(world.device.clone()), world.now_us);
        let stopping = world.engine.progress().state;
        if world.engine.next_action() != Some(Action::Urgent(Urgent::LightOff)) {
            assert_eq!(stopping, JobState::Printing, "step {step}");
            // Only where the last record is being written and the engine has no say any more.
            assert!(world.journal.iter().any(|r| matches!(r, Record::Ended { .. })) || world.flushing.is_some());
            continue;
        }
        world.perform(Action::Urgent(Urgent::LightOff));
        world.carry_out();
        world.finish();
        assert_eq!(world.end().0, JobState::Interrupted, "step {step}: {:?}", world.end());
        assert!(!world.device.light_on && !world.end().1.is_empty(), "step {step}: {:?}", world.end());
        let new = &world.acts[acts..];
        assert!(new.iter().all(|act| matches!(act, Act::Vat(VatAct::Move { .. }))), "step {step}: {new:?}");
        world.device.cut_short = None;
        let in_doubt = History::replay(&world.journal).expect("true").in_doubt.is_some();
        world.resume(if in_doubt { ResumeChoice::Repeat } else { ResumeChoice::None });
        world.finish();
        assert_eq!(world.end().0, JobState::Completed, "step {step}: {:?}", world.end());
        assert!(world.all_exposed_once(), "step {step}: {:?}", world.exposed);
    }
}

#[test]
fn a_device_that_stays_lit_moves_nothing_and_is_told_in_capitals() {
    let mut world = world_exposing(2);
    world.lies.stays_lit = true;
    world.device_act = None;
    let (began_us, acts) = (world.now_us, world.acts.len());
    world.finish();
    assert_eq!((world.end().0, world.acts.len()), (JobState::Interrupted, acts), "{:?}", world.end());
    assert!(world.end().1.contains("WARNING: the device does not switch its light off"), "{:?}", world.end());
    assert!(world.now_us - began_us < 20 * SECOND_US, "{} µs", world.now_us - began_us);
    let orders = world.urgents.iter().filter(|(_, urgent)| *urgent == Urgent::LightOff).count();
    assert!(orders > 3, "told again and again: {orders}");
}

#[test]
fn a_device_that_withholds_its_state_gains_no_more_than_the_longest_round_trip() {
    let id = ExposureId::first_pass(KEY, 2);
    let mut light = LightWatch::default();
    light.command(id, 6000, 0);
    light.taken(4_800_000);
    assert_eq!(light.limit_us(), Some(2 * SECOND_US + 6 * SECOND_US + GRACE_US));
    light.command(id, 6000, 0);
    light.taken(100_000);
    assert_eq!(light.limit_us(), Some(100_000 + 6 * SECOND_US + GRACE_US));
}
