//! The lowest solid point of a convolution surface: the lowest point at which the summed field is the isovalue.
//!
//! Planes are probed from below until one has a solid point. Then the interval between that plane and the last dark one is bisected.
//! Only struts within reach of these planes are read. `writer` calls it once for each convolution.

use std::ops::Range;

use super::error::BuildFileError;
use super::reader::BuildFile;
use crate::buildfile::model::{Lattice, Strut};
use crate::solid::{Convolution, PlaneProbe, Shape, StrutRecord};

/// Largest distance of planes and of points, as a share of R: over half of it the field changes by less than one per cent.
const MAX_STEP_SHARE: f64 = 1.0 / 16.0;

/// Largest distance from the true lowest point to the lowest one found, micrometres, about. Points at distances of g can miss a bottom of
/// radius r by `g²/4r`: the sagitta of a circle for the half diagonal of a square of the grid, `(g/√2)²/2r`.
const MISSED_UM: f64 = 1.0;

/// After every so many dark planes the step is doubled. Struts that print nothing over a height of 32 R need no precision of a
/// micrometre, and a file of nothing else must not take hours.
const PATIENT_PLANES: u32 = 512;

/// Bisections of the last step: to less than a thousandth of it.
const HALVINGS: u32 = 10;

/// The lowest solid point of a body that is a convolution of support R, micrometres; `None` if nothing is solid.
///
/// # Errors
/// If a chunk cannot be read.
pub(super) fn lowest_of_convolution(
    file: &BuildFile,
    body: usize,
    lattice: &Lattice,
    support_um: f64,
) -> Result<Option<f64>, BuildFileError> {
    let quantum_um = file.header().quantum_um;
    let smallest_radius_um = f64::from(lattice.radius_range[0]) * quantum_um;
    let top_um = f64::from(lattice.bounds.max[2]) * quantum_um + lattice.bulge_um(quantum_um);
    // So that no strut that prints at its radius can lie between two planes, nor its bottom between points.
    let mut step_um = (support_um * MAX_STEP_SHARE).min(smallest_radius_um);
    let pitch_um = (support_um * MAX_STEP_SHARE).min(2.0 * (smallest_radius_um * MISSED_UM).sqrt());
    let mut probe = PlaneProbe::<Convolution>::new(quantum_um / support_um, 1.0, pitch_um / support_um);
    let chunks = file.body_chunks(body);
    let mut near = Near { file, chunks, support_um, records: Vec::new(), struts: Vec::new() };
    let (mut dark_um, mut planes) = (f64::NEG_INFINITY, 0);
    let mut solid_um = loop {
        let Some(begin_um) = near.rise(dark_um, dark_um + step_um)? else { return Ok(None) };
        // Skip heights without any strut within reach.
        dark_um = dark_um.max(begin_um);
        let z_um = dark_um + step_um;
        if z_um > top_um + step_um {
            return Ok(None);
        }
        near.rise(dark_um, z_um)?;
        if probe.is_solid(&near.records, z_um / support_um, None) {
            break z_um;
        }
        dark_um = z_um;
        planes += 1;
        if planes % PATIENT_PLANES == 0 {
            step_um *= 2.0;
        }
    };
    for _ in 0..HALVINGS {
        let middle_um = f64::midpoint(dark_um, solid_um);
        if probe.is_solid(&near.records, middle_um / support_um, None) {
            solid_um = middle_um;
        } else {
            dark_um = middle_um;
        }
    }
    Ok(Some(solid_um))
}

/// The struts within reach of the planes that are probed.
struct Near<'a> {
    file: &'a BuildFile,
    /// Chunks of the body that are still to be read.
    chunks: Range<usize>,
    support_um: f64,
    records: Vec<StrutRecord>,
    struts: Vec<Strut>,
}

impl Near<'_> {
    /// Drops the struts that end out of reach below `low_um`, and reads those within reach of planes up to `high_um`. Reads on until
    /// there is at least one strut. Returns the lowest plane that any of them reaches; `None` if there are no more struts.
    fn rise(&mut self, low_um: f64, high_um: f64) -> Result<Option<f64>, BuildFileError> {
        let header = self.file.header();
        let quantum = header.quantum_um / self.support_um;
        // The cast saturates.
        let lowest_top = ((low_um - self.support_um) / header.quantum_um).floor() as i32;
        let highest_bottom = (high_um + self.support_um) / header.quantum_um;
        self.records.retain(|record| record.b[2] >= lowest_top);
        while let Some(chunk) = self.chunks.clone().next() {
            let entry = &self.file.chunks()[chunk];
            if f64::from(entry.z_low_min) > highest_bottom && !self.records.is_empty() {
                break;
            }
            if entry.z_high_max >= lowest_top {
                self.struts.clear();
                self.file.read_chunk(chunk, &mut self.struts)?;
                for strut in self.struts.iter().filter(|strut| strut.b[2] >= lowest_top) {
                    let caps = [strut.caps.a, strut.caps.b];
                    let ends = Convolution::ends([strut.radius_a, strut.radius_b], caps, strut.is_ball(), quantum);
                    self.records.push(StrutRecord { a: strut.a, b: strut.b, ends });
                }
            }
            self.chunks.start += 1;
        }
        let lowest = self.records.iter().map(|record| record.a[2]).min();
        Ok(lowest.map(|lowest| f64::from(lowest) * header.quantum_um - self.support_um))
    }
}
