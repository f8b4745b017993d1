//! A whole printer in virtual time. The same seed gives the same run.

mod bench;
mod characters;
mod line;
mod machine;
mod rng;
mod wires;
