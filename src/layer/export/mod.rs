//! Layers as files that other programs read. `layerctl slice` writes them.

mod cli;
mod ovf;
mod png;
mod sl1;
mod svg;

pub use cli::CliWriter;
pub use ovf::OvfWriter;
pub use png::{write_colours, write_png};
pub use sl1::{Sl1Print, Sl1Writer};
pub use svg::write_svg;
