//! How the serial line to the device is opened: part of a machine's configuration, as in
//! `config/machines/sim-dlp.toml`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// The serial line to the device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkSettings {
    /// Device file, e.g. `/dev/serial/by-id/…`, or the pseudo-terminal of a simulated device.
    pub path: PathBuf,
    /// Line rate, 8N1.
    pub baud: u32,
    /// Flow control of the port, below the protocol.
    #[serde(default)]
    pub flow_control: FlowControl,
    /// What is spoken on it.
    #[serde(default)]
    pub protocol: Protocol,
}

/// What host and device speak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// The framed protocol of `docs/protocol.md`.
    #[default]
    Layerd,
    /// Lines of G-code for a grbl 1.1 or grblHAL controller: see `docs/grbl.md`.
    Grbl,
}

/// Flow control of the serial port itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowControl {
    /// None: only the credit of the protocol.
    #[default]
    None,
    /// RTS/CTS.
    RtsCts,
    /// XON/XOFF; both bytes are escaped in frames.
    XonXoff,
}
