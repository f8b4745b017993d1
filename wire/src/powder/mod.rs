//! What the firmware of every powder machine does with layers of scan vectors: it keeps them in one buffer, under credit, and marks them
//! in a time that follows from their parameters. `docs/protocol.md`, "Powder machines", is the contract.

mod buffer;
mod scan;

pub use buffer::{AnnouncedLayer, Arrival, LayerBuffer, StoredLayer};
pub use scan::{BadVector, MAX_VECTOR_US, jump_us, mark_us, usable};
