<<<<<<< HEAD
//! `layerctl`'s offline commands.

pub mod check;
pub mod slice;
=======
//! `layerctl`: the operator's command.

pub mod info;
pub mod pack;
>>>>>>> buildfile
