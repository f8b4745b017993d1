//! Any disturbances at any steps.

use super::LIGHT_UNCONFIRMED;
use crate::job_world::{Disturbance, LAYERS, World};
use layerd::job::{Command, Event, History, JobState};
use proptest::prelude::*;

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
    #![proptest_config(crate::properties::cases(256))]

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
        prop_assert_eq!((history.state, history.next_exposure), (JobState::Completed, LAYERS));
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
