//! Layers in doubt, and a part that hangs on the plate.

use crate::job_world::{KEY, World, accepted, plan, world_exposing};
use layerd::job::{Command, Engine, Event, History, JobState, Record, ResumeChoice, ResumeError};
use layerd::link::message::{DeviceState, ExposureId, Urgent};

#[test]
fn a_device_reset_under_light_leaves_the_layer_in_doubt_and_never_homes() {
    let mut world = world_exposing(2);
    world.drop_line(3_000_000);
    world.device_act = None;
    let slots = vec![None, None];
    world.device = DeviceState { boot_id: 2, last_exposed: world.device.last_exposed, slots, ..DeviceState::default() };
    world.tell(Event::LineLost("reset".into()));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("layer 2 is in doubt") && reason.contains("--in-doubt exposed"), "{reason}");
    assert!(world.journal.iter().any(|record| matches!(record, Record::InDoubt { exposure: 2, .. })));

    let history = History::replay(&world.journal).expect("true");
    world.engine = Engine::new(plan(), history.start(ResumeChoice::AssumeExposed).expect("decided"));
    world.finished = None;
    world.drop_line(0);
    assert!(world.run());
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("no longer knows where its plate is"), "{reason}");
    assert_eq!(History::replay(&world.journal).expect("true").next_exposure, 3);
}

/// What was said of one layer must not settle a later one: it would have light twice, or too little.
#[test]
fn a_word_about_a_layer_in_doubt_holds_for_no_other() {
    for choice in [ResumeChoice::Repeat, ResumeChoice::AssumeExposed] {
        let mut world = world_exposing(0);
        let history = History::replay(&world.journal).expect("true");
        world.engine = Engine::new(plan(), history.start(choice).expect("the device may not know"));
        world.flushing = None;
        world.drop_line(1_000_000);
        world.tell(Event::Ready);
        while world.device.exposing != Some(ExposureId::first_pass(KEY, 2)) {
            assert!(world.next_event(), "the device knows of layer 0, and the print goes on");
        }
        world.urgent(Urgent::LightOff);
        world.carry_out();
        while world.finished.is_none() {
            assert!(world.next_event());
        }
        assert_eq!((world.end().0, world.exposed.as_slice()), (JobState::Interrupted, [0, 1].as_slice()), "{choice:?}");
        assert!(world.end().1.contains("layer 2 is in doubt: the device ended its light early"), "{}", world.end().1);
    }
    let history = History::replay(&[accepted(), Record::Started { exposure: 0 }]).expect("true");
    assert_eq!(history.start(ResumeChoice::Repeat), Err(ResumeError::NoDoubt { next: "layer 0".into() }));
}

#[test]
fn a_job_whose_device_has_printed_another_since_moves_nothing() {
    let mut world = world_exposing(3);
    world.tell(Event::Shutdown);
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let acts = world.acts.len();
    world.device.last_exposed = Some(ExposureId::first_pass(KEY + 1, 90));
    world.crash();
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    assert!(world.end().0 == JobState::Interrupted && world.end().1.contains("another job"), "{:?}", world.end());
    assert_eq!(world.acts.len(), acts);
}

/// A daemon starts again after these records on layer 0, before which the device had exposed layer 90 of another job.
fn restarted(records: &[Record]) -> World {
    let mut world = World::new();
    world.journal = vec![
        accepted(),
        Record::Started { exposure: 0 },
        Record::LastExposed { job: KEY + 1, layer: 90 },
        Record::Commanded { exposure: 0, boot_id: 1 },
    ];
    world.journal.extend_from_slice(records);
    let history = History::replay(&world.journal).expect("true");
    world.engine = Engine::new(plan(), history.start(ResumeChoice::None).expect("it can go on"));
    world
}

/// A daemon starts again after the operator decided on layer 0, which had an unknown share of its light.
fn decided(exposed: bool) -> World {
    restarted(&[Record::InDoubt { exposure: 0, why: "cut short".into() }, Record::Decided { exposure: 0, exposed }])
}

/// What the device exposed last may be older than the job as long as it confirmed none of the job's layers.
#[test]
fn a_first_layer_that_the_operator_decided_on_goes_on_with_an_older_jobs_exposure_in_the_device() {
    let mut world = decided(true);
    world.device.last_exposed = Some(ExposureId::first_pass(KEY + 1, 90));
    world.device.position_um = Some(50);
    assert!(world.run());
    assert_eq!((world.end(), world.exposed.as_slice()), ((JobState::Completed, ""), [1, 2, 3, 4].as_slice()));
}

/// The device names more than the journal says it had exposed before: another job was printed since, and its part is on the plate.
#[test]
fn a_first_layer_with_light_does_not_go_on_after_another_job() {
    for mut world in [decided(true), decided(false), restarted(&[])] {
        world.device.last_exposed = Some(ExposureId::first_pass(KEY + 1, 91));
        world.device.position_um = Some(50);
        assert!(world.run());
        assert!(world.end().0 == JobState::Interrupted && world.end().1.contains("another job"), "{:?}", world.end());
        assert!(world.acts.is_empty() && world.exposed.is_empty(), "{:?} {:?}", world.acts, world.exposed);
    }
}

/// Cut short and to be repeated, layer 0 hangs on the plate half cured.
#[test]
fn a_device_that_lost_its_position_never_homes_onto_a_layer_that_had_some_light() {
    let mut world = decided(false);
    assert!(world.run());
    assert!(world.end().0 == JobState::Interrupted && world.acts.is_empty(), "{:?} {:?}", world.end(), world.acts);
}

/// A part in the vat keeps the machine until somebody lifted it, or aborts.
#[test]
fn a_stop_that_could_lift_nothing_leaves_the_job_interrupted() {
    let mut world = world_exposing(2);
    world.crash();
    world.tell(Event::Command(Command::Stop));
    world.tell(Event::Shutdown);
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert!(state == JobState::Interrupted && reason.contains("the plate was not lifted"), "{state}: {reason}");
}

#[test]
fn a_plate_that_cannot_be_lifted_is_told() {
    let mut world = world_exposing(1);
    world.drop_line(3_000_000);
    world.device_act = None;
    world.device = DeviceState { boot_id: 2, slots: vec![None, None], ..DeviceState::default() };
    world.tell(Event::LineLost("reset".into()));
    world.tell(Event::Command(Command::Stop));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert!(state == JobState::Interrupted && reason.contains("the plate was not lifted"), "{state}: {reason}");
    assert!(world.engine.progress().part_unparked);
}
