//! Layers as files that other programs read.

mod png;

pub use png::write_png;
