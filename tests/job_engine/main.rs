//! The job engine with a scripted device in virtual time: a print without errors, and every disturbance at every step.

#[path = "../job_world/mod.rs"]
mod job_world;
#[path = "../properties/mod.rs"]
mod properties;

mod abort;
mod disk;
mod disturbances;
mod doubt;
mod orders;
mod printing;

/// What an abort says that nobody confirmed.
const LIGHT_UNCONFIRMED: &str = "did not confirm that its light is off";
