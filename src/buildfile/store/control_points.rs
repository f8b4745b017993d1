//! Where the blend of two materials begins, from points on their surfaces (heterogeneous lattices, Eq. 3.6): the fields of both at a point are the
//! coordinates of a point of the plane in which the angles θ₁ and θ₂ are measured. `writer` looks once all struts are written;
//! `tests/materials/control.rs` shows what it finds.

use std::ops::Range;

use super::error::BuildFileError;
use super::reader::BuildFile;
use crate::buildfile::model::Lattice;
use crate::solid::WHOLE_SHARE;
use crate::solid::reference::shared_beam_field;

/// Tangents of 0.1° and 44.9°, the range of θ₁.
const RANGE: std::ops::RangeInclusive<f64> = 0.001_745..=0.996_516;

/// The least fields of the two joined lattices with which they take part in a blend that begins at these points, quanta: the first on the surface of
/// the first material, the second on that of the second. The inner error says what is wrong with the points.
///
/// # Errors
/// If a chunk cannot be read.
pub(super) fn least_fields(
    file: &BuildFile,
    bodies: Range<usize>,
    lattices: &[&Lattice],
    points: &[[f64; 3]; 2],
) -> Result<Result<[f64; 2], String>, BuildFileError> {
    if lattices.len() != 2 {
        return Ok(Err(format!("control points are for two materials, and the part has {}", lattices.len().max(1))));
    }
    let mut fields = [[0.0; 2]; 2];
    for ((body, lattice), field) in bodies.zip(lattices).zip(0..) {
        for (point, fields) in points.iter().zip(&mut fields) {
            fields[field] = field_at(file, body, lattice, *point)?;
        }
    }
    let [at_first, at_second] = fields;
    // At the first point, where the second material is the weaker one, begins tan θ₁; at the second, cot θ₂.
    let (tangent, cotangent) = (at_first[1] / at_first[0], at_second[0] / at_second[1]);
    for (name, share, [one, other]) in [("first", tangent, at_first), ("second", cotangent, at_second)] {
        if !RANGE.contains(&share) {
            return Ok(Err(format!(
                "at the {name} control point the fields of the two materials are {one:.4} and {other:.4} of the isovalue: it has to lie on the surface of \
                 the {name} material, where the other's field is weaker, by a factor of 0.0017 to 0.9965"
            )));
        }
    }
    Ok(Ok([cotangent, tangent]))
}

/// The field of a body at a point.
fn field_at(file: &BuildFile, body: usize, lattice: &Lattice, point: [f64; 3]) -> Result<f64, BuildFileError> {
    let support = lattice.joint.support_um().unwrap_or(0.0) / file.header().quantum_um;
    let (mut sum, mut struts) = (0.0, Vec::new());
    for chunk in file.body_chunks(body) {
        let entry = &file.chunks()[chunk];
        if f64::from(entry.z_low_min) > point[2] + support || f64::from(entry.z_high_max) < point[2] - support {
            continue;
        }
        struts.clear();
        file.read_chunk(chunk, &mut struts)?;
        for strut in &struts {
            let shares = [strut.shares.a, strut.shares.b].map(|share| f64::from(share) / f64::from(WHOLE_SHARE));
            sum += shared_beam_field(&strut.beam(), shares, support, point);
        }
    }
    Ok(sum)
}
