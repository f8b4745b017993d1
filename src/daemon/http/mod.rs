//! The control API's server: HTTP and JSON on Unix sockets. `docs/control-api.md` describes it for people.

pub(crate) mod connections;
pub(crate) mod job_log;
pub mod server;
pub mod socket;
pub mod upload;
