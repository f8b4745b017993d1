//! Simulated devices: the firmware of a machine as a pure state machine, and the process that puts it on a pseudo-terminal.
//!
//! Three clocks are kept apart: the *line's* (protocol timers and baud pacing, always real), the *device's* (exposures, moves,
//! `t_ms` in the log; runs `--time-scale` times faster) and the *seed* (faults, drawn from a fixed sequence).

mod core;
mod fault;
mod log;
mod pace;
mod pty;
mod run;

pub use self::core::{CoreAction, DlpCore, Statistics};
pub use fault::{BadFault, FAULT_HELP, FaultSpec};
pub use log::{ActLog, ActRecord};
pub use pty::Pty;
pub use run::{SimulateOptions, run};
