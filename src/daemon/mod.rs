//! The daemon: control API on a Unix socket, systemd, and the wiring of everything else.

pub mod api;
mod body;
pub mod handle;
pub mod notify;
mod percent;
pub mod server;
mod upload;

pub(crate) use body::ChannelBody;
pub(crate) use percent::encode as percent_encode;
