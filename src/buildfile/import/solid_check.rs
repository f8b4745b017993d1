//! Whether triangles enclose a solid: whether each edge has both sides, and how large the volume is. `surface` uses it.

use glam::DVec3;

use super::open_edges::{Open, OpenEdges};
use super::rules::Rules;
use crate::buildfile::error::PackError;
use crate::buildfile::model::QUANTUM_FRACTIONS;
use crate::text::count_text;

const FRACTIONS: f64 = QUANTUM_FRACTIONS as f64;

/// What is known of the triangles of a solid.
#[derive(Default)]
pub(super) struct SolidCheck {
    /// Edges that have no other side yet.
    edges: OpenEdges,
    /// Six times the volume, cubic quanta.
    volume: f64,
}

impl SolidCheck {
    /// Adds a triangle, whose corners are in fractions of a quantum.
    pub(super) fn add(&mut self, corners: [[i64; 3]; 3]) {
        self.edges.add(corners);
        let [a, b, c] = corners.map(|corner| DVec3::from(corner.map(|at| at as f64)) / FRACTIONS);
        self.volume += a.dot(b.cross(c));
    }

    /// Ends the solid, which `place` names.
    ///
    /// # Errors
    /// If the triangles do not enclose anything: the surface is open, or inside out.
    pub(super) fn end(mut self, place: &str, rules: &Rules) -> Result<(), PackError> {
        if let Some(open) = self.edges.finish() {
            return Err(PackError::input(place, open_text(&open, rules)));
        }
        if self.volume > 0.0 {
            return Ok(());
        }
        let volume_mm3 = self.volume / 6.0 * (rules.quantum_um() / 1000.0).powi(3);
        let problem = if volume_mm3 < 0.0 {
            format!(
                "the surface is inside out: its volume is {volume_mm3:.3} mm³. Reverse its triangles in the program that made it"
            )
        } else {
            "the surface encloses nothing: give it a thickness in the program that made it".into()
        };
        Err(PackError::input(place, problem))
    }
}

fn open_text(open: &Open, rules: &Rules) -> String {
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
    format!(
        "the surface is open at {where_open}: there is no triangle on the other side, or one too many, or one that shows its inner \
         side. Repair it in the program that made it: close holes, join corners that nearly touch, reverse triangles, delete doubles"
    )
}
