//! Aborts that are not obeyed or not answered.

use crate::job_world::{CLEAR_UM, Disturbance, KEY, Lies, SECOND_US, World, world_exposing};
use layerd::device::{Act, Light, VatAct};
use layerd::job::{Command, Event, JobState};
use layerd::link::message::{ExposureId, Urgent};

/// An abort that the device neither obeys nor answers goes again in a new session as soon as the device says that it is lit.
#[test]
fn an_abort_that_is_not_obeyed_is_repeated_within_a_second() {
    for ignored in 1..=3u32 {
        let mut world = world_exposing(2);
        world.lies.unheard_aborts = ignored;
        world.device_act = None;
        let began_us = world.now_us;
        world.disturb(Disturbance::Order(Command::Abort));
        world.carry_out();
        while world.device.light_on {
            assert!(world.next_event());
        }
        let lit_us = world.now_us - began_us;
        assert!(lit_us <= u64::from(ignored) * SECOND_US, "{ignored} aborts ignored: {lit_us} µs of light");
        let orders = world.urgents.iter().filter(|(_, urgent)| *urgent == Urgent::Abort).count();
        assert_eq!(orders as u32, ignored + 1);
        world.finish();
        assert_eq!(world.end().0, JobState::Aborted, "{:?}", world.end());
        assert_eq!(world.device.position_um, Some(CLEAR_UM), "{:?}", world.end());
    }
}

#[test]
fn an_abort_that_is_never_obeyed_ends_with_the_mains_warning_within_seconds() {
    let mut world = world_exposing(2);
    world.lies.unheard_aborts = u32::MAX;
    world.device_act = None;
    let (began_us, acts) = (world.now_us, world.acts.len());
    world.disturb(Disturbance::Order(Command::Abort));
    world.carry_out();
    world.finish();
    assert_eq!((world.end().0, world.acts.len()), (JobState::Aborted, acts), "{:?}", world.end());
    assert!(world.end().1.contains("switch the machine off at its mains"), "{:?}", world.end());
    assert!(world.now_us - began_us < 5 * SECOND_US, "{} µs", world.now_us - began_us);
    let orders = world.urgents.iter().filter(|(_, urgent)| *urgent == Urgent::Abort).count();
    assert!(orders >= 5, "one a session: {orders}");
}

fn times_of(world: &World, kind: Urgent) -> Vec<u64> {
    world.urgents.iter().filter(|(_, urgent)| *urgent == kind).map(|(at_us, _)| *at_us).collect()
}

/// A layer being exposed for ten minutes, as far as the device is concerned, and an abort.
fn abort_of(lies: Lies) -> (World, u64) {
    let mut world = world_exposing(2);
    world.lies = lies;
    world.device_act = None;
    let began_us = world.now_us;
    world.disturb(Disturbance::Order(Command::Abort));
    world.carry_out();
    (world, began_us)
}

#[test]
fn light_that_an_abort_leaves_on_is_put_off_by_a_light_off() {
    let (mut world, began_us) = abort_of(Lies { deaf_to_aborts: true, ..Lies::default() });
    while world.device.light_on {
        assert!(world.next_event());
    }
    assert!(world.now_us - began_us < SECOND_US / 10, "{} µs of light", world.now_us - began_us);
    world.finish();
    assert_eq!((world.end().0, world.device.position_um), (JobState::Aborted, Some(CLEAR_UM)), "{:?}", world.end());
    assert!(!world.end().1.contains("mains"), "{:?}", world.end());
}

#[test]
fn an_abort_answered_with_the_light_on_goes_again_after_half_a_second_and_no_light_is_right_after_it() {
    let (mut world, began_us) = abort_of(Lies { stays_lit: true, ..Lies::default() });
    let acts = world.acts.len();
    world.finish();
    assert_eq!((world.end().0, world.acts.len()), (JobState::Aborted, acts), "{:?}", world.end());
    assert!(world.end().1.contains("switch the machine off at its mains"), "{:?}", world.end());
    let aborts = times_of(&world, Urgent::Abort);
    assert_eq!(aborts.len(), 5, "{aborts:?}");
    assert!(aborts.windows(2).all(|pair| pair[1] - pair[0] >= SECOND_US / 2), "{aborts:?}");
    assert!(world.now_us - began_us < 5 * SECOND_US, "{} µs", world.now_us - began_us);
    assert!(times_of(&world, Urgent::LightOff).len() >= 5, "{:?}", world.urgents);
    // Whoever watches after the job goes on: the light is not the commanded one.
    let mut light = world.engine.light().clone();
    assert!(light.is_unwanted());
    let id = world.device.exposing.expect("lit");
    light.found(id, 600_000, world.now_us);
    let seen = light.observe(&world.device, began_us + 5_200_000);
    assert!(matches!(seen, Light::Uncommanded(_)) && light.stays_lit(), "{seen:?}");
}

/// The protocol allows 100 ms; the answer may come before its light is off.
#[test]
fn a_light_that_goes_off_within_the_time_allowed_after_an_abort_is_no_fault() {
    for after_ms in [20, 60, 90] {
        let lies = Lies { dark_after_us: Some(after_ms * 1000), ..Lies::default() };
        let (mut world, began_us) = abort_of(lies);
        world.finish();
        assert_eq!((world.end().0, world.device.position_um), (JobState::Aborted, Some(CLEAR_UM)), "{:?}", world.end());
        assert!(!world.end().1.contains("mains") && !world.end().1.contains("not lifted"), "{:?}", world.end());
        assert_eq!(times_of(&world, Urgent::Abort), [began_us], "obeyed the first time");
    }
}

#[test]
fn light_that_comes_back_after_an_obeyed_abort_is_put_off_at_once() {
    for in_welcome in [true, false] {
        let (mut world, _) = abort_of(Lies::default());
        while !in_welcome && !matches!(world.device_act, Some((_, Act::Vat(VatAct::Move { .. })))) {
            assert!(world.next_event());
        }
        let acts = world.acts.len();
        (world.device.light_on, world.device.exposing) = (true, Some(ExposureId::first_pass(KEY, 2)));
        let lit_us = if in_welcome { world.reconnect_at_us.expect("a new session") } else { world.now_us };
        if !in_welcome {
            world.tell(Event::State(world.device.clone()));
        }
        while world.device.light_on {
            assert!(world.next_event());
            assert!(!world.device.light_on || world.acts.len() == acts, "nothing moves under light");
        }
        assert!(world.now_us - lit_us <= 10_000, "in a welcome {in_welcome}: {} µs", world.now_us - lit_us);
        world.finish();
        assert_eq!((world.end().0, world.device.position_um), (JobState::Aborted, Some(CLEAR_UM)), "{:?}", world.end());
    }
}

#[test]
fn an_abort_that_cannot_lift_the_plate_says_why() {
    let mut world = World::new();
    world.tell(Event::Ready);
    while !matches!(world.device_act, Some((_, Act::Vat(VatAct::Home)))) {
        assert!(world.next_event());
    }
    world.disturb(Disturbance::Order(Command::Abort));
    world.carry_out();
    world.finish();
    let words = "aborted by the operator; the plate was not lifted: the device does not know where it is";
    assert_eq!(world.end(), (JobState::Aborted, words));
}
