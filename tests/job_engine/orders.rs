//! Pause, stop, shutdown and their records, at every step of a print.

use crate::job_world::{CLEAR_UM, Disturbance, World, plan, steps_of_a_print, world_exposing};
use layerd::job::{Command, EndOrder, Engine, Event, History, JobState, Record, ResumeChoice, ResumeError};
use layerd::link::message::Fault;

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
                is_bare || (history.parked && world.device.position_um >= Some(CLEAR_UM)),
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
