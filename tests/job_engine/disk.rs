//! A disk that is full or hangs.

use crate::job_world::{CLEAR_UM, SECOND_US, world_exposing};
use layerd::job::{Command, EndOrder, Event, History, JobState, Record};

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
    assert_eq!((history.state, history.next_exposure), (JobState::Interrupted, 1));
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
                while !matches!(world.flushing, Some((_, Record::Confirmed { exposure: 1 }))) {
                    assert!(world.next_event());
                }
            }
            _ => {
                while !matches!(world.flushing, Some((_, Record::Commanded { exposure: 2, .. }))) {
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
        assert!(history.state == state && history.parked, "{order:?} {hanging}: {:?}", world.journal);
    }
}

#[test]
fn a_disk_that_hangs_lights_nothing_and_is_told() {
    let mut world = world_exposing(1);
    while !matches!(world.flushing, Some((_, Record::Commanded { exposure: 2, .. }))) {
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
