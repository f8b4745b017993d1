//! `layerctl generate`: synthetic lattices.

use std::path::PathBuf;

use super::info::Summary;
use super::pack::{BAR, numbers};
use super::progress_bar;
use crate::buildfile::{self, BuildFile, GenerateOptions, Kind};

/// Generate a lattice for demos and benchmarks.
#[derive(Debug, clap::Args)]
pub struct GenerateArgs {
    /// bcc: body-centred cubic; octet: octet truss; random: jittered nodes, 14 struts at each.
    #[arg(value_enum, value_name = "KIND")]
    kind: KindArg,
    /// About how many struts; whole cells are made, and the true number is printed.
    #[arg(long, value_name = "N")]
    struts: u64,
    /// Edges of the box, millimetres.
    #[arg(long = "box", value_name = "X,Y,Z", value_parser = numbers::<3>, default_value = "20,20,10")]
    box_mm: [f64; 3],
    /// Strut radius, millimetres [default: a tenth of the least cell edge].
    #[arg(long, value_name = "R")]
    radius: Option<f64>,
    /// Seed of `random`.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// The build file to write.
    #[arg(short, long, value_name = "OUT.layerd")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum KindArg {
    Bcc,
    Octet,
    Random,
}

/// Generates, showing progress on a terminal, and prints what was made.
///
/// # Errors
/// Names the option that is out of range, or what the file system refused.
pub fn run(args: GenerateArgs) -> anyhow::Result<()> {
    let GenerateArgs { kind, struts, box_mm, radius, seed, output } = args;
    let kind = match kind {
        KindArg::Bcc => Kind::Bcc,
        KindArg::Octet => Kind::Octet,
        KindArg::Random => Kind::Random,
    };
    let options = GenerateOptions { kind, struts, box_mm, radius_mm: radius, seed };
    let bar = progress_bar(BAR);
    bar.set_message("writing");
    let result = buildfile::generate(&output, &options, &mut |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    result?;
    super::print(&Summary::of(&BuildFile::open(&output)?).to_string())
}
