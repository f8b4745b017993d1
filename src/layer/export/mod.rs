//! Layers as files that other programs read. `layerctl slice` writes them.

mod png;

pub use png::write_png;
