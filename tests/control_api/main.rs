//! The control API over a real Unix socket: the server of the daemon, the client of `layerctl`, and a printer made of a few
//! lines in between.

#![allow(clippy::unwrap_used, reason = "a test may fail by panicking, helpers included")]

mod bench;
mod events;
mod logs;
mod orders;
mod sockets;
mod uploads;
