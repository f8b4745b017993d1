//! What a device says it exposed, and another device.

use super::assert_stopped_safely;
use crate::job_world::{KEY, SECOND_US, world_exposing};
use layerd::device::{Act, VatAct};
use layerd::job::{Action, Event, JobState, Record, ResumeChoice};
use layerd::link::message::ExposureId;

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
    while !matches!(world.flushing, Some((_, Record::Commanded { exposure: 3, .. }))) {
        assert!(world.next_event());
    }
    // The order is lost on the line.
    world.journal.extend(world.flushing.take().map(|(_, record)| record));
    world.engine.handle(Event::Journalled, world.now_us);
    assert!(matches!(
        world.engine.next_action(),
        Some(Action::Act { act: Act::Vat(VatAct::Expose { layer: 3, .. }), .. })
    ));
    world.drop_line(SECOND_US / 2);
    world.tell(Event::LineLost("cable".into()));
    world.device.last_exposed = Some(ExposureId::first_pass(KEY, 1));
    world.finish();
    assert_stopped_safely(&world);
    assert!(
        world.end().1.contains("layer 3 is in doubt: the device says that it did not expose it"),
        "{:?}",
        world.end()
    );
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
