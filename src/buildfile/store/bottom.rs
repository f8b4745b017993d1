//! The lowest solid point of a convolution surface: the lowest point at which the summed field is the isovalue.
//!
//! Planes are probed from below until one has a solid point. Then the interval between that plane and the last dark one is bisected.
//! Only struts within reach of these planes are read. `writer` calls it once for each convolution.

use std::ops::Range;

use super::error::BuildFileError;
use super::reader::BuildFile;
use crate::buildfile::model::{Lattice, Strut};
use crate::solid::{Convolution, InstructionSet, JoinedShape, Joining, PlaneProbe, ProbeRecord};

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

/// The lowest solid point of bodies that are convolutions of the same support and are joined, or of one, micrometres; `None` if nothing is solid.
///
/// # Errors
/// If a chunk cannot be read.
pub(super) fn lowest_of_convolution(
    file: &BuildFile,
    bodies: Range<usize>,
    lattices: &[&Lattice],
) -> Result<Option<f64>, BuildFileError> {
    let quantum_um = file.header().quantum_um;
    let Some((joint, support_um)) = lattices.first().and_then(|first| Some((first.joint, first.joint.support_um()?)))
    else {
        return Ok(None);
    };
    let smallest_radius = lattices.iter().map(|lattice| lattice.radius_range[0]).min().unwrap_or(1);
    let smallest_radius_um = f64::from(smallest_radius) * quantum_um;
    let tops_um =
        lattices.iter().map(|lattice| f64::from(lattice.bounds.max[2]) * quantum_um + lattice.bulge_um(quantum_um));
    let top_um = tops_um.fold(f64::NEG_INFINITY, f64::max);
    // So that no strut that prints at its radius can lie between two planes, nor its bottom between points.
    let mut step_um = (support_um * MAX_STEP_SHARE).min(smallest_radius_um);
    let pitch_um = (support_um * MAX_STEP_SHARE).min(2.0 * (smallest_radius_um * MISSED_UM).sqrt());
    let (quantum, pitch) = (quantum_um / support_um, pitch_um / support_um);
    // A sum needs no members: all struts are drawn on one strip.
    let mut probe = match joint.joining() {
        joining @ Joining::Elliptic(_) if lattices.len() > 1 => {
            let join = move |cells: &[&[f32]], out: &mut [f32]| {
                Convolution::join(InstructionSet::detect(), &joining, cells, out);
            };
            PlaneProbe::<Convolution>::joined(quantum, 1.0, pitch, lattices.len(), Box::new(join))
        }
        Joining::Sum | Joining::Elliptic(_) => PlaneProbe::new(quantum, 1.0, pitch),
    };
    let chunks = bodies.clone().map(|body| file.body_chunks(body)).collect();
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
    /// Chunks of each body that are still to be read.
    chunks: Vec<Range<usize>>,
    support_um: f64,
    records: Vec<ProbeRecord>,
    struts: Vec<Strut>,
}

impl Near<'_> {
    /// Drops the struts that end out of reach below `low_um`, and reads those within reach of planes up to `high_um`. Reads on until
    /// there is at least one strut. Returns the lowest plane that any of them reaches; `None` if there are no more struts.
    fn rise(&mut self, low_um: f64, high_um: f64) -> Result<Option<f64>, BuildFileError> {
        let header = self.file.header();
        // The cast saturates.
        let lowest_top = ((low_um - self.support_um) / header.quantum_um).floor() as i32;
        let highest_bottom = (high_um + self.support_um) / header.quantum_um;
        self.records.retain(|held| held.record.b[2] >= lowest_top);
        while let Some((member, chunk)) = self.next() {
            let entry = &self.file.chunks()[chunk];
            if f64::from(entry.z_low_min) > highest_bottom && !self.records.is_empty() {
                break;
            }
            if entry.z_high_max >= lowest_top {
                self.read(member, chunk, lowest_top)?;
            }
            self.chunks[member].start += 1;
        }
        let lowest = self.records.iter().map(|held| held.record.a[2]).min();
        Ok(lowest.map(|lowest| f64::from(lowest) * header.quantum_um - self.support_um))
    }

    /// The chunk that begins lowest of those still to be read, and its body.
    fn next(&self) -> Option<(usize, usize)> {
        let first = |(member, chunks): (usize, &Range<usize>)| chunks.clone().next().map(|chunk| (member, chunk));
        let firsts = self.chunks.iter().enumerate().filter_map(first);
        firsts.min_by_key(|(_, chunk)| self.file.chunks()[*chunk].z_low_min)
    }

    /// Reads the struts of a chunk that end at `lowest_top` or above.
    fn read(&mut self, member: usize, chunk: usize, lowest_top: i32) -> Result<(), BuildFileError> {
        let quantum = self.file.header().quantum_um / self.support_um;
        self.struts.clear();
        self.file.read_chunk(chunk, &mut self.struts)?;
        let struts = self.struts.iter().filter(|strut| strut.b[2] >= lowest_top);
        // There are at most `Header::MAX_BODIES` members.
        let record = |strut: &Strut| ProbeRecord { record: strut.record::<Convolution>(quantum), member: member as u8 };
        self.records.extend(struts.map(record));
        Ok(())
    }
}
