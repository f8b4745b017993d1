//! Any lies, from any step on.

use crate::job_world::{CLEAR_UM, Lies, World};
use layerd::job::{Event, History, JobState, ResumeChoice};
use proptest::prelude::*;

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
    #![proptest_config(crate::properties::cases(256))]

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
