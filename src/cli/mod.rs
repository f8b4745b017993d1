//! `layerctl`.

pub mod client;
