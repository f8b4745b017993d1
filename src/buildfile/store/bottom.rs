//! The lowest solid point of a convolution surface: where the summed field first reaches the isovalue.
//!
//! Planes are drawn from below until a point is solid. Then the step between the last dark plane and that one is halved. Only
//! struts within reach of these planes are read.

use std::ops::Range;

use super::error::BuildFileError;
use super::reader::BuildFile;
use crate::buildfile::model::{Lattice, Strut};
use crate::solid::{Convolution, PlaneProbe, Record, Shape};

/// Planes and points are at most this share of R apart: the field changes by less than one per cent over half of it.
const LARGEST_STEP_SHARE: f64 = 1.0 / 16.0;

/// How far a bottom of the thinnest radius may lie below what the grid finds of it, micrometres, about: points that lie `g` apart
/// miss `g²/4r` of a bottom of radius r.
const MISSED_UM: f64 = 1.0;

/// Dark planes after which steps are doubled, again and again: struts that print nothing over 32 R are no part to measure by the
/// micrometre, and a part of nothing else must not take hours.
const PATIENT_PLANES: u32 = 512;

/// Halvings of the last step: to less than a thousandth of it.
const HALVINGS: u32 = 10;

/// The lowest solid point of a body that is a convolution of support R, micrometres; `None` where nothing is solid.
///
/// # Errors
/// Where a chunk cannot be read.
pub(super) fn lowest_of_convolution(
    file: &BuildFile,
    body: usize,
    lattice: &Lattice,
    support_um: f64,
) -> Result<Option<f64>, BuildFileError> {
    let quantum_um = file.header().quantum_um;
    let least_radius_um = f64::from(lattice.radius_range[0]) * quantum_um;
    let top_um = f64::from(lattice.bounds.max[2]) * quantum_um + lattice.bulge_um(quantum_um);
    // No strut that prints at its radius slips through between planes, nor its bottom between points.
    let mut step_um = (support_um * LARGEST_STEP_SHARE).min(least_radius_um);
    let pitch_um = (support_um * LARGEST_STEP_SHARE).min(2.0 * (least_radius_um * MISSED_UM).sqrt());
    let mut probe = PlaneProbe::new(quantum_um / support_um, pitch_um / support_um);
    let chunks = file.body_chunks(body);
    let mut near = Near { file, chunks, support_um, records: Vec::new(), struts: Vec::new() };
    let (mut dark_um, mut planes) = (f64::NEG_INFINITY, 0);
    let mut solid_um = loop {
        let Some(begin_um) = near.rise(dark_um, dark_um + step_um)? else { return Ok(None) };
        // Where nothing is within reach there is nothing to draw.
        dark_um = dark_um.max(begin_um);
        let z_um = dark_um + step_um;
        if z_um > top_um + step_um {
            return Ok(None);
        }
        near.rise(dark_um, z_um)?;
        if probe.is_solid(&near.records, z_um / support_um) {
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
        if probe.is_solid(&near.records, middle_um / support_um) {
            solid_um = middle_um;
        } else {
            dark_um = middle_um;
        }
    }
    Ok(Some(solid_um))
}

/// The struts within reach of some planes.
struct Near<'a> {
    file: &'a BuildFile,
    /// Those of the body that are still to be read.
    chunks: Range<usize>,
    support_um: f64,
    records: Vec<Record>,
    struts: Vec<Strut>,
}

impl Near<'_> {
    /// Lets struts go that end out of reach below `low_um`, and reads those within reach of planes up to `high_um`, and at
    /// least so many that one is left. Tells the lowest plane that any reaches; `None` where none is left.
    fn rise(&mut self, low_um: f64, high_um: f64) -> Result<Option<f64>, BuildFileError> {
        let header = self.file.header();
        let quantum = header.quantum_um / self.support_um;
        // Saturates.
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
                    let caps = [strut.caps.a.into(), strut.caps.b.into()];
                    let ends = Convolution::ends([strut.radius_a, strut.radius_b], caps, strut.is_ball(), quantum);
                    self.records.push(Record { a: strut.a, b: strut.b, ends });
                }
            }
            self.chunks.start += 1;
        }
        let lowest = self.records.iter().map(|record| record.a[2]).min();
        Ok(lowest.map(|lowest| f64::from(lowest) * header.quantum_um - self.support_um))
    }
}
