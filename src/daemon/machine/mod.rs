//! The device and what it is doing: the line to it, the job that has it, and what is known of it while none has.
//! `Printer` owns one of each; `tests/print.rs` runs them.

pub(crate) mod faults;
pub(crate) mod idle;
pub(crate) mod line;
pub(crate) mod raise;
pub(crate) mod raised;
pub(crate) mod running;
pub(crate) mod view;
