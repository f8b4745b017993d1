//! The daemon: control API on a Unix socket, systemd, and the wiring of everything else.

pub mod api;
mod background;
mod body;
mod clock;
mod doubt;
mod faults;
pub mod handle;
mod idle;
mod jobs;
mod layers;
mod line;
mod notify;
mod opened;
mod orders;
mod part;
mod past;
mod percent;
mod plate;
mod printer;
mod raise;
mod remove;
mod run;
mod running;
pub mod server;
mod session;
mod setting;
mod upload;
mod view;

pub(crate) use body::ChannelBody;
pub(crate) use part::PrintMemory;
pub(crate) use percent::encode as percent_encode;
pub use run::{log_to_stderr, run};
pub use setting::Setting;
