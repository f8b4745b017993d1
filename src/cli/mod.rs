//! `layerctl`: the operator's command.

pub mod check;
pub mod info;
pub mod pack;
pub mod slice;
