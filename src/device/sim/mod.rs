//! Simulated devices: the firmware of a machine as a pure state machine, and the process that puts it on a pseudo-terminal.
//!
//! There are two clocks. The *line's* clock is real time: protocol timers and pacing by baud rate. The *device's* clock runs
//! `--time-scale` times faster: exposures, moves and `t_ms` in the log. Faults are drawn from a sequence fixed by `--seed`.
//!
//! `layerctl simulate` and `layerctl demo` run one; so does `tests/device_pty.rs`.

mod core;
mod fault;
mod log;
mod pace;
mod pty;
mod run;

pub use self::core::{CoreAction, DeviceCore, MarkedVector, MeltSettings, Statistics};
pub use fault::{BadFault, FAULT_HELP, FaultSpec, Interlock};
pub use log::{ActLog, ActRecord};
pub use pty::Pty;
pub use run::{SimulateOptions, run};
