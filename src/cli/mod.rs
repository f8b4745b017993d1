//! `layerctl`: the operator's command.

pub mod info;
pub mod pack;
