//! The job engine against a device that lies, in virtual time: light that was not commanded, times and positions that are not
//! those commanded, answers that never come, and a host that stood still.

mod job_world;
mod properties;

use job_world::{CLEAR_UM, KEY, LAYERS, Lies, World, world_exposing};
use layerd::device::{Act, Dose, Light};
use layerd::job::{Action, Command, Event, History, JobState, Record, ResumeChoice};
use layerd::link::message::{DeviceState, ExposureId, Refusal, Urgent};
use proptest::prelude::*;

const SECOND_US: u64 = 1_000_000;
/// What light may last beyond its commanded time where the round trip is nothing.
const GRACE_US: u64 = SECOND_US / 2;

fn light_off_at_us(world: &World) -> Option<u64> {
    world.urgents.iter().find(|(_, urgent)| *urgent == Urgent::LightOff).map(|(at_us, _)| *at_us)
}

/// The end of a print that was stopped: dark, the plate clear, resumable.
fn assert_stopped_safely(world: &World) {
    assert_eq!(world.end().0, JobState::Interrupted, "{:?}", world.end());
    assert!(!world.device.light_on && world.device.position_um == Some(CLEAR_UM), "{:?}", world.device);
}

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
    let told = "does not report the end of layer 2's exposure of 2000 ms; it was ordered to switch its light off";
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

/// Steps of an undisturbed print.
fn steps_of_a_print() -> usize {
    let mut world = World::new();
    world.run();
    world.steps
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
        if world.engine.next_action() != Some(layerd::job::Action::Urgent(Urgent::LightOff)) {
            assert_eq!(stopping, JobState::Printing, "step {step}");
            // Only where the last record is being written and the engine has no say any more.
            assert!(world.journal.iter().any(|r| matches!(r, Record::Ended { .. })) || world.flushing.is_some());
            continue;
        }
        world.perform(layerd::job::Action::Urgent(Urgent::LightOff));
        world.carry_out();
        world.finish();
        assert_eq!(world.end().0, JobState::Interrupted, "step {step}: {:?}", world.end());
        assert!(!world.device.light_on && !world.end().1.is_empty(), "step {step}: {:?}", world.end());
        let new = &world.acts[acts..];
        assert!(new.iter().all(|act| matches!(act, Act::Move { .. })), "step {step}: {new:?}");
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

/// An abort that the device neither obeys nor answers goes again in a new session as soon as the device says that it is lit.
#[test]
fn an_abort_that_is_not_obeyed_is_repeated_within_a_second() {
    for ignored in 1..=3u32 {
        let mut world = world_exposing(2);
        world.lies.unheard_aborts = ignored;
        world.device_act = None;
        let began_us = world.now_us;
        world.disturb(job_world::Disturbance::Order(Command::Abort));
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
    world.disturb(job_world::Disturbance::Order(Command::Abort));
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
    world.disturb(job_world::Disturbance::Order(Command::Abort));
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
        while !in_welcome && !matches!(world.device_act, Some((_, Act::Move { .. }))) {
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
    while !matches!(world.device_act, Some((_, Act::Home))) {
        assert!(world.next_event());
    }
    world.disturb(job_world::Disturbance::Order(Command::Abort));
    world.carry_out();
    world.finish();
    let words = "aborted by the operator; the plate was not lifted: the device does not know where it is";
    assert_eq!(world.end(), (JobState::Aborted, words));
}

#[test]
fn a_reported_time_is_compared_with_the_commanded_one() {
    let dose = |reported_ms| Dose::of(2000, reported_ms);
    assert_eq!(
        [dose(1959), dose(1960), dose(2040), dose(2041)],
        [Dose::TooLittle, Dose::Right, Dose::Right, Dose::TooMuch]
    );
    assert_eq!([Dose::of(300, 280), Dose::of(300, 279)], [Dose::Right, Dose::TooLittle], "20 ms at least");
    assert_eq!(Dose::of(u32::MAX, 0), Dose::TooLittle);
    for reported_ms in [0, 200, 1959] {
        let mut world = world_exposing(2);
        world.lies.light_ms = Some(reported_ms);
        world.finish();
        assert_stopped_safely(&world);
        let words =
            format!("layer 2 is in doubt: the device reports {reported_ms} ms of light for layer 2 instead of 2000 ms");
        assert!(world.end().1.contains(&words), "{:?}", world.end());
        world.resume(ResumeChoice::AssumeExposed);
        world.finish();
        assert_eq!((world.end().0, world.exposed.len()), (JobState::Completed, LAYERS as usize), "{:?}", world.end());
    }
    for reported_ms in [2041, 20_000] {
        let mut world = world_exposing(2);
        world.lies.light_ms = Some(reported_ms);
        world.finish();
        assert_stopped_safely(&world);
        let words = format!("the device reports {reported_ms} ms of light for layer 2 instead of 2000 ms");
        assert!(world.end().1.starts_with(&words), "{:?}", world.end());
        assert_eq!(world.engine.progress().light_ms, Some(reported_ms));
        world.resume(ResumeChoice::None);
        world.finish();
        assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
    }
}

/// The time that it reports is right; by the host's clock it cannot be.
#[test]
fn an_exposure_that_ends_too_soon_by_the_hosts_clock_is_in_doubt() {
    let commanded_us = 2 * SECOND_US;
    let ends_after = |part_us: u64, time_scale: f64| {
        let mut world = World::scaled(time_scale);
        world.tell(Event::Ready);
        while world.device.exposing != Some(ExposureId::first_pass(KEY, 2)) {
            assert!(world.next_event());
        }
        world.device_act.as_mut().expect("it shines").0 = world.now_us + part_us;
        world.finish();
        world
    };
    for (part_us, time_scale) in [(0, 1.0), (1_900_000, 1.0), (1_959_000, 1.0), (150_000, 10.0)] {
        let mut world = ends_after(part_us, time_scale);
        assert_stopped_safely(&world);
        let words = format!("layer 2 had its 2000 ms of light, but only {} ms have passed", part_us / 1000);
        assert!(world.end().1.contains("layer 2 is in doubt") && world.end().1.contains(&words), "{:?}", world.end());
        assert!(world.end().1.contains("`time_scale`"), "{:?}", world.end());
        assert_eq!(world.exposed.last(), Some(&2), "nothing more is exposed");
        world.resume(ResumeChoice::AssumeExposed);
        world.finish();
        assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
    }
    for (part_us, time_scale) in [(1_960_000, 1.0), (commanded_us, 1.0), (196_000, 10.0)] {
        let world = ends_after(part_us, time_scale);
        assert_eq!(world.end().0, JobState::Completed, "{part_us} µs, {time_scale}: {:?}", world.end());
    }
}

#[test]
fn a_refused_layer_that_had_light_is_in_doubt_and_not_exposed_again() {
    use Refusal::{
        AlreadyExposed, BadDuration, BadEncoding, BadLayer, BadMove, Busy, NoSuchLayer, NotHomed, NotReady, SlotBusy,
        Unknown,
    };
    let all = [
        NotReady,
        AlreadyExposed,
        BadDuration,
        NoSuchLayer,
        SlotBusy,
        BadLayer,
        BadEncoding,
        BadMove,
        NotHomed,
        Busy,
        Unknown,
    ];
    for (refusal, hidden) in all.into_iter().flat_map(|refusal| [(refusal, false), (refusal, true)]) {
        let mut world = World::new();
        world.lies.refuses_lit = Some((2, refusal, hidden));
        assert!(world.run());
        assert_stopped_safely(&world);
        assert!(world.end().1.contains("layer 2 is in doubt: the device refused it"), "{refusal:?}: {:?}", world.end());
        assert_eq!(world.exposed, [0, 1, 2], "{refusal:?}");
        world.device.cut_short = None;
        world.resume(ResumeChoice::AssumeExposed);
        world.finish();
        assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{refusal:?}: {:?}", world.end());
    }
}

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

/// An exposure that never left the host is certain to have had no light.
#[test]
fn an_exposure_that_was_withdrawn_leaves_the_plate_bare() {
    let records = |last: Record| {
        [job_world::accepted(), Record::Started { layer: 0 }, Record::Commanded { layer: 0, boot_id: 1 }, last]
    };
    let touched = |last| History::replay(&records(last)).expect("true").touched();
    assert!(!touched(Record::Withdrawn { layer: 0 }));
    assert!(touched(Record::NotExposed { layer: 0 }));
}

#[test]
fn a_device_that_withholds_its_state_gains_no_more_than_the_longest_round_trip() {
    let id = ExposureId::first_pass(KEY, 2);
    let mut light = layerd::device::LightWatch::default();
    light.command(id, 6000, 0);
    light.taken(4_800_000);
    assert_eq!(light.limit_us(), Some(2 * SECOND_US + 6 * SECOND_US + GRACE_US));
    light.command(id, 6000, 0);
    light.taken(100_000);
    assert_eq!(light.limit_us(), Some(100_000 + 6 * SECOND_US + GRACE_US));
}

/// Its states do, while the exposure goes on in truth.
#[test]
fn a_layer_that_a_state_names_as_exposed_too_soon_is_in_doubt_and_dark() {
    let mut world = world_exposing(2);
    let began_us = world.now_us;
    world.now_us += SECOND_US / 2;
    let id = ExposureId::first_pass(KEY, 2);
    let lie = DeviceState { last_exposed: Some(id), exposing: None, light_on: false, ..world.device.clone() };
    world.engine.handle(Event::State(lie), world.now_us);
    world.carry_out();
    world.finish();
    assert_eq!(light_off_at_us(&world), Some(began_us + SECOND_US / 2));
    assert_stopped_safely(&world);
    assert!(world.end().1.contains("layer 2 is in doubt: the device says that layer 2 had its"), "{:?}", world.end());
}

/// It says nothing, and names the layer as exposed in the next session.
#[test]
fn an_exposure_that_only_a_state_calls_ended_is_held_to_the_hosts_clock_too() {
    let mut world = world_exposing(2);
    world.device_act.as_mut().expect("it shines").0 = world.now_us + 1000;
    world.drop_line(100_000);
    world.tell(Event::LineLost("cable".into()));
    world.finish();
    assert_stopped_safely(&world);
    assert!(world.end().1.contains("layer 2 is in doubt: the device says that layer 2 had its"), "{:?}", world.end());
}

#[test]
fn a_move_that_ends_too_soon_by_the_hosts_clock_stops_the_print() {
    for to_um in [150, 5150] {
        let mut world = world_exposing(if to_um == 150 { 1 } else { 2 });
        while !matches!(world.device_act, Some((_, Act::Move { position_um, .. })) if position_um == to_um) {
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
    assert!(world.engine.progress().part_in_vat);
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
    assert!(world.engine.progress().part_in_vat);
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

#[test]
fn an_answer_that_never_comes_costs_a_session_and_not_the_print() {
    for step in 1..steps_of_a_print() {
        let mut world = World::disturbed(vec![(step, job_world::Disturbance::Mute)]);
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
fn a_layer_that_the_device_reports_as_exposed_is_not_repeated_and_the_operator_is_told() {
    let mut world = world_exposing(2);
    world.lies.light_ms = Some(100);
    world.finish();
    assert!(world.end().1.contains("layer 2 is in doubt"), "{:?}", world.end());
    for (choice, told) in [(ResumeChoice::AssumeExposed, false), (ResumeChoice::Repeat, true)] {
        let mut world = world_exposing(2);
        world.lies.light_ms = Some(100);
        world.finish();
        world.notices.clear();
        world.resume(choice);
        world.finish();
        assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
        let words = "layer 2 is not repeated: the device reports that it exposed it whole";
        assert_eq!(world.notices.iter().any(|text| text == words), told, "{choice:?}: {:?}", world.notices);
    }
}

/// The doubt is not forgotten where the line is lost on the way up and the device's word settles it.
#[test]
fn a_job_that_ends_for_a_doubt_says_so_even_where_the_device_settles_it() {
    let mut world = world_exposing(2);
    world.lies.light_ms = Some(100);
    while !world.journal.iter().any(|record| matches!(record, Record::InDoubt { .. })) {
        assert!(world.next_event());
    }
    world.drop_line(SECOND_US);
    world.tell(Event::LineLost("cable".into()));
    world.finish();
    assert_eq!(world.end().0, JobState::Interrupted);
    assert!(world.end().1.contains("100 ms of light for layer 2 instead of 2000 ms"), "{:?}", world.end());
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

#[test]
fn a_device_whose_last_exposed_layer_goes_back_stops_the_print() {
    // In a state during the next exposure, and in a welcome.
    for in_welcome in [false, true] {
        let mut world = world_exposing(3);
        world.device.last_exposed = Some(ExposureId::first_pass(KEY, 1));
        if in_welcome {
            world.drop_line(SECOND_US / 2);
            world.tell(Event::LineLost("cable".into()));
        } else {
            world.tell(Event::State(world.device.clone()));
        }
        world.finish();
        assert_stopped_safely(&world);
        let words = "named layer 2 of this job as exposed last, and now it names layer 1: it was reset";
        assert!(world.end().1.contains(words), "{:?}", world.end());
        assert_eq!(world.exposed, [0, 1, 2, 3], "what runs, ends; nothing more is exposed");
        world.resume(ResumeChoice::None);
        world.finish();
        assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
    }
}

/// It forgot the layers before, and with them perhaps the one that was commanded.
#[test]
fn a_layer_that_a_device_denies_whose_memory_went_back_is_in_doubt() {
    let mut world = world_exposing(2);
    while !matches!(world.flushing, Some((_, Record::Commanded { layer: 3, .. }))) {
        assert!(world.next_event());
    }
    // The order is lost on the line.
    world.journal.extend(world.flushing.take().map(|(_, record)| record));
    world.engine.handle(Event::Journalled, world.now_us);
    assert!(matches!(world.engine.next_action(), Some(Action::Act { act: Act::Expose { layer: 3, .. }, .. })));
    world.drop_line(SECOND_US / 2);
    world.tell(Event::LineLost("cable".into()));
    world.device.last_exposed = Some(ExposureId::first_pass(KEY, 1));
    world.finish();
    assert_stopped_safely(&world);
    assert!(world.end().1.contains("layer 3 is in doubt: the device denies"), "{:?}", world.end());
    assert!(world.end().1.contains("named layer 2 of this job as exposed last, and now"), "{:?}", world.end());
}

#[test]
fn another_machine_that_comes_back_in_mid_print_interrupts_the_job_at_once() {
    let mut world = world_exposing(2);
    world.drop_line(u64::MAX / 2);
    world.tell(Event::LineLost("cable".into()));
    let lost_us = world.now_us;
    world.tell(Event::Unfit("machine `bench` is configured with kind dlp, but the device says slm".into()));
    world.reconnect_at_us = None;
    world.finish();
    assert_eq!(world.end().0, JobState::Interrupted);
    assert!(world.now_us - lost_us < SECOND_US, "at once");
    assert!(
        world.end().1.contains("the device says slm") && world.end().1.contains("the plate was not lifted"),
        "{:?}",
        world.end()
    );
    world.resume(ResumeChoice::None);
    world.finish();
    assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
}

/// SIGSTOP, suspend: the timers run first when the host wakes, and what the device said lies unread.
#[test]
fn a_host_that_stood_still_hears_the_device_before_it_judges() {
    for step in 1..steps_of_a_print() {
        let mut world = World::disturbed(vec![(step, job_world::Disturbance::Standstill { for_us: 40 * SECOND_US })]);
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

fn any_lies() -> impl Strategy<Value = Lies> {
    let light = prop::option::weighted(0.3, 0u32..30_000);
    let place = prop::option::weighted(0.3, (prop::sample::select(vec![100, 150, 5100, 5150, CLEAR_UM]), 0i32..30_000));
    (light, place, prop::bool::weighted(0.1), 0u8..10).prop_map(|(light_ms, misplaced, stays_lit, ear)| Lies {
        light_ms,
        misplaced,
        stays_lit,
        mute: ear == 1,
        deaf: ear == 2,
        hasty: ear == 3,
        ..Lies::default()
    })
}

proptest! {
    #![proptest_config(properties::cases(256))]

    /// Whatever a device says, from whichever step on: the job ends, no layer has light twice, the plate does not move down
    /// under light, and an honest device goes on where the journal says.
    #[test]
    fn a_job_ends_whatever_the_device_says(lies in any_lies(), from in 1usize..130, lit in any::<bool>()) {
        let mut world = World::new();
        world.tell(Event::Ready);
        while world.steps < from && world.finished.is_none() {
            world.next_event();
        }
        world.lies = lies;
        if lit && world.line_up && world.device_act.is_none() && world.finished.is_none() {
            world.device.light_on = true;
            world.tell(Event::State(world.device.clone()));
        }
        world.finish();
        let mut seen = world.exposed.clone();
        seen.dedup();
        prop_assert_eq!(&seen, &world.exposed, "a layer twice");
        if world.end().0 == JobState::Interrupted && !lies.stays_lit {
            world.device.light_on = false;
            let in_doubt = History::replay(&world.journal).expect("true").in_doubt.is_some();
            world.resume(if in_doubt { ResumeChoice::AssumeExposed } else { ResumeChoice::None });
            world.finish();
            prop_assert_eq!(world.end().0, JobState::Completed, "{:?}", world.end());
        }
    }
}
