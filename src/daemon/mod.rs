//! The daemon: control API on a Unix socket, systemd, and the wiring of everything else.

pub mod api;
mod body;
mod clock;
pub mod handle;
mod jobs;
mod layers;
mod line;
mod notify;
mod orders;
mod part;
mod percent;
mod printer;
mod run;
mod running;
pub mod server;
mod upload;
mod view;

pub(crate) use body::ChannelBody;
pub(crate) use part::PrintMemory;
pub(crate) use percent::encode as percent_encode;
pub use printer::Setting;
pub use run::{load, log_to_stderr, run};
