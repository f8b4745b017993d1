//! What is collected of surfaces: triangles go to the sort, `solid_check` tells whether they enclose a solid, and holes are closed. `collect`
//! has one.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::holes::ClosedHoles;
use super::rules::Rules;
use super::solid_check::SolidCheck;
use crate::buildfile::error::PackError;
use crate::buildfile::model::{Bounds, Triangle};
use crate::buildfile::sort::Sorter;

/// Takes the triangles of all sources.
pub(super) struct SurfaceLane<'a> {
    rules: &'a Rules,
    sorter: Sorter<Triangle>,
    directory: PathBuf,
    count: u64,
    /// A box around all of them.
    bounds: Bounds,
    /// Triangles whose corners lie on one line. They are kept, because their neighbours meet their edges.
    flat_count: u64,
    /// What is known of the current solid.
    solid: SolidCheck,
    closed: ClosedHoles,
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
        Self {
            rules,
            sorter,
            directory: directory.into(),
            count: 0,
            bounds: Bounds::EMPTY,
            flat_count: 0,
            solid: SolidCheck::default(),
            closed: ClosedHoles::default(),
        }
    }

    /// Number of triangles.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// A box around all triangles.
    pub(super) fn bounds(&self) -> Bounds {
        self.bounds
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
        if is_flat(&triangle) {
            self.flat_count += 1;
        }
        self.push(triangle)
    }

    fn push(&mut self, triangle: Triangle) -> Result<(), PackError> {
        // Even a flat one: its neighbours meet its edges.
        self.solid.add(triangle.corners);
        self.count += 1;
        self.bounds = self.bounds.joined(&triangle.bounds());
        let sorted = self.sorter.push(triangle);
        sorted.map_err(|source| PackError::Sort { directory: self.directory.clone(), source })
    }

    /// Ends a file or an object, which `place` names, whose triangles enclose a solid but for holes, which are closed.
    ///
    /// # Errors
    /// If they do not enclose anything: the surface is far from closed, or inside out. If the temporary file cannot be written.
    pub(super) fn end_solid(&mut self, place: &str) -> Result<(), PackError> {
        for hole in self.solid.holes() {
            for cap in hole.caps() {
                self.push(Triangle::new(cap))?;
            }
            self.closed.add(&hole, place);
        }
        std::mem::take(&mut self.solid).end(place, self.rules)
    }

    /// All triangles; `None` if there are none. Adds notes for the operator.
    pub(super) fn finish(self, notes: &mut Vec<String>) -> Option<CollectedSurface> {
        if self.count == 0 {
            return None;
        }
        if self.flat_count > 0 {
            let count = self.count - self.closed.cap_count;
            notes.push(format!("{} of {count} triangles have no area; they change nothing", self.flat_count));
        }
        notes.extend(self.closed.note(self.rules));
        Some(CollectedSurface { sorter: self.sorter, count: self.count })
    }
}

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
