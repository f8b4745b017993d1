//! What the engine keeps track of: the act under way, the abort, failures in a row.

/// The last act, under way or ended.
#[derive(Debug, Default)]
pub(super) struct ActWatch {
    /// Number of the last act.
    pub(super) number: u64,
    /// Number of the act under way.
    pub(super) running: Option<u64>,
    /// When the act under way was commanded; `None` once the device is known to have it.
    pub(super) sent_us: Option<u64>,
    /// When the last act was handed out.
    pub(super) began_us: u64,
    /// Least time that act can take, microseconds of the host's clock; 0 if unknown.
    pub(super) least_us: u64,
}

/// The abort that was sent last.
#[derive(Debug, Default)]
pub(super) struct AbortOrder {
    /// Sessions in which it was tried.
    pub(super) sessions: u32,
    /// When it was sent in the present session.
    pub(super) sent_us: u64,
    /// The device has answered it.
    pub(super) answered: bool,
}

/// Failures of line and device. A printed layer resets those in a row.
#[derive(Debug, Default)]
pub(super) struct Failures {
    /// Lost lines.
    pub(super) losses_in_a_row: u32,
    /// Protocol errors.
    pub(super) misbehaviours_in_a_row: u32,
    /// Layers still to print until all protocol errors of the job are made up for.
    pub(super) layers_of_misbehaviour: u32,
}
