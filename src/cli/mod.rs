//! `layerctl`: the operator's command.

pub mod generate;
pub mod info;
pub mod pack;
