//! `layerctl info`: the contents of a build file, and the volume of its solid. `layerctl info --help` has examples.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;

use crate::buildfile::{BodyHeader, BuildFile, Header, Placement};
use crate::slice::{Estimate, Slicer, Volume};
use crate::text::{count_text, size_text};

/// Show what a build file contains, and how much resin the part needs.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  layerctl info lattice.layerd
  layerctl info lattice.layerd --json | jq .resin_ml

The volume is estimated by sampling. This takes some seconds if a million struts are at one height.")]
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
/// If the file cannot be read or is damaged.
pub fn run(args: InfoArgs) -> anyhow::Result<()> {
    let InfoArgs { file, json } = args;
    let summary = Summary::of(BuildFile::open(&file)?)?;
    if json { super::print_json(&summary) } else { super::print(&summary.to_string()) }
}

/// Summary of a build file. The names of the fields are those of `info --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the file.
    pub file: String,
    /// The bodies of the part.
    pub bodies: Vec<BodySummary>,
    /// Lowest corner of all bodies, including the radii of struts, millimetres.
    pub bounds_min_mm: [f64; 3],
    /// Highest corner, millimetres.
    pub bounds_max_mm: [f64; 3],
    /// Height of the lowest solid point, which is on the plate, millimetres.
    pub bottom_mm: f64,
    /// Volume of the solid.
    #[serde(flatten)]
    pub volume: VolumeFigures,
    /// The materials that the part names.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub materials: Vec<MaterialSummary>,
    /// Length of a quantum, the resolution of coordinates and radii, micrometres.
    pub quantum_um: f64,
    /// Half a quantum: the largest rounding error of a coordinate along each axis, and of a radius, micrometres.
    pub rounding_um: f64,
    /// Length of the file, bytes.
    pub file_bytes: u64,
    /// Length of the file divided by the number of struts, balls and triangles.
    pub bytes_per_primitive: f64,
    /// Number of chunks.
    pub chunks: usize,
    /// Upper bound of the number of struts, balls and triangles active at any z.
    pub peak_active: u64,
    /// Position of the middle of the part on the plate, millimetres; absent if it is centred.
    pub at_mm: Option<[f64; 2]>,
    /// Name of the source.
    pub source: String,
    /// SHA-256 of the source, hexadecimal.
    pub source_sha256: String,
}

/// Summary of one body, by `kind`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum BodySummary {
    /// Struts and balls.
    Lattice {
        /// `convolution`, `union` or `elliptic`.
        joint: &'static str,
        /// Support R of the kernel, millimetres; absent for a union.
        support_mm: Option<f64>,
        /// Name of its material, if the part names any.
        #[serde(skip_serializing_if = "Option::is_none")]
        material: Option<String>,
        /// Number of struts, without balls.
        struts: u64,
        /// Number of balls.
        balls: u64,
        /// Number of distinct nodes; absent if the writer could not count them.
        nodes: Option<u64>,
        /// Smallest and largest radius, millimetres.
        radius_mm: [f64; 2],
    },
    /// What triangles enclose.
    Surface {
        /// Number of triangles.
        triangles: u64,
    },
    /// What displaced or curved triangles enclose.
    Relief {
        /// Number of triangles before they are divided.
        triangles: u64,
        /// Whether they are curved.
        curved: bool,
        /// Thickness of a shell, millimetres; absent if they enclose a solid.
        shell_mm: Option<f64>,
        /// Columns and rows of each height map, texels.
        maps: Vec<[u32; 2]>,
    },
    /// Triangles that clip the lattice before them.
    Clip {
        /// What is left of it: what lies `inside` or `outside`.
        keeps: &'static str,
        /// Number of triangles.
        triangles: u64,
    },
}

impl BodySummary {
    fn of(number: usize, header: &Header) -> Self {
        let quantum_um = header.quantum_um;
        match &header.bodies[number] {
            BodyHeader::Lattice(lattice) => {
                let (joint, support_mm) = super::joint_figures(lattice.joint);
                Self::Lattice {
                    joint,
                    support_mm,
                    material: header
                        .materials
                        .as_ref()
                        .map(|some| some.names[usize::from(some.of_bodies[number])].clone()),
                    struts: lattice.strut_count,
                    balls: lattice.ball_count,
                    nodes: (lattice.node_count > 0).then_some(lattice.node_count),
                    radius_mm: lattice.radius_range.map(|radius| f64::from(radius) * quantum_um / 1000.0),
                }
            }
            BodyHeader::Surface(surface) => Self::Surface { triangles: surface.triangle_count },
            BodyHeader::Relief(relief) => Self::Relief {
                triangles: relief.patch_count,
                curved: relief.is_curved,
                shell_mm: (relief.shell_um > 0.0).then_some(relief.shell_um / 1000.0),
                maps: relief.maps.iter().map(|map| map.size).collect(),
            },
            BodyHeader::Clip(clip) => {
                Self::Clip { keeps: super::keeps_text(clip.keeps), triangles: clip.surface.triangle_count }
            }
        }
    }
}

impl fmt::Display for BodySummary {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lattice { joint, support_mm, struts, balls, nodes, radius_mm, material } => {
                match support_mm {
                    Some(support_mm) => {
                        writeln!(out, "kind          lattice, {joint}, support R = {support_mm:.3} mm")?;
                    }
                    None => writeln!(out, "kind          lattice, exact union")?,
                }
                if let Some(material) = material {
                    writeln!(out, "material      {material}")?;
                }
                writeln!(out, "struts        {struts}")?;
                writeln!(out, "balls         {balls}")?;
                writeln!(out, "nodes         {}", nodes.map_or("not counted".into(), |nodes| nodes.to_string()))?;
                writeln!(out, "radii         {:.3} to {:.3} mm", radius_mm[0], radius_mm[1])
            }
            Self::Surface { triangles } => {
                writeln!(out, "kind          surface")?;
                writeln!(out, "triangles     {triangles}")
            }
            Self::Relief { triangles, curved, shell_mm, maps } => {
                let kind = if maps.is_empty() { "" } else { ", displaced" };
                let curved = if *curved { ", curved" } else { "" };
                match shell_mm {
                    Some(shell_mm) => writeln!(out, "kind          shell of {shell_mm:.3} mm{kind}{curved}")?,
                    None => writeln!(out, "kind          surface{kind}{curved}")?,
                }
                for [width, height] in maps {
                    writeln!(out, "height map    {width} × {height} texels")?;
                }
                writeln!(out, "triangles     {triangles}")
            }
            Self::Clip { keeps, triangles } => {
                writeln!(out, "kind          clip of the lattice before it, of which it leaves what lies {keeps}")?;
                writeln!(out, "triangles     {triangles}")
            }
        }
    }
}

impl Summary {
    /// Summarises an open file and samples its volume.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn of(file: BuildFile) -> anyhow::Result<Self> {
        let file = Arc::new(file);
        let volume = Volume::sample(&file, Slicer::default_threads())?;
        let header = file.header();
        let names = header.materials.as_ref().map_or(&[][..], |materials| &materials.names);
        let materials = MaterialSummary::all(names, &volume);
        let volume = volume.into();
        let mm = |quanta: f64| quanta * header.quantum_um / 1000.0;
        let total: u64 = header.bodies.iter().map(BodyHeader::total).sum();
        Ok(Self {
            file: file.path().display().to_string(),
            bodies: (0..header.bodies.len()).map(|number| BodySummary::of(number, header)).collect(),
            bounds_min_mm: header.bounds.min.map(|value| mm(f64::from(value))),
            bounds_max_mm: header.bounds.max.map(|value| mm(f64::from(value))),
            bottom_mm: header.bottom_um / 1000.0,
            volume,
            materials,
            quantum_um: header.quantum_um,
            rounding_um: header.quantum_um / 2.0,
            file_bytes: file.file_bytes(),
            bytes_per_primitive: file.file_bytes() as f64 / total as f64,
            chunks: file.chunks().len(),
            peak_active: file.peak_active(),
            at_mm: match header.placement {
                Placement::Centred => None,
                Placement::At { x_mm, y_mm } => Some([x_mm, y_mm]),
            },
            // A name with line breaks is shown on one line.
            source: header.source_name.replace(char::is_control, " "),
            source_sha256: header.source_digest.iter().map(|byte| format!("{byte:02x}")).collect(),
        })
    }
}

/// Volumes, with the names of `info --json`. They are sampled; each error is two standard errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VolumeFigures {
    /// Volume of the solid as it prints, mm³.
    pub volume_mm3: f64,
    /// Error of `volume_mm3`.
    pub volume_error_mm3: f64,
    /// The same volume in millilitres of resin.
    pub resin_ml: f64,
    /// Error of `resin_ml`.
    pub resin_error_ml: f64,
    /// Volume of the exact union of the same beams and balls, as 3MF defines it, mm³; absent for a union.
    pub union_volume_mm3: Option<f64>,
    /// Error of `union_volume_mm3`.
    pub union_volume_error_mm3: Option<f64>,
    /// By how much the convolution exceeds that union, per cent; negative if it is smaller, absent for a union.
    pub excess_percent: Option<f64>,
    /// Error of `excess_percent`.
    pub excess_error_percent: Option<f64>,
    /// Number of planes that were sampled.
    pub volume_planes: u32,
}

/// A material of the part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MaterialSummary {
    /// Its name.
    pub name: String,
    /// What of the volume is of it, mm³.
    pub volume_mm3: f64,
    /// Error of `volume_mm3`.
    pub volume_error_mm3: f64,
}

impl MaterialSummary {
    /// Those of these names. A single one has all of the volume.
    fn all(names: &[String], volume: &Volume) -> Vec<Self> {
        let volumes = match volume.materials_mm3.as_slice() {
            [] => std::slice::from_ref(&volume.solid_mm3),
            several => several,
        };
        let named = names.iter().zip(volumes);
        named
            .map(|(name, volume)| Self { name: name.clone(), volume_mm3: volume.value, volume_error_mm3: volume.error })
            .collect()
    }
}

impl From<Volume> for VolumeFigures {
    fn from(Volume { solid_mm3, union_mm3, excess_percent, planes, .. }: Volume) -> Self {
        let value = |estimate: Option<Estimate>| estimate.map(|estimate| estimate.value);
        let error = |estimate: Option<Estimate>| estimate.map(|estimate| estimate.error);
        Self {
            volume_mm3: solid_mm3.value,
            volume_error_mm3: solid_mm3.error,
            resin_ml: solid_mm3.value / 1000.0,
            resin_error_ml: solid_mm3.error / 1000.0,
            union_volume_mm3: value(union_mm3),
            union_volume_error_mm3: error(union_mm3),
            excess_percent: value(excess_percent),
            excess_error_percent: error(excess_percent),
            volume_planes: planes,
        }
    }
}

/// A value and its error, with as many decimals as the two first digits of the error have: further digits mean nothing.
fn with_error(value: f64, error: f64) -> String {
    let decimals = if error > 0.0 { (1.0 - error.log10().floor()).clamp(0.0, 6.0) as usize } else { 2 };
    format!("{value:.decimals$} ± {error:.decimals$}")
}

impl fmt::Display for VolumeFigures {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "volume        {} mm³ (two standard errors, from {} planes), {} ml of resin",
            with_error(self.volume_mm3, self.volume_error_mm3),
            self.volume_planes,
            with_error(self.resin_ml, self.resin_error_ml)
        )?;
        let (Some(union), Some(error)) = (self.union_volume_mm3, self.union_volume_error_mm3) else { return Ok(()) };
        write!(out, "exact union   {} mm³, as 3MF defines it for the same beams", with_error(union, error))?;
        if let (Some(excess), Some(error)) = (self.excess_percent, self.excess_error_percent) {
            let verb = if excess < 0.0 { "falls short of" } else { "exceeds" };
            write!(out, "; the convolution {verb} it by {:.1} ± {error:.1} %", excess.abs())?;
        }
        writeln!(out)
    }
}

impl Summary {
    /// What the bodies consist of.
    fn primitive(&self) -> &'static str {
        let is_lattice = |body: &BodySummary| matches!(body, BodySummary::Lattice { .. });
        match (self.bodies.iter().any(is_lattice), self.bodies.iter().all(is_lattice)) {
            (_, true) => "strut",
            (false, _) => "triangle",
            (true, false) => "strut or triangle",
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = |axis: usize| self.bounds_max_mm[axis] - self.bounds_min_mm[axis];
        let [low, high] = [self.bounds_min_mm, self.bounds_max_mm];
        writeln!(out, "file          {}", self.file)?;
        for (number, body) in self.bodies.iter().enumerate() {
            if self.bodies.len() > 1 {
                writeln!(out, "body          {} of {}", number + 1, self.bodies.len())?;
            }
            write!(out, "{body}")?;
        }
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
        writeln!(
            out,
            "resolution    {} µm: coordinates differ from the source by at most {} µm along each axis, radii by as much",
            self.quantum_um, self.rounding_um
        )?;
        writeln!(
            out,
            "size          {}, {:.2} bytes per {}, in {}",
            size_text(self.file_bytes),
            self.bytes_per_primitive,
            self.primitive(),
            count_text(self.chunks as u64, "chunk")
        )?;
        writeln!(out, "peak active   {} at one height", count_text(self.peak_active, self.primitive()))?;
        match self.at_mm {
            Some([x_mm, y_mm]) => writeln!(out, "on the plate  middle at {x_mm}, {y_mm} mm")?,
            None => writeln!(out, "on the plate  centred")?,
        }
        writeln!(out, "stands on     z {:.3} mm, its lowest solid point", self.bottom_mm)?;
        write!(out, "{}", self.volume)?;
        for MaterialSummary { name, volume_mm3, volume_error_mm3 } in &self.materials {
            writeln!(out, "material      {name}, {} mm³", with_error(*volume_mm3, *volume_error_mm3))?;
        }
        write!(out, "source        {}, SHA-256 {}", self.source, self.source_sha256)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_has_the_digits_that_its_error_leaves() {
        let told = [(1234.567, 12.3), (63.2812, 0.0951), (0.0632812, 0.0000951), (98765.4, 1234.5), (5.0, 0.0)]
            .map(|(value, error)| with_error(value, error));
        assert_eq!(told, ["1235 ± 12", "63.281 ± 0.095", "0.063281 ± 0.000095", "98765 ± 1234", "5.00 ± 0.00"]);
    }
}
