//! `layerctl`'s offline commands.

pub mod check;
pub mod slice;
