//! The job engine with a device that lies, in virtual time: light that was not commanded, times and positions other than
//! commanded, answers that never come, and a host that stood still.

#[path = "../job_world/mod.rs"]
mod job_world;
#[path = "../properties/mod.rs"]
mod properties;

mod abort;
mod answers;
mod any_lies;
mod dose;
mod light;
mod memory;
mod plate;

use job_world::{CLEAR_UM, SECOND_US, World};
use layerd::job::JobState;
use layerd::link::message::Urgent;

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
