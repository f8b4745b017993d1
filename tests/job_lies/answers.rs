//! Answers that never come, come late or make no sense.

use super::{assert_stopped_safely, light_off_at_us};
use crate::job_world::{CLEAR_UM, Disturbance, KEY, SECOND_US, World, steps_of_a_print, world_exposing};
use layerd::job::{Event, JobState};
use layerd::link::message::ExposureId;

#[test]
fn an_answer_that_never_comes_costs_a_session_and_not_the_print() {
    for step in 1..steps_of_a_print() {
        let mut world = World::disturbed(vec![(step, Disturbance::Mute)]);
        assert!(world.run());
        assert_eq!(world.end().0, JobState::Completed, "step {step}: {:?}", world.end());
        assert!(world.all_exposed_once(), "step {step}: {:?}", world.exposed);
    }
}

/// Its state tells what it did.
#[test]
fn a_device_that_never_says_done_prints_all_the_same() {
    let mut world = world_exposing(2);
    world.lies.mute = true;
    world.finish();
    assert_eq!(world.end(), (JobState::Completed, ""));
    assert!(world.all_exposed_once());
}

#[test]
fn a_device_that_does_nothing_ends_the_job_in_bounded_time() {
    let mut world = world_exposing(2);
    world.lies.deaf = true;
    let began_us = world.now_us;
    world.finish();
    assert_eq!(world.end().0, JobState::Interrupted, "{:?}", world.end());
    assert!(world.end().1.contains("did not reach the device in time: check the line"), "{:?}", world.end());
    assert!(world.now_us - began_us < 240 * SECOND_US, "{} s", (world.now_us - began_us) / SECOND_US);
}

#[test]
fn a_device_that_breaks_the_protocol_three_times_in_a_row_ends_the_job() {
    let mut world = World::new();
    world.upload_us = 60 * SECOND_US;
    world.tell(Event::Ready);
    for _ in 0..3 {
        while world.upload.is_none() {
            assert!(world.next_event());
        }
        world.tell(Event::Misbehaved("the device replied to request 9, which awaits no reply".into()));
    }
    world.finish();
    assert_eq!(world.end().0, JobState::Failed, "{:?}", world.end());
    assert_eq!(world.device.position_um, Some(CLEAR_UM));
    assert!(world.end().1.contains("request 9, which awaits no reply (3 times"), "{:?}", world.end());
}

/// It answers each exposure with nonsense and prints on.
#[test]
fn a_device_that_breaks_the_protocol_at_every_layer_ends_the_job() {
    let mut world = World::new();
    world.tell(Event::Ready);
    let mut breaks = 0;
    while world.finished.is_none() {
        let lit = world.device.exposing.map(|id| id.layer);
        // Two sessions a layer, so that it is never the third in a row.
        let prints = world.line_up && world.engine.state() == JobState::Printing;
        if prints && lit.is_some_and(|layer| breaks < 2 * (layer + 1)) {
            breaks += 1;
            world.tell(Event::Misbehaved("the device replied with nonsense".into()));
        }
        if world.finished.is_none() {
            assert!(world.next_event());
        }
    }
    assert_stopped_safely(&world);
    assert_eq!((breaks, world.exposed.len()), (9, 5), "{:?}", world.end());
    let words =
        "replied with nonsense (it has broken the protocol more than 8 times, more often than once in 50 layers)";
    assert!(world.end().1.contains(words), "{:?}", world.end());
    // So many in a whole print are no reason.
    let mut world = World::new();
    world.tell(Event::Ready);
    for breaks in 0..8 {
        while world.device.exposing.is_none_or(|id| breaks >= 2 * (id.layer + 1)) || !world.line_up {
            assert!(world.next_event());
        }
        world.tell(Event::Misbehaved("the device replied with nonsense".into()));
    }
    world.finish();
    assert_eq!(world.end().0, JobState::Completed, "{:?}", world.end());
}

#[test]
fn an_overdue_move_is_told_with_what_hinders_the_line() {
    let mut world = world_exposing(2);
    world.lies.deaf = true;
    world.engine.hindered(Some("the device takes no data".into()));
    world.finish();
    let words = "did not reach the device in time: check the line; the device takes no data";
    assert!(world.end().1.contains(words), "{:?}", world.end());
}

/// SIGSTOP, suspend: the timers run first when the host wakes, and what the device said lies unread.
#[test]
fn a_host_that_stood_still_hears_the_device_before_it_judges() {
    for step in 1..steps_of_a_print() {
        let mut world = World::disturbed(vec![(step, Disturbance::Standstill { for_us: 40 * SECOND_US })]);
        assert!(world.run(), "step {step}");
        assert_eq!(
            (world.end().0, light_off_at_us(&world)),
            (JobState::Completed, None),
            "step {step}: {:?}",
            world.end()
        );
        assert!(world.all_exposed_once(), "step {step}: {:?}", world.exposed);
    }
}

#[test]
fn the_time_left_follows_the_pace_and_is_silent_without_a_device() {
    let mut world = world_exposing(1);
    let planned_ms = world.engine.progress().eta_ms.expect("it prints");
    // Every layer is late by a minute.
    world.upload_us = 60 * SECOND_US;
    while world.device.exposing != Some(ExposureId::first_pass(KEY, 4)) {
        assert!(world.next_event());
    }
    let progress = world.engine.progress();
    assert!(progress.eta_ms > Some(planned_ms / 4 + 10_000), "{planned_ms} ms, then {:?}", progress.eta_ms);
    world.drop_line(30 * SECOND_US);
    world.tell(Event::LineLost("cable".into()));
    assert_eq!(world.engine.progress().eta_ms, None, "nobody knows when it comes back");
}
