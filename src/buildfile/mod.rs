//! The build file (`.layerd`): a part as struts in ascending z, compressed in chunks that can be read in one forward stream.

mod model;

pub use model::{Ball, Blend, Bounds, Cap, Caps, Header, Placement, Strut};
