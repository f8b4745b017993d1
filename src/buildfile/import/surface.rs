//! What is collected of surfaces: triangles go to the sort, and their edges are balanced against each other. `collect` has one.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::rules::Rules;
use crate::buildfile::error::PackError;
use crate::buildfile::model::Triangle;
use crate::buildfile::sort::Sorter;

/// Takes the triangles of all sources.
pub(super) struct SurfaceLane<'a> {
    rules: &'a Rules,
    sorter: Sorter<Triangle>,
    directory: PathBuf,
    count: u64,
    /// Triangles whose corners lie on one line. They enclose nothing and are left out.
    flat_count: u64,
    /// Sum of a hash of each edge, positive in one direction and negative in the other. 0 if each edge has as many triangles on one side as on
    /// the other, that is, if the current solid is closed; otherwise it is 0 with a chance of 2⁻⁶⁴.
    balance: u64,
    /// Six times the volume of the current solid, cubic quanta.
    volume: f64,
}

/// The triangles of all sources.
pub(in crate::buildfile) struct CollectedSurface {
    pub(in crate::buildfile) sorter: Sorter<Triangle>,
    pub(in crate::buildfile) count: u64,
}

impl<'a> SurfaceLane<'a> {
    /// A lane that takes up to `memory_bytes` and spills to `directory`.
    pub(super) fn new(rules: &'a Rules, memory_bytes: u64, directory: &Path) -> Self {
        let sorter = Sorter::new(directory, memory_bytes);
        Self { rules, sorter, directory: directory.into(), count: 0, flat_count: 0, balance: 0, volume: 0.0 }
    }

    /// Number of triangles.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Temporary space taken, bytes.
    pub(super) fn spilled_bytes(&self) -> u64 {
        self.sorter.spilled_bytes()
    }

    /// Adds a triangle, millimetres, which the options transform; `place` names it in errors.
    ///
    /// # Errors
    /// If a corner is too far from the origin or no number, or the temporary file cannot be written.
    pub(super) fn triangle(&mut self, corners: [DVec3; 3], place: &dyn Fn() -> String) -> Result<(), PackError> {
        let [a, b, c] = corners.map(|corner| self.rules.corner(corner, place));
        let triangle = Triangle::new([a?, b?, c?]);
        let [a, b, c] = triangle.corners;
        if is_flat(&triangle) {
            self.flat_count += 1;
        }
        // Even a flat one: its neighbours meet its edges.
        for [from, to] in [[a, b], [b, c], [c, a]] {
            self.balance = self.balance.wrapping_add(signed_hash(from, to));
        }
        let [a, b, c] = triangle.corners.map(|corner| DVec3::from(corner.map(|at| at as f64)) / FRACTIONS);
        self.volume += a.dot(b.cross(c));
        self.count += 1;
        let sorted = self.sorter.push(triangle);
        sorted.map_err(|source| PackError::Sort { directory: self.directory.clone(), source })
    }

    /// Ends a file or an object, which `place` names, whose triangles enclose a solid.
    ///
    /// # Errors
    /// If they do not enclose anything: the surface is open, or inside out.
    pub(super) fn end_solid(&mut self, place: &str) -> Result<(), PackError> {
        let (balance, volume) = (std::mem::take(&mut self.balance), std::mem::take(&mut self.volume));
        if balance != 0 {
            return Err(PackError::input(
                place,
                "the surface is open: it has edges without a triangle on each side, or neighbours of which one shows its inner side. \
                 Repair it in the program that made it: close holes, join corners that nearly touch, reverse triangles",
            ));
        }
        if volume <= 0.0 {
            let volume_mm3 = volume / 6.0 * (self.rules.quantum_um() / 1000.0).powi(3);
            let why = if volume < 0.0 { "the surface is inside out" } else { "the surface encloses nothing" };
            return Err(PackError::input(
                place,
                format!("{why}: its volume is {volume_mm3:.3} mm³. Reverse its triangles in the program that made it"),
            ));
        }
        Ok(())
    }

    /// All triangles; `None` if there are none. Adds notes for the operator.
    pub(super) fn finish(self, notes: &mut Vec<String>) -> Option<CollectedSurface> {
        if self.count == 0 {
            return None;
        }
        if self.flat_count > 0 {
            notes.push(format!("{} of {} triangles have no area; they change nothing", self.flat_count, self.count));
        }
        Some(CollectedSurface { sorter: self.sorter, count: self.count })
    }
}

const FRACTIONS: f64 = crate::buildfile::model::QUANTUM_FRACTIONS as f64;

/// Whether the corners lie on one line.
fn is_flat(triangle: &Triangle) -> bool {
    let [a, b, c] = triangle.corners;
    let away = |corner: [i64; 3]| [0, 1, 2].map(|axis| i128::from(corner[axis]) - i128::from(a[axis]));
    let (b, c) = (away(b), away(c));
    (0..3).all(|axis| {
        let (one, other) = ((axis + 1) % 3, (axis + 2) % 3);
        b[one] * c[other] == b[other] * c[one]
    })
}

/// A hash of an edge, whose sign is its direction. That of an edge without length is 0.
fn signed_hash(from: [i64; 3], to: [i64; 3]) -> u64 {
    let hash = |low: [i64; 3], high: [i64; 3]| {
        low.into_iter().chain(high).fold(0x9e37_79b9_7f4a_7c15_u64, |state, at| mix(state ^ at as u64))
    };
    match from.cmp(&to) {
        std::cmp::Ordering::Less => hash(from, to),
        std::cmp::Ordering::Equal => 0,
        std::cmp::Ordering::Greater => hash(to, from).wrapping_neg(),
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
fn mix(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ value >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ value >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ value >> 31
}
