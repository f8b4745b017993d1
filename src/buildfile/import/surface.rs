//! What is collected of surfaces: triangles go to the sort, and `open_edges` tells whether they are closed. `collect` has one.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::open_edges::{Open, OpenEdges};
use super::rules::Rules;
use crate::buildfile::error::PackError;
use crate::buildfile::model::Triangle;
use crate::buildfile::sort::Sorter;
use crate::text::count_text;

/// Takes the triangles of all sources.
pub(super) struct SurfaceLane<'a> {
    rules: &'a Rules,
    sorter: Sorter<Triangle>,
    directory: PathBuf,
    count: u64,
    /// Triangles whose corners lie on one line. They are kept, because their neighbours meet their edges.
    flat_count: u64,
    /// Edges of the current solid that have no other side yet.
    edges: OpenEdges,
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
        Self {
            rules,
            sorter,
            directory: directory.into(),
            count: 0,
            flat_count: 0,
            edges: OpenEdges::default(),
            volume: 0.0,
        }
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
        if is_flat(&triangle) {
            self.flat_count += 1;
        }
        // Even of a flat one: its neighbours meet its edges.
        self.edges.add(triangle.corners);
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
        let volume = std::mem::take(&mut self.volume);
        if let Some(open) = self.edges.finish() {
            return Err(PackError::input(place, self.open_text(&open)));
        }
        if volume <= 0.0 {
            let volume_mm3 = volume / 6.0 * (self.rules.quantum_um() / 1000.0).powi(3);
            let problem = if volume < 0.0 {
                format!(
                    "the surface is inside out: its volume is {volume_mm3:.3} mm³. Reverse its triangles in the program that made it"
                )
            } else {
                "the surface encloses nothing: give it a thickness in the program that made it".into()
            };
            return Err(PackError::input(place, problem));
        }
        Ok(())
    }

    fn open_text(&self, open: &Open) -> String {
        let where_open = match open {
            Open::Edges(count, edge) => {
                let [from, to] = edge.map(|corner| {
                    let [x, y, z] = self.rules.source_mm(corner);
                    format!("{x:.4}, {y:.4}, {z:.4}")
                });
                format!("{}, one of them from {from} to {to} mm", count_text(*count as u64, "edge"))
            }
            Open::Unknown => "many edges".to_owned(),
        };
        format!(
            "the surface is open at {where_open}: there is no triangle on the other side, or one too many, or one that shows its inner \
             side. Repair it in the program that made it: close holes, join corners that nearly touch, reverse triangles, delete doubles"
        )
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
