//! Abort at every step of a print, and of a device that is gone.

use super::LIGHT_UNCONFIRMED;
use crate::job_world::{CLEAR_UM, Disturbance, World, steps_of_a_print, world_exposing};
use layerd::device::{Act, VatAct};
use layerd::job::{Command, Event, History, JobState, ResumeChoice, ResumeError};

#[test]
fn an_abort_at_any_step_puts_the_light_off_first_then_lifts() {
    // The last steps write that the plate is lifted and the job over.
    for step in 1..steps_of_a_print() - 4 {
        let mut world = World::disturbed(vec![(step, Disturbance::Order(Command::Abort))]);
        assert!(world.run());
        assert_eq!(world.end().0, JobState::Aborted, "step {step}: {:?}", world.end());
        assert!(!world.device.light_on);
        assert!(world.device.position_um.is_none_or(|p| p >= CLEAR_UM), "step {step}: not lifted");
        let history = History::replay(&world.journal).expect("true");
        assert_eq!(history.start(ResumeChoice::None), Err(ResumeError::Over(JobState::Aborted)));
    }
}

#[test]
fn an_abort_of_a_device_that_is_gone_ends_with_a_warning() {
    let mut world = World::disturbed(vec![(60, Disturbance::LineLost { for_us: u64::MAX / 2 })]);
    while world.line_up || world.reconnect_at_us == Some(0) || world.now_us == 0 {
        if world.now_us == 0 {
            world.tell(Event::Ready);
        }
        assert!(world.next_event());
    }
    world.disturb(Disturbance::Order(Command::Abort));
    let lost_at_us = world.now_us;
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Aborted);
    assert!(reason.contains(LIGHT_UNCONFIRMED), "{reason}");
    assert!(world.now_us - lost_at_us < 30_000_000, "it ends soon");
}

#[test]
fn an_abort_whose_line_comes_back_too_late_ends_with_a_warning() {
    let mut world = world_exposing(0);
    world.drop_line(17_000_000);
    world.tell(Event::LineLost("cable".into()));
    world.tell(Event::Command(Command::Abort));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Aborted);
    assert!(reason.contains(LIGHT_UNCONFIRMED), "{reason}");
    assert!(world.device.light_on, "the device ends the bottom layer by itself");
}

#[test]
fn an_abort_that_finds_the_plate_moving_stops_it_before_it_lifts() {
    let moving = |world: &World| matches!(world.device_act, Some((_, Act::Vat(VatAct::Move { .. }))));
    let mut world = world_exposing(1);
    while !moving(&world) {
        assert!(world.next_event());
    }
    world.drop_line(0);
    world.tell(Event::LineLost("cable".into()));
    world.tell(Event::Command(Command::Abort));
    assert!(moving(&world), "no line, no abort");
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    assert_eq!((world.end().0, world.device.position_um), (JobState::Aborted, Some(CLEAR_UM)));
    let lifts = world.acts.iter().filter(|act| matches!(act, Act::Vat(VatAct::Move { position_um: CLEAR_UM, .. })));
    assert_eq!(lifts.count(), 1, "nothing is commanded that the abort on its way would end: {:?}", world.acts);
}
