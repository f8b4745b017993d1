//! Light times that cannot be right, and refused layers that had light.

use super::{assert_stopped_safely, light_off_at_us};
use crate::job_world::{KEY, LAYERS, SECOND_US, World, accepted, world_exposing};
use layerd::device::Dose;
use layerd::job::{Event, History, JobState, Record, ResumeChoice};
use layerd::link::message::{DeviceState, ExposureId, Refusal};

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

/// An exposure that never left the host is certain to have had no light.
#[test]
fn an_exposure_that_was_withdrawn_leaves_the_plate_bare() {
    let records = |last: Record| {
        [accepted(), Record::Started { exposure: 0 }, Record::Commanded { exposure: 0, boot_id: 1 }, last]
    };
    let touched = |last| History::replay(&records(last)).expect("true").touched();
    assert!(!touched(Record::Withdrawn { exposure: 0 }));
    assert!(touched(Record::NotExposed { exposure: 0 }));
}

/// The line holds each order back for almost as long as the layer's light lasts: a device must not gain that time.
#[test]
fn an_exposure_is_timed_from_when_its_order_left_the_host() {
    for honest in [true, false] {
        let mut world = World::new();
        world.line_holds_us = 1_900_000;
        world.tell(Event::Ready);
        while world.device.exposing != Some(ExposureId::first_pass(KEY, 2)) {
            assert!(world.next_event());
        }
        if honest {
            world.finish();
            assert!(world.end().0 == JobState::Completed && world.all_exposed_once(), "{:?}", world.end());
            continue;
        }
        world.device_act.as_mut().expect("it shines").0 = world.now_us + SECOND_US / 10;
        world.finish();
        assert_stopped_safely(&world);
        let words = "layer 2 had its 2000 ms of light, but only 100 ms have passed";
        assert!(world.end().1.contains(words), "{:?}", world.end());
    }
}
