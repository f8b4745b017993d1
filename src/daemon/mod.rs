//! The daemon: control API on a Unix socket, systemd, and the wiring of everything else.
//!
//! | module       | owns                                                                              |
//! |--------------|-----------------------------------------------------------------------------------|
//! | `host`       | log, clocks, systemd                                                              |
//! | `setting`    | the configuration, as read                                                        |
//! | `caller`     | who gives an order                                                                |
//! | `error`      | why an order is not carried out                                                   |
//! | `fit`        | what a new job's recipe is checked against                                        |
//! | `handle`     | what `http` and `printer` share: orders one way, a snapshot and events the other  |
//! | `jobs`       | the jobs and the queue                                                            |
//! | `background` | results of work on other threads                                                  |
//! | `machine`    | the device and what it is doing                                                   |
//! | `printer`    | the loop, and what each event changes                                             |
//! | `orders`     | what operators order: which the state allows, and how each is carried out         |
//! | `http`       | the sockets, and HTTP on them                                                     |
//! | `start`      | from the command line to a running daemon; the checks before that                 |
//!
//! Each module uses only those above it, except `printer` and `orders`: both implement methods of `Printer` and call each other.
//! `printer` reacts to events, `orders` to orders. `tests/print.rs` runs the whole of it; `tests/control_api/` its API alone.

mod background;
pub mod caller;
mod error;
mod fit;
pub mod handle;
mod host;
pub mod http;
mod jobs;
mod machine;
mod orders;
mod printer;
mod setting;
mod start;

pub use fit::Fit;
pub use start::arguments::Arguments;
pub use start::check::{Findings, check};
pub use start::daemon::Daemon;
pub use start::run::run;
