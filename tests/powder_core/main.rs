//! The firmware of the simulated laser machine under virtual time: what it refuses, what it marks, when the laser is on, and how layers
//! that are larger than its buffer stream through it.

#[path = "../device_common/mod.rs"]
mod device_common;
#[path = "../properties/mod.rs"]
mod properties;
#[path = "../scan_samples/mod.rs"]
mod scan_samples;
#[path = "../slice_part/mod.rs"]
mod slice_part;

mod any_host;
mod melted;
mod refusals;
mod sliced;
mod stops;
mod streaming;
mod times;
