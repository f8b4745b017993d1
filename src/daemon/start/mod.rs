//! From the command line to a running daemon, and what is checked before it starts. `bin/layerd.rs` calls it.

pub(crate) mod arguments;
pub(crate) mod check;
pub(crate) mod daemon;
pub(crate) mod descriptors;
pub(crate) mod run;
