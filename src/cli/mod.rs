//! `layerctl`.

pub mod simulate;
