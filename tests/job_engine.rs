//! The job engine against a scripted device under virtual time: the print as it should go, every disturbance at every step.

mod job_world;
mod properties;

use job_world::{CLEAR_UM, Disturbance, KEY, LAYERS, World, accepted, plan, world_exposing};
use layerd::device::Act;
use layerd::job::{Command, EndOrder, Engine, Event, History, JobState, Record, ResumeChoice, ResumeError};
use layerd::link::message::{DeviceState, ExposureId, Fault, Urgent};
use proptest::prelude::*;

const SECOND_US: u64 = 1_000_000;

/// What an abort says that nobody confirmed.
const LIGHT_UNCONFIRMED: &str = "did not confirm that its light is off";

#[test]
fn a_print_homes_exposes_every_layer_and_lifts_clear() {
    let mut world = World::new();
    assert!(world.run());
    assert_eq!(world.end(), (JobState::Completed, ""));
    assert!(world.all_exposed_once());
    let moves: Vec<_> = world
        .acts
        .iter()
        .filter_map(|act| if let Act::Move { position_um, .. } = act { Some(*position_um) } else { None })
        .collect();
    assert_eq!(world.acts[0], Act::Home);
    assert_eq!(moves, [50, 5050, 100, 5100, 150, 5150, 200, 5200, 250, CLEAR_UM]);
    let progress = world.engine.progress();
    assert_eq!((progress.late_layers, progress.layers_done, progress.eta_ms), (0, LAYERS, None));
    let history = History::replay(&world.journal).expect("true");
    assert_eq!((history.state, history.next_layer), (JobState::Completed, LAYERS));
}

#[test]
fn a_late_layer_is_waited_for_counted_and_timed() {
    let mut world = World::new();
    world.upload_us = 30_000_000;
    assert!(world.run());
    assert_eq!(world.end().0, JobState::Completed);
    assert!(world.all_exposed_once());
    let progress = world.engine.progress();
    assert!((3..=4).contains(&progress.late_layers), "{progress:?}");
    assert!(progress.late_ms_total > 30_000, "{progress:?}");
}

/// Steps of an undisturbed print: disturbances fall on each of them.
fn steps_of_a_print() -> usize {
    let mut world = World::new();
    world.run();
    world.steps
}

#[test]
fn a_pause_at_any_step_lifts_clear_and_resume_goes_on_at_the_right_layer() {
    for step in 1..steps_of_a_print() {
        let mut world = World::disturbed(vec![(step, Disturbance::Order(Command::Pause))]);
        if !world.run() {
            assert!(world.device.position_um.is_none_or(|p| p >= CLEAR_UM), "step {step}: not clear");
            assert!(!world.device.light_on);
            world.tell(Event::Command(Command::Resume));
            while world.finished.is_none() {
                assert!(world.next_event(), "step {step}: stuck");
            }
        }
        assert_eq!(world.end().0, JobState::Completed, "step {step}");
        assert!(world.all_exposed_once(), "step {step}: {:?}", world.exposed);
    }
}

#[test]
fn a_stop_at_any_step_ends_after_the_layer_with_the_plate_clear() {
    for step in 1..steps_of_a_print() - 8 {
        let mut world = World::disturbed(vec![(step, Disturbance::Order(Command::Stop))]);
        assert!(world.run());
        let done = world.engine.progress().layers_done;
        assert_eq!(world.end().0, JobState::Stopped, "step {step}");
        assert_eq!(world.exposed, (0..done).collect::<Vec<_>>(), "no layer is left half");
        assert!(world.exposed.is_empty() || world.device.position_um >= Some(CLEAR_UM), "step {step}");
    }
}

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
fn a_job_taken_up_after_a_crash_can_be_ended_at_once_dark_and_clear() {
    for (command, state) in [(Command::Stop, JobState::Stopped), (Command::Abort, JobState::Aborted)] {
        for step in 1..steps_of_a_print() - 8 {
            let mut world = World::disturbed(vec![(step, Disturbance::Crash), (step, Disturbance::Order(command))]);
            assert!(world.run());
            assert_eq!(world.end().0, state, "step {step}: {:?}", world.end());
            assert!(!world.device.light_on, "step {step}");
            let bare =
                world.exposed.is_empty() && world.device.last_exposed.is_none() && world.device.cut_short.is_none();
            assert!(bare || world.device.position_um >= Some(CLEAR_UM), "step {step}: {:?}", world.device);
        }
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
fn a_shutdown_at_any_step_leaves_a_job_that_can_be_resumed() {
    for step in 1..steps_of_a_print() - 8 {
        let mut world = World::disturbed(vec![(step, Disturbance::Shutdown)]);
        assert!(world.run());
        let (state, reason) = world.end();
        if state == JobState::Failed {
            continue;
        }
        assert_eq!(state, JobState::Interrupted, "step {step}: {reason}");
        assert!(!world.device.light_on, "step {step}");
        let history = History::replay(&world.journal).expect("true");
        let choice = if history.in_doubt.is_some() {
            assert!(matches!(history.start(ResumeChoice::None), Err(ResumeError::InDoubt { .. })));
            ResumeChoice::Repeat
        } else {
            ResumeChoice::None
        };
        world.engine = Engine::new(plan(), history.start(choice).expect("resumable"));
        world.finished = None;
        world.drop_line(0);
        assert!(world.run());
        assert_eq!(world.end().0, JobState::Completed, "step {step}: {:?}", world.end());
        assert!(world.all_exposed_once(), "step {step}: {:?}", world.exposed);
    }
}

#[test]
fn a_line_that_stays_away_interrupts_the_job() {
    let mut world = World::disturbed(vec![(60, Disturbance::LineLost { for_us: u64::MAX / 2 })]);
    assert!(world.run());
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("did not come back within 60 s (cable)"), "{reason}");
}

#[test]
fn an_abort_that_finds_the_plate_moving_stops_it_before_it_lifts() {
    let moving = |world: &World| matches!(world.device_act, Some((_, Act::Move { .. })));
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
    let lifts = world.acts.iter().filter(|act| matches!(act, Act::Move { position_um: CLEAR_UM, .. }));
    assert_eq!(lifts.count(), 1, "nothing is commanded that the abort on its way would end: {:?}", world.acts);
}

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
    assert!(world.journal.iter().any(|record| matches!(record, Record::InDoubt { layer: 2, .. })));

    let history = History::replay(&world.journal).expect("true");
    world.engine = Engine::new(plan(), history.start(ResumeChoice::AssumeExposed).expect("decided"));
    world.finished = None;
    world.drop_line(0);
    assert!(world.run());
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("no longer knows where its plate is"), "{reason}");
    assert_eq!(History::replay(&world.journal).expect("true").next_layer, 3);
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
    let history = History::replay(&[accepted(), Record::Started { layer: 0 }]).expect("true");
    assert_eq!(history.start(ResumeChoice::Repeat), Err(ResumeError::NoDoubt { next_layer: 0 }));
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

/// A daemon starts again after the operator decided on layer 0, which had an unknown share of its light.
fn decided(exposed: bool) -> World {
    let mut world = World::new();
    world.journal = vec![
        accepted(),
        Record::Started { layer: 0 },
        Record::Commanded { layer: 0, boot_id: 1 },
        Record::InDoubt { layer: 0, why: "cut short".into() },
        Record::Decided { layer: 0, exposed },
    ];
    let history = History::replay(&world.journal).expect("true");
    world.engine = Engine::new(plan(), history.start(ResumeChoice::None).expect("decided"));
    world
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

/// Cut short and to be repeated, layer 0 hangs on the plate half cured.
#[test]
fn a_device_that_lost_its_position_never_homes_onto_a_layer_that_had_some_light() {
    let mut world = decided(false);
    assert!(world.run());
    assert!(world.end().0 == JobState::Interrupted && world.acts.is_empty(), "{:?} {:?}", world.end(), world.acts);
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
    assert!(world.engine.progress().part_in_vat);
}

#[test]
fn a_fault_interrupts_the_job_and_is_named() {
    let mut world = world_exposing(1);
    world.tell(Event::Fault(Some(Fault { code: 9, text: "cover open".into() })));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("fault 9 (cover open)"), "{reason}");
}

#[test]
fn a_full_disk_ends_the_print_dark_and_clear_before_the_next_layer() {
    let mut world = world_exposing(1);
    world.journal_full = true;
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("no space left"), "{reason}");
    assert_eq!((world.exposed.len(), world.device.position_um), (2, Some(CLEAR_UM)));
    let history = History::replay(&world.journal).expect("true");
    assert_eq!((history.state, history.next_layer), (JobState::Interrupted, 1));
    assert!(history.unconfirmed.is_some(), "the device will be asked");
}

#[test]
fn a_disk_that_fills_up_while_the_line_is_lost_still_ends_the_job() {
    let mut world = world_exposing(1);
    world.drop_line(30_000_000);
    world.journal_full = true;
    world.tell(Event::LineLost("cable".into()));
    world.tell(Event::JournalFailed("no space left".into()));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    assert_eq!((world.end().0, world.device.position_um), (JobState::Interrupted, Some(CLEAR_UM)));
}

#[test]
fn a_part_taller_than_the_travel_is_refused_before_anything_moves() {
    let mut world = World::new();
    world.tell(Event::Ready);
    world.tell(Event::Connected { state: world.device.clone(), max_position_um: 200 });
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Failed);
    assert!(reason.contains("250") && reason.contains("200"), "{reason}");
    assert!(world.acts.is_empty());
}

#[test]
fn a_layer_that_cannot_be_computed_interrupts_the_job_with_the_plate_clear() {
    let mut world = world_exposing(1);
    world.tell(Event::LayerFailed { layer: 3, text: "chunk 4 is corrupt".into() });
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("layer 3") && reason.contains("chunk 4 is corrupt"), "{reason}");
    assert_eq!((world.exposed.as_slice(), world.device.position_um), ([0, 1].as_slice(), Some(CLEAR_UM)));
}

fn any_disturbance() -> impl Strategy<Value = Disturbance> {
    prop_oneof![
        3 => (0u64..40_000_000).prop_map(|for_us| Disturbance::LineLost { for_us }),
        3 => Just(Disturbance::Crash),
        2 => Just(Disturbance::Mute),
        2 => (0u64..100_000_000).prop_map(|for_us| Disturbance::Standstill { for_us }),
        1 => Just(Disturbance::Order(Command::Pause)),
        1 => Just(Disturbance::Order(Command::Resume)),
    ]
}

proptest! {
    #![proptest_config(properties::cases(256))]

    /// Crashes, lost lines and pauses at any steps: every layer once, in order. The world itself asserts that light has a
    /// record before it, that the plate stands right, and that acts never overlap.
    #[test]
    fn every_layer_is_exposed_once_and_in_order(
        mut at in prop::collection::vec((1usize..160, any_disturbance()), 0..8)
    ) {
        at.sort_by_key(|(step, _)| *step);
        let mut world = World::disturbed(at);
        let mut ended = world.run();
        for _ in 0..20 {
            if ended && world.end().0 == JobState::Completed {
                break;
            }
            if ended && world.end().1.contains("no device was there within 60 s") {
                // The line was away, and the host stood still, before anything began.
                return Ok(());
            }
            if ended {
                prop_assert_eq!(world.end().0, JobState::Interrupted, "{:?}", world.end());
                world.crash();
            } else {
                world.tell(Event::Command(Command::Resume));
            }
            ended = world.run();
        }
        prop_assert!(ended && world.all_exposed_once(), "{:?} {:?}", world.exposed, world.finished);
        let history = History::replay(&world.journal).expect("true");
        prop_assert_eq!((history.state, history.next_layer), (JobState::Completed, LAYERS));
    }

    /// Whatever went before, the very next action after an abort puts the light off, and no light follows. Where the device
    /// was out of reach throughout, the job ends with a warning that says so.
    #[test]
    fn an_abort_comes_first_whatever_went_before(
        mut at in prop::collection::vec((1usize..120, any_disturbance()), 0..5),
        abort_at in 1usize..120,
    ) {
        at.retain(|(step, disturbance)| *step < abort_at && *disturbance != Disturbance::Crash);
        at.sort_by_key(|(step, _)| *step);
        at.push((abort_at, Disturbance::Order(Command::Abort)));
        let mut world = World::disturbed(at);
        if world.run() && world.aborted {
            let ended_before = matches!(world.end().0, JobState::Completed | JobState::Interrupted);
            prop_assert!(world.end().0 == JobState::Aborted || ended_before, "{:?}", world.end());
            prop_assert!(!world.device.light_on || world.end().1.contains(LIGHT_UNCONFIRMED), "{:?}", world.end());
        }
    }
}

#[test]
fn an_order_to_end_is_carried_out_after_a_crash_at_any_later_step() {
    for (command, state) in [(Command::Stop, JobState::Stopped), (Command::Abort, JobState::Aborted)] {
        for step in 20..steps_of_a_print() - 8 {
            let mut world = World::disturbed(vec![(step, Disturbance::Order(command))]);
            world.tell(Event::Ready);
            // The order's record is on disk: only then is the operator answered.
            while !world.journal.iter().any(|record| matches!(record, Record::Ordered(_))) && world.finished.is_none() {
                assert!(world.next_event());
            }
            if world.finished.is_none() {
                world.crash();
            }
            let exposed = world.exposed.len();
            while world.finished.is_none() {
                assert!(world.next_event());
            }
            assert_eq!(world.end().0, state, "step {step}: {:?}", world.end());
            assert!(world.exposed.len() <= exposed + 1, "step {step}: it printed on");
            assert!(!world.device.light_on, "step {step}");
            let history = History::replay(&world.journal).expect("true");
            assert_eq!(history.state, state, "step {step}");
            let is_bare = !history.touched();
            assert!(
                is_bare || (history.lifted && world.device.position_um >= Some(CLEAR_UM)),
                "step {step}: {history:?}"
            );
        }
    }
}

#[test]
fn a_job_ordered_to_end_cannot_be_resumed() {
    let mut world = world_exposing(2);
    world.tell(Event::Command(Command::Stop));
    assert!(world.engine.order_unwritten(), "nobody is answered yet");
    while world.engine.order_unwritten() {
        assert!(world.next_event());
    }
    let refused = History::replay(&world.journal).expect("true").start(ResumeChoice::None);
    assert_eq!(refused, Err(ResumeError::Ordered(EndOrder::Stop)));
}

#[test]
fn a_job_ordered_to_end_is_not_told_to_be_resumed() {
    let fault = || Event::Fault(Some(Fault { code: 9, text: "cover open".into() }));
    for order in [Command::Abort, Command::Stop] {
        for fault_first in [false, true] {
            let mut world = world_exposing(1);
            if fault_first {
                world.tell(fault());
            }
            world.tell(Event::Command(order));
            // On its way up.
            while !fault_first && !world.device.moving {
                assert!(world.next_event());
            }
            if !fault_first {
                world.tell(fault());
            }
            world.finish();
            let (_, reason) = world.end();
            assert!(!reason.contains("resume"), "{order:?}, fault first: {fault_first}: {reason}");
            assert_eq!(reason.contains("cover open"), order == Command::Stop || !fault_first, "{order:?}: {reason}");
        }
    }
}

/// A disk that hangs for an hour: whatever ends or pauses the print, the plate comes clear within seconds, and every record is
/// written once the disk answers.
#[test]
fn a_disk_that_hangs_keeps_no_plate_in_the_resin() {
    const HANGS_US: u64 = 3600 * SECOND_US;
    let orders = [Command::Abort, Command::Stop, Command::Pause];
    // The record that hangs: that of the order itself, of a layer exposed, of one commanded.
    for (order, hanging) in orders.iter().flat_map(|order| (0..3).map(move |hanging| (*order, hanging))) {
        let mut world = world_exposing(1);
        match hanging {
            0 => {}
            1 => {
                while !matches!(world.flushing, Some((_, Record::Confirmed { layer: 1 }))) {
                    assert!(world.next_event());
                }
            }
            _ => {
                while !matches!(world.flushing, Some((_, Record::Commanded { layer: 2, .. }))) {
                    assert!(world.next_event());
                }
            }
        }
        world.flush_us = HANGS_US;
        if let Some((until_us, _)) = &mut world.flushing {
            *until_us = world.now_us + HANGS_US;
        }
        let ordered_us = world.now_us;
        world.tell(Event::Command(order));
        while world.device.position_um != Some(CLEAR_UM) {
            assert!(world.next_event());
        }
        // The exposure under way, 2 s for the disk and for a new session, and the lift.
        let took_us = world.now_us - ordered_us;
        assert!(took_us < 40 * SECOND_US, "{order:?} {hanging}: {took_us} µs");
        assert!(world.flushing.is_some(), "{order:?} {hanging}: the disk still hangs");
        assert!(world.notices.iter().any(|text| text.contains("the disk has not taken")), "{:?}", world.notices);
        let exposed = world.exposed.clone();
        // It answers at last.
        world.flush_us = 5000;
        world.flushing.as_mut().expect("hangs").0 = world.now_us;
        while world.finished.is_none() && world.engine.state() != JobState::Paused {
            assert!(world.next_event());
        }
        assert_eq!(world.exposed, exposed, "{order:?} {hanging}");
        if order == Command::Pause {
            while world.flushing.is_some() {
                assert!(world.next_event());
            }
            world.tell(Event::Command(Command::Resume));
            world.finish();
            assert_eq!(world.end().0, JobState::Completed);
            assert!(world.all_exposed_once(), "{order:?} {hanging}: {:?}", world.exposed);
        }
        let history = History::replay(&world.journal).expect("true");
        let state = match order {
            Command::Abort => JobState::Aborted,
            Command::Stop => JobState::Stopped,
            _ => JobState::Completed,
        };
        assert!(history.state == state && history.lifted, "{order:?} {hanging}: {:?}", world.journal);
    }
}

#[test]
fn a_disk_that_hangs_lights_nothing_and_is_told() {
    let mut world = world_exposing(1);
    while !matches!(world.flushing, Some((_, Record::Commanded { layer: 2, .. }))) {
        assert!(world.next_event());
    }
    let until_us = world.now_us + 600 * SECOND_US;
    world.flushing.as_mut().expect("on its way").0 = until_us;
    while world.now_us < until_us {
        assert!(!world.device.light_on, "light before its record");
        assert!(world.next_event());
        let waits_us = world.now_us + 600 * SECOND_US - until_us;
        let reason = world.engine.progress().reason;
        let is_told = reason.contains("waiting for the disk");
        assert_eq!(is_told, (2 * SECOND_US..600 * SECOND_US).contains(&waits_us), "{waits_us} µs: {reason}");
    }
    world.finish();
    assert!(world.all_exposed_once(), "{:?}", world.exposed);
}

/// The journal keeps room for its last records: they are tried although one before them was refused.
#[test]
fn an_abort_after_a_full_disk_is_noted_where_the_disk_takes_it() {
    let mut world = world_exposing(1);
    world.journal_full = true;
    while world.engine.progress().state != JobState::Stopping {
        assert!(world.next_event());
    }
    world.journal_full = false;
    world.tell(Event::Command(Command::Abort));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let history = History::replay(&world.journal).expect("true");
    assert_eq!((history.state, history.ordered), (JobState::Aborted, Some(EndOrder::Abort)), "{:?}", world.journal);
}
