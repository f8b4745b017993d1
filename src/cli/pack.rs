//! `layerctl pack`: makes a build file from 3MF, STL, OBJ, PLY and edge text. `layerctl pack --help` has examples.

use std::fmt;
use std::num::NonZero;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

use super::progress_bar;
use crate::buildfile::{
    self, BlendBegin, BuildFile, DisplacementOptions, JointChoice, PackError, PackOptions, PackProgress, Placement,
    ReliefOptions, Split, Tile,
};
use crate::config::byte_size;
use crate::text::size_text;

/// Smallest memory for the sort, bytes: with less, merging takes too many passes.
const MIN_MEMORY_BYTES: u64 = 1 << 20;

/// Most threads that parse and sort: the one thread that reads the source and computes its digest cannot supply more.
const MAX_THREADS: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(7);

/// Pack lattices (3MF, edge text) and solids (3MF, STL, OBJ, PLY) into a build file.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  layerctl pack lattice.3mf -o lattice.layerd
  layerctl pack bracket.stl -o bracket.layerd
  layerctl pack scan.ply --scale 1000 -o scan.layerd                      a mesh in metres
  layerctl pack cow.obj --size 60 -o cow.layerd                           60 mm along its longest edge
  layerctl pack cow.obj --displacement leather.png --height 0.4 -o cow.layerd    a rough surface
  layerctl pack coarse.obj --curved -o smooth.layerd                      rounds the triangles
  layerctl pack scan.ply --shell 1.5 -o shell.layerd                      a shell of an open scan
  layerctl pack lattice.3mf frame.stl -o part.layerd                      a lattice and a solid as one part
  layerctl pack edges.txt --rotate 0,0,90 --scale 0.5 -o half.layerd
  layerctl pack lattice.3mf --scale 1.002,1.002,1.01 -o lattice.layerd    compensates shrinkage
  layerctl pack lattice.3mf --joint convolution --materials PLA=rigid,TPU=soft -o two.layerd    two materials
  layerctl pack huge.txt --memory 64MiB -o huge.layerd                    sorts on the disk what does not fit

Edge text has a first line `COUNT RADIUS [CONVOLUTION_RADIUS [0]]`, whose third number is reported but not used (see --support), then \
one strut per line, `x1 y1 z1 x2 y2 z2 [radius [material [material2]]]`, in millimetres; of two materials, the strut passes from one into the other. Lines that begin with `#` or `//` are comments.

The surface of a solid may have holes, as scans have: they are closed with flat triangles, and a note says how many and how wide they \
are. A soup of triangles or a single sheet is refused. STL, OBJ and PLY are read in millimetres; colours \
are not used. Height maps that materials of OBJ name (MTL: disp, bump) and displacement meshes of 3MF displace the surface without an option.")]
pub struct PackArgs {
    /// Sources: 3MF (.3mf), STL (.stl), OBJ (.obj), PLY (.ply) or edge text (.txt). They are packed as one part: where they overlap, they are one solid.
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// The build file to write.
    #[arg(short, long, value_name = "OUT.layerd")]
    output: PathBuf,
    /// Leave out everything that is not a lattice, also the meshes that clip lattices, which are then packed whole; report each case.
    #[arg(long)]
    lattice_only: bool,
    /// How struts are joined: as a smooth convolution surface; as the exact union of beams; or each material as a convolution surface, and the materials
    /// with elliptic arcs [default: union for 3MF, as the format defines; convolution for edge text].
    #[arg(long, alias = "blend", value_enum)]
    joint: Option<JointArg>,
    /// Angle at which the elliptic arc between two materials begins, 0.1 to 44.9: the smaller, the wider is their blend.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    theta1: Option<f64>,
    /// Angle at which it ends, 45.1 to 89.9, if it is not to be symmetric; for two materials [default: 90 less theta1].
    #[arg(long, value_name = "DEG", requires = "theta1", allow_negative_numbers = true)]
    theta2: Option<f64>,
    /// Points where the blend of two materials begins, in place of the angles: on the surface of the first, then on that of the second, in the coordinates
    /// of the source.
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = numbers::<6>, conflicts_with = "theta1", allow_hyphen_values = true)]
    control_points: Option<[f64; 6]>,
    /// Names of materials in the sources, and what they are to be: those of the machine. What has no material is called default. Several may become
    /// one.
    #[arg(long, value_name = "NAME=NAME,..", value_delimiter = ',', value_parser = renamed)]
    materials: Vec<(String, String)>,
    /// Which material a pixel gets where several meet: each its share of the pixels, or the one with the greatest share.
    #[arg(long, value_enum, default_value_t = SplitArg::Halftone)]
    split: SplitArg,
    /// Support R of the kernel; implies --joint convolution [default: 1.5 times the largest radius].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    support: Option<f64>,
    /// Displace all solids along their normals by this height map, a PNG of 8 or 16 bits. It needs texture coordinates (UV), as OBJ has
    /// them, and --height.
    #[arg(long, value_name = "MAP.png", requires = "height")]
    displacement: Option<PathBuf>,
    /// How much farther out the surface is where a height map is white than where it is black; negative: farther in [default: what the
    /// source states].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    height: Option<f64>,
    /// Displacement where a height map is black [default: what the source states, or 0].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    offset: Option<f64>,
    /// What lies beyond the edges of the map of --displacement.
    #[arg(long, value_enum, default_value_t = TileArg::Wrap, requires = "displacement")]
    tile: TileArg,
    /// Curve triangles by the normals at their corners, which are computed if the source has none (PN triangles).
    #[arg(long)]
    curved: bool,
    /// Print a shell of this thickness, inwards from the surface, instead of what the surface encloses. The surface may be open.
    #[arg(long, value_name = "MM")]
    shell: Option<f64>,
    /// Rotate about x, then y, then z, degrees.
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, default_value = "0,0,0", allow_hyphen_values = true)]
    rotate: [f64; 3],
    /// Scale lengths and radii by one factor, or lengths by a factor for each axis of the printer, after the rotation: for example
    /// 1.002,1.002,1.01 to compensate shrinkage. Radii then get the mean factor. A part is refused if a surface would be off by more
    /// than 25 µm.
    #[arg(long, value_name = "F|X,Y,Z", value_parser = factors, default_value = "1", allow_hyphen_values = true)]
    scale: Factors,
    /// Scale lengths and radii so that the longest edge of the part is so long, after the rotation. The sources are read once or twice more for it. What
    /// displaces triangles, and what clips lattices, does not count.
    #[arg(long, value_name = "MM", conflicts_with = "scale", allow_negative_numbers = true)]
    size: Option<f64>,
    /// Position of the middle of the part, millimetres from the corner of the plate [default: the middle of the plate].
    #[arg(long, value_name = "X,Y", value_parser = numbers::<2>, allow_hyphen_values = true)]
    at: Option<[f64; 2]>,
    /// Length of one quantum, micrometres, 0.001 to 1000. Coordinates and radii are rounded to multiples of it.
    #[arg(long, value_name = "UM", default_value_t = 1.0)]
    quantum: f64,
    /// Memory for the sort. More struts are sorted on the disk.
    #[arg(long, value_name = "SIZE", value_parser = memory, default_value = "256MiB")]
    memory: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum JointArg {
    Convolution,
    Union,
    Elliptic,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum SplitArg {
    Halftone,
    Max,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum TileArg {
    /// The map again.
    Wrap,
    /// The map again, every other time mirrored.
    Mirror,
    /// The value at the edge.
    Clamp,
    /// No displacement.
    None,
}

impl From<TileArg> for Tile {
    fn from(tile: TileArg) -> Self {
        match tile {
            TileArg::Wrap => Self::Wrap,
            TileArg::Mirror => Self::Mirror,
            TileArg::Clamp => Self::Clamp,
            TileArg::None => Self::Nothing,
        }
    }
}

/// Packs with a progress bar, then prints every deviation from the source, and a summary.
///
/// # Errors
/// Names the file, the place in it, what was found and what to do.
pub fn run(args: PackArgs) -> anyhow::Result<()> {
    let PackArgs { inputs, output, lattice_only, joint, support, rotate, scale, at, quantum, memory, .. } = args;
    let relief = ReliefOptions {
        map: args.displacement.map(|map| DisplacementOptions { map, tile: args.tile.into() }),
        height_mm: args.height,
        offset_mm: args.offset,
        is_curved: args.curved,
        shell_mm: args.shell,
    };
    let joint = match (args.control_points, joint) {
        (None, joint) => joint_choice(joint, support, args.theta1, args.theta2)?,
        (Some([x1, y1, z1, x2, y2, z2]), Some(JointArg::Elliptic)) => {
            let begins = BlendBegin::Points([[x1, y1, z1], [x2, y2, z2]]);
            Some(JointChoice::Elliptic { support_mm: support, begins })
        }
        (Some(_), _) => return Err(PackError::Option("--control-points applies to --joint elliptic".into()).into()),
    };
    check_output(&output)?;
    let options = PackOptions {
        lattice_only,
        joint,
        materials: args.materials,
        split: match args.split {
            SplitArg::Halftone => Split::Halftone,
            SplitArg::Max => Split::Max,
        },
        relief,
        rotate_deg: rotate,
        scale: scale.0,
        size_mm: args.size,
        placement: at.map_or(Placement::Centred, |[x_mm, y_mm]| Placement::At { x_mm, y_mm }),
        quantum_um: quantum,
        memory_bytes: memory,
        threads: std::thread::available_parallelism().map_or(NonZero::<usize>::MIN, |cores| cores.min(MAX_THREADS)),
    };
    let mut display = Display { bar: progress_bar(BAR), phase: "", output: &output };
    let report = buildfile::pack(&inputs, &output, &options, &mut |progress| display.show(progress));
    display.bar.finish_and_clear();
    let report = report?;
    for note in &report.notes {
        super::eprint(&format!("note: {note}"));
    }
    let summary = super::info::Summary::of(BuildFile::open(&output)?)?;
    if summary.volume.volume_mm3 == 0.0 {
        super::eprint(
            "note: nothing of the part is solid where it was looked at: is a displacement or a shell deeper than the part is thick? Look at its \
             layers with `layerctl slice`",
        );
    }
    super::print(&summary.to_string())
}

/// How struts are joined; `None` is the default of the source's format.
fn joint_choice(
    joint: Option<JointArg>,
    support_mm: Option<f64>,
    theta1: Option<f64>,
    theta2: Option<f64>,
) -> Result<Option<JointChoice>, PackError> {
    let refused = |text: &str| Err(PackError::Option(text.into()));
    match (joint, support_mm, theta1) {
        (Some(JointArg::Elliptic), support_mm, Some(theta1)) => {
            JointChoice::elliptic(support_mm, theta1, theta2).map(Some)
        }
        (Some(JointArg::Elliptic), _, None) => {
            refused("--joint elliptic needs --theta1, an angle from 0.1 to 44.9 degrees, or --control-points")
        }
        (_, _, Some(_)) => refused("--theta1 applies to --joint elliptic"),
        (None, None, None) => Ok(None),
        (Some(JointArg::Convolution) | None, support_mm, None) => Ok(Some(JointChoice::Convolution { support_mm })),
        (Some(JointArg::Union), None, None) => Ok(Some(JointChoice::Union)),
        (Some(JointArg::Union), Some(_), None) => {
            refused("--support applies to --joint convolution and elliptic; a union has no kernel")
        }
    }
}

fn renamed(text: &str) -> Result<(String, String), String> {
    let names = text.split_once('=').map(|(from, to)| (from.trim().to_owned(), to.trim().to_owned()));
    names.filter(|(from, to)| !from.is_empty() && !to.is_empty()).ok_or_else(|| format!("`{text}`: write NAME=NAME"))
}

/// Refuses an output with the extension of a source: it could replace a source, and would later be mistaken for one.
pub(super) fn check_output(output: &Path) -> Result<(), PackError> {
    let extension = output.extension().unwrap_or_default();
    if ["3mf", "stl", "obj", "ply", "txt", "mtl", "png"].iter().any(|other| extension.eq_ignore_ascii_case(other)) {
        let text = format!("--output {}: a build file is named .layerd", output.display());
        return Err(PackError::Option(text));
    }
    Ok(())
}

/// Template of the progress bar of `pack` and `generate`.
pub(super) const BAR: &str = "{msg:>9} [{wide_bar}] {percent:>3}% {eta}";

/// Shows the progress of all phases on one bar.
struct Display<'a> {
    bar: ProgressBar,
    phase: &'static str,
    output: &'a Path,
}

impl Display<'_> {
    fn show(&mut self, progress: PackProgress) {
        match progress {
            PackProgress::Space { temporary_bytes, output_bytes, free_bytes } => self.bar.suspend(|| {
                super::eprint(&format!(
                    "note: needs up to {} of temporary space beside {}, which itself takes about {} or less; {} are free",
                    size_text(temporary_bytes),
                    self.output.display(),
                    size_text(output_bytes),
                    size_text(free_bytes)
                ));
            }),
            PackProgress::Measuring { done, total } => self.step("measuring", "{binary_bytes_per_sec}", done, total),
            PackProgress::Reading { done, total } => self.step("reading", "{binary_bytes_per_sec}", done, total),
            PackProgress::Joining { done, total } => self.step("joining", "{binary_bytes_per_sec}", done, total),
            PackProgress::Writing { done, total } => self.step("writing", "{primitives_per_sec}", done, total),
        }
    }

    /// Moves the bar. It begins anew with each phase, so that rate and remaining time are those of the phase.
    fn step(&mut self, phase: &'static str, rate: &str, done: u64, total: u64) {
        if self.phase != phase {
            self.phase = phase;
            let primitives = |state: &ProgressState, out: &mut dyn fmt::Write| {
                // An error here only leaves the rate out.
                let _ = write!(out, "{:.2} M primitives/s", state.per_sec() / 1e6);
            };
            let template = format!("{{msg:>9}} [{{wide_bar}}] {{percent:>3}}% {rate} {{eta}}");
            if let Ok(style) = ProgressStyle::with_template(&template) {
                self.bar.set_style(style.with_key("primitives_per_sec", primitives));
            }
            self.bar.reset();
            self.bar.set_message(phase);
            self.bar.set_length(total);
        }
        self.bar.set_position(done);
    }
}

/// Parses `N` finite numbers separated by commas.
pub(super) fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let found: Vec<f64> = text
        .split(',')
        .map(|field| field.trim().parse().ok().filter(|value: &f64| value.is_finite()))
        .collect::<Option<_>>()
        .ok_or_else(|| format!("`{text}`: write {N} numbers separated by commas"))?;
    let count = found.len();
    found.try_into().map_err(|_| format!("{count} numbers; {N} are needed, separated by commas"))
}

/// The value of `--scale`: factors along x, y and z.
#[derive(Clone, Copy, Debug)]
struct Factors([f64; 3]);

fn factors(text: &str) -> Result<Factors, String> {
    match numbers::<1>(text) {
        Ok([factor]) => Ok(Factors([factor; 3])),
        Err(_) => {
            numbers(text).map(Factors).map_err(|_| format!("`{text}`: write one number, or three separated by commas"))
        }
    }
}

fn memory(text: &str) -> Result<u64, String> {
    let bytes = byte_size::parse(text)?;
    if bytes < MIN_MEMORY_BYTES {
        return Err(format!("{} is too little; at least 1MiB is needed", size_text(bytes)));
    }
    Ok(bytes)
}
