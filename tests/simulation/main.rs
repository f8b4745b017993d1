//! A whole printer in virtual time. The same seed gives the same run.
//!
//! `world` joins a daemon (`host`, `disk`), a line and machines, and lets a `plan` of faults and orders (`operators`) happen to them;
//! `truth` knows what really happened. `seeds` runs fixed seeds; `simulate.rs` searches others.

mod bench;
mod characters;
mod disk;
mod document;
mod host;
mod lasers;
mod line;
mod machine;
mod operators;
mod parts;
mod plan;
#[path = "planted/list.rs"]
mod planted_bugs;
mod port;
mod rng;
mod search;
mod seeds;
mod truth;
mod wires;
mod world;
