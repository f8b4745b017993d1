//! A whole print, and what ends one early.

use crate::job_world::{CLEAR_UM, Disturbance, LAYERS, World, limits, world_exposing};
use layerd::device::{Act, VatAct};
use layerd::job::{Event, History, JobState};
use layerd::link::message::Fault;

#[test]
fn a_print_homes_exposes_every_layer_and_lifts_clear() {
    let mut world = World::new();
    assert!(world.run());
    assert_eq!(world.end(), (JobState::Completed, ""));
    assert!(world.all_exposed_once());
    let moves: Vec<_> = world
        .acts
        .iter()
        .filter_map(|act| if let Act::Vat(VatAct::Move { position_um, .. }) = act { Some(*position_um) } else { None })
        .collect();
    assert_eq!(world.acts[0], Act::Vat(VatAct::Home));
    assert_eq!(moves, [50, 5050, 100, 5100, 150, 5150, 200, 5200, 250, CLEAR_UM]);
    let progress = world.engine.progress();
    assert_eq!((progress.late_layers, progress.layers_done, progress.eta_ms), (0, LAYERS, None));
    let history = History::replay(&world.journal).expect("true");
    assert_eq!((history.state, history.next_exposure), (JobState::Completed, LAYERS));
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

#[test]
fn a_part_taller_than_the_travel_is_refused_before_anything_moves() {
    let mut world = World::new();
    world.tell(Event::Ready);
    world.tell(Event::Connected { state: world.device.clone(), limits: limits(200) });
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
    world.tell(Event::LayerFailed { exposure: 3, text: "chunk 4 is corrupt".into() });
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("layer 3") && reason.contains("chunk 4 is corrupt"), "{reason}");
    assert_eq!((world.exposed.as_slice(), world.device.position_um), ([0, 1].as_slice(), Some(CLEAR_UM)));
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
