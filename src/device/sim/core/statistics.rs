//! What a simulated device counts. `layerctl simulate` shows it; see [`DeviceCore::statistics`](super::DeviceCore::statistics).

/// Counts since the device was made; resets do not clear them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Exposures that ran their whole time.
    pub exposed: u64,
    /// Exposures ended early.
    pub cut_short: u64,
    /// Layers received without error.
    pub uploads: u64,
    /// Bytes of layer data taken.
    pub layer_bytes: u64,
    /// Bytes of layer data that belonged to no layer.
    pub stray_bytes: u64,
    /// Requests refused.
    pub refused: u64,
    /// Moves and homings that arrived.
    pub moves: u64,
    /// Times that another vat was put in place.
    pub changes: u64,
    /// Times that powder was spread.
    pub recoats: u64,
    /// Scan vectors marked whole.
    pub vectors: u64,
    /// How long the laser waited, off, for layer data, milliseconds.
    pub starved_ms: u64,
    /// Times the host fell silent.
    pub silences: u64,
    /// Resets.
    pub resets: u64,
}
