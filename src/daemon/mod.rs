//! The daemon: control API on a Unix socket, systemd, and the wiring of everything else.
//!
//! | module    | owns                                                                       |
//! |-----------|----------------------------------------------------------------------------|
//! | `start`   | from the command line to a running daemon; the checks before that          |
//! | `orders`  | what operators order: which the state allows, and how each is carried out  |
//! | `printer` | the loop: line, device, running job, results of work in the background     |
//! | `jobs`    | the jobs and the queue                                                     |
//! | `http`    | the sockets, and HTTP on them                                              |
//! | `handle`  | what `http` and `printer` share: orders one way, a snapshot the other      |
//! | `host`    | log, clocks, systemd                                                       |

pub mod handle;
mod host;
pub mod http;
mod jobs;
mod orders;
mod printer;
mod setting;
mod start;

pub use jobs::fit::Fit;
pub use setting::Setting;
pub use start::arguments::Arguments;
pub use start::check::{Findings, check};
pub use start::run::run;
