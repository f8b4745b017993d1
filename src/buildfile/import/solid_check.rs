//! Whether triangles enclose a solid: whether each edge has both sides, and how large the volume is. Holes can be closed. `surface` and `relief` use it.

use glam::DVec3;

use super::holes::{Hole, holes};
use super::open_edges::{Open, OpenEdges};
use super::rules::Rules;
use crate::buildfile::error::PackError;
use crate::buildfile::model::QUANTUM_FRACTIONS;
use crate::text::count_text;

const FRACTIONS: f64 = QUANTUM_FRACTIONS as f64;

/// At most every so many triangles are added to close holes. A scan with holes needs far fewer; a soup of triangles or a single sheet, which
/// is no solid, needs more.
const TRIANGLES_PER_CAP: u64 = 3;

/// Least volume of a solid, as a share of the power 3/2 of its area; that of a ball is 0.09. What encloses less is a sheet, and its volume
/// comes from rounding: a foil of 1 m² would be 3 µm thick.
const LEAST_VOLUME_SHARE: f64 = 1e-6;

/// What is known of the triangles of a solid.
#[derive(Default)]
pub(super) struct SolidCheck {
    triangle_count: u64,
    /// Edges that have no other side yet.
    edges: OpenEdges,
    /// A corner, from which the volume is reckoned.
    origin: Option<[i64; 3]>,
    /// Six times the volume, cubic quanta.
    volume: f64,
    /// Twice the area, square quanta.
    area: f64,
    /// There are holes, but too many to be closed.
    is_too_open: bool,
}

impl SolidCheck {
    /// Adds a triangle, whose corners are in fractions of a quantum.
    pub(super) fn add(&mut self, corners: [[i64; 3]; 3]) {
        self.triangle_count += 1;
        self.edges.add(corners);
        let origin = *self.origin.get_or_insert(corners[0]);
        let [a, b, c] =
            corners.map(|corner| DVec3::from([0, 1, 2].map(|axis| (corner[axis] - origin[axis]) as f64)) / FRACTIONS);
        self.volume += a.dot(b.cross(c));
        self.area += (b - a).cross(c - a).length();
    }

    /// The holes of the solid, if they are not too many. Call it after the last triangle, then add the triangles that cover them.
    pub(super) fn holes(&mut self) -> Vec<Hole> {
        let Some(missing) = self.edges.missing() else {
            self.is_too_open = true;
            return Vec::new();
        };
        let holes = holes(&missing);
        let cap_count: usize = holes.iter().map(Hole::cap_count).sum();
        self.is_too_open = cap_count as u64 * TRIANGLES_PER_CAP > self.triangle_count;
        if self.is_too_open { Vec::new() } else { holes }
    }

    /// Ends the solid, which `place` names.
    ///
    /// # Errors
    /// If the triangles do not enclose anything: the surface is open, or inside out.
    pub(super) fn end(mut self, place: &str, rules: &Rules) -> Result<(), PackError> {
        if let Some(open) = self.edges.finish() {
            return Err(PackError::input(place, self.open_text(&open, rules)));
        }
        let (volume, least) = (self.volume / 6.0, LEAST_VOLUME_SHARE * (self.area / 2.0).powf(1.5));
        if volume > least {
            return Ok(());
        }
        let problem = if volume < -least {
            let volume_mm3 = volume * (rules.quantum_um() / 1000.0).powi(3);
            format!(
                "the surface is inside out: its volume is {volume_mm3:.3} mm³. Reverse its triangles in the program that made it"
            )
        } else {
            "the surface encloses nothing: give it a thickness in the program that made it".into()
        };
        Err(PackError::input(place, problem))
    }

    fn open_text(&self, open: &Open, rules: &Rules) -> String {
        let where_open = match open {
            Open::Edges(count, edge) => {
                let [from, to] = edge.map(|corner| {
                    let [x, y, z] = rules.source_mm(corner);
                    format!("{x:.4}, {y:.4}, {z:.4}")
                });
                format!("{}, one of them from {from} to {to} mm", count_text(*count as u64, "edge"))
            }
            Open::Unknown => "many edges".to_owned(),
        };
        let too_open = if self.is_too_open {
            format!(" To close holes, pack adds up to one triangle for {TRIANGLES_PER_CAP}.")
        } else {
            String::new()
        };
        format!(
            "the surface is open at {where_open}: there is no triangle on the other side, or one too many, or one that shows its inner \
             side.{too_open} Repair it in the program that made it: close holes, join corners that nearly touch, reverse triangles, \
             delete doubles"
        )
    }
}
