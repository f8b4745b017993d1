//! The daemon: control API on a Unix socket, systemd, and the wiring of everything else.

pub mod api;
mod background;
mod body;
pub mod caller;
mod check;
mod clock;
mod connections;
mod descriptors;
mod faults;
pub mod handle;
mod idle;
mod jobs;
mod layers;
mod line;
mod log;
mod notify;
mod opened;
mod orders;
mod part;
mod past;
mod percent;
mod printer;
mod run;
mod running;
pub mod server;
mod session;
mod setting;
pub mod socket;
mod upload;
mod view;

pub(crate) use body::ChannelBody;
pub use check::{Findings, check};
pub(crate) use part::PrintMemory;
pub(crate) use percent::encode as percent_encode;
pub use run::run;
pub use setting::Setting;
