//! `layerctl info`: what is in a build file.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::buildfile::{Blend, BuildFile, Placement};

/// Say what is in a build file.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  layerctl info lattice.layerd
  layerctl info lattice.layerd --json | jq .peak_active")]
pub struct InfoArgs {
    /// The build file.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Prints a [`Summary`].
///
/// # Errors
/// Where the file cannot be read or is damaged.
pub fn run(args: InfoArgs) -> anyhow::Result<()> {
    let InfoArgs { file, json } = args;
    let summary = Summary::of(&BuildFile::open(&file)?);
    if json { super::print_json(&summary) } else { super::print(&summary.to_string()) }
}

/// What a build file says of itself. Field names are those of `info --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The file's name.
    pub file: String,
    /// `convolution` or `union`.
    pub blend: &'static str,
    /// Struts, balls not counted.
    pub struts: u64,
    /// Balls.
    pub balls: u64,
    /// Distinct nodes; absent where the writer could not count them.
    pub nodes: Option<u64>,
    /// Lowest corner of all struts with their radii, millimetres.
    pub bounds_min_mm: [f64; 3],
    /// Highest corner.
    pub bounds_max_mm: [f64; 3],
    /// Least and largest radius, millimetres.
    pub radius_mm: [f64; 2],
    /// Kernel support R, millimetres; absent for a union.
    pub support_mm: Option<f64>,
    /// Quantum: resolution of coordinates and radii, micrometres.
    pub quantum_um: f64,
    /// Half a quantum: the greatest error that resolution makes of a coordinate along each axis, and of a radius, micrometres.
    pub rounding_um: f64,
    /// Length of the file.
    pub file_bytes: u64,
    /// That length divided by struts and balls.
    pub bytes_per_strut: f64,
    /// Chunks.
    pub chunks: usize,
    /// Upper bound of struts active at one z.
    pub peak_active: u64,
    /// Middle of the part on the plate, millimetres; absent where it is centred.
    pub at_mm: Option<[f64; 2]>,
    /// Name of the source.
    pub source: String,
    /// SHA-256 of the source, hexadecimal.
    pub source_sha256: String,
}

impl Summary {
    /// Summarises an open file.
    pub fn of(file: &BuildFile) -> Self {
        let header = file.header();
        let mm = |quanta: f64| quanta * header.quantum_um / 1000.0;
        let (blend, support_mm) = match header.blend {
            Blend::Convolution { support_um } => ("convolution", Some(support_um / 1000.0)),
            Blend::Union => ("union", None),
        };
        Self {
            file: file.path().display().to_string(),
            blend,
            struts: header.strut_count,
            balls: header.ball_count,
            nodes: (header.node_count > 0).then_some(header.node_count),
            bounds_min_mm: header.bounds.min.map(|value| mm(f64::from(value))),
            bounds_max_mm: header.bounds.max.map(|value| mm(f64::from(value))),
            radius_mm: header.radius_range.map(|value| mm(f64::from(value))),
            support_mm,
            quantum_um: header.quantum_um,
            rounding_um: header.quantum_um / 2.0,
            file_bytes: file.file_bytes(),
            bytes_per_strut: file.file_bytes() as f64 / (header.strut_count + header.ball_count) as f64,
            chunks: file.chunks().len(),
            peak_active: file.peak_active(),
            at_mm: match header.placement {
                Placement::Centred => None,
                Placement::At { x_mm, y_mm } => Some([x_mm, y_mm]),
            },
            // On one line, whatever the file says.
            source: header.source_name.replace(char::is_control, " "),
            source_sha256: header.source_digest.iter().map(|byte| format!("{byte:02x}")).collect(),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = |axis: usize| self.bounds_max_mm[axis] - self.bounds_min_mm[axis];
        let [low, high] = [self.bounds_min_mm, self.bounds_max_mm];
        writeln!(out, "file          {}", self.file)?;
        match self.support_mm {
            Some(support_mm) => writeln!(out, "kind          lattice, convolution, support R = {support_mm:.3} mm")?,
            None => writeln!(out, "kind          lattice, exact union")?,
        }
        writeln!(out, "struts        {}", self.struts)?;
        writeln!(out, "balls         {}", self.balls)?;
        writeln!(out, "nodes         {}", self.nodes.map_or("not counted".into(), |nodes| nodes.to_string()))?;
        writeln!(
            out,
            "bounds        {:.3} × {:.3} × {:.3} mm, x {:.3}..{:.3}, y {:.3}..{:.3}, z {:.3}..{:.3}",
            size(0),
            size(1),
            size(2),
            low[0],
            high[0],
            low[1],
            high[1],
            low[2],
            high[2]
        )?;
        writeln!(out, "radii         {:.3} to {:.3} mm", self.radius_mm[0], self.radius_mm[1])?;
        writeln!(
            out,
            "resolution    {} µm: coordinates are off their source by at most {} µm along each axis, radii by as much",
            self.quantum_um, self.rounding_um
        )?;
        writeln!(
            out,
            "size          {} bytes, {:.2} a strut, in {} chunks",
            self.file_bytes, self.bytes_per_strut, self.chunks
        )?;
        writeln!(out, "peak active   {} struts at one height", self.peak_active)?;
        match self.at_mm {
            Some([x_mm, y_mm]) => writeln!(out, "on the plate  middle at {x_mm}, {y_mm} mm")?,
            None => writeln!(out, "on the plate  centred")?,
        }
        write!(out, "source        {}, SHA-256 {}", self.source, self.source_sha256)
    }
}
