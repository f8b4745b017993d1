//! `layerctl generate`: makes synthetic lattices. `layerctl generate --help` has examples.

use std::path::PathBuf;

use super::info::Summary;
use super::pack::{BAR, check_output, numbers};
use super::progress_bar;
use crate::buildfile::{self, BuildFile, GenerateOptions, Height, Kind};

/// Generate a lattice for demos and benchmarks.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  layerctl generate bcc --struts 3600 -o bcc.layerd
  layerctl generate octet --struts 20000 --box 60,40,30 --radius 0.4 -o octet.layerd
  layerctl generate random --struts 1000000 --footprint 70,40 --active 20000 -o large.layerd")]
pub struct GenerateArgs {
    /// bcc: body-centred cubic; octet: octet truss; random: edges of an irregular tetrahedral mesh, 14 struts at each inner
    /// node, radii varying by a factor of three.
    #[arg(value_enum, value_name = "KIND")]
    kind: KindArg,
    /// Exact number of struts. If whole cells have more, some are left out across the part.
    #[arg(long, value_name = "N")]
    struts: u64,
    /// Edges of the box that the nodes fill, millimetres.
    #[arg(long = "box", value_name = "X,Y,Z", value_parser = numbers::<3>, default_value = "20,20,10", allow_hyphen_values = true)]
    box_mm: [f64; 3],
    /// Edges of the box along x and y, millimetres; its height follows from --active.
    #[arg(long, value_name = "X,Y", value_parser = numbers::<2>, requires = "active", conflicts_with = "box_mm", allow_hyphen_values = true)]
    footprint: Option<[f64; 2]>,
    /// Largest number of struts within reach of one plane. The height of the box is chosen for this number, within 5 %.
    #[arg(long, value_name = "A", requires = "footprint")]
    active: Option<u64>,
    /// Strut radius, millimetres; of `random` the mean [default: a tenth of the shortest edge of a cell].
    #[arg(long, value_name = "R")]
    radius: Option<f64>,
    /// Seed of the random choices.
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

/// Generates with a progress bar, then prints a summary.
///
/// # Errors
/// Names the option that is out of range, or says why the file could not be written.
pub fn run(args: GenerateArgs) -> anyhow::Result<()> {
    let GenerateArgs { kind, struts, box_mm, footprint, active, radius, seed, output } = args;
    check_output(&output)?;
    let kind = match kind {
        KindArg::Bcc => Kind::Bcc,
        KindArg::Octet => Kind::Octet,
        KindArg::Random => Kind::Random,
    };
    let (footprint_mm, height) = match footprint.zip(active) {
        Some((footprint_mm, active)) => (footprint_mm, Height::Active(active)),
        None => ([box_mm[0], box_mm[1]], Height::Mm(box_mm[2])),
    };
    let options = GenerateOptions { kind, struts, footprint_mm, height, radius_mm: radius, seed };
    let bar = progress_bar(BAR);
    bar.set_message("writing");
    let result = buildfile::generate(&output, &options, &mut |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    result?;
    super::print(&Summary::of(BuildFile::open(&output)?)?.to_string())
}
