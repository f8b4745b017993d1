//! Scan vectors: from the field of a layer to what a laser marks.
//!
//! A layer is cut along its border into [`Region`]s, and each is filled by the rules of [`ScanSettings`].

mod region;
mod settings;

pub use region::{Region, Ring};
pub use settings::{HatchSettings, HatchStrategy, ScanSettings};
