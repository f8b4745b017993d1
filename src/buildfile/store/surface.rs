//! Builds the header of a surface from its triangles as they are written. `writer` adds it to the header of the file.

use super::lowest::Lowest;
use super::profile::ProfileBuilder;
use crate::buildfile::model::{Bounds, Surface, Triangle};
use crate::buildfile::primitive::{Primitive, Sortable};

/// A surface that is being written.
pub(super) struct SurfaceBuilder {
    surface: Surface,
    profile: ProfileBuilder,
    lowest: Lowest,
    last: Option<Triangle>,
}

impl SurfaceBuilder {
    pub(super) fn new() -> Self {
        let surface = Surface { bounds: Bounds::EMPTY, triangle_count: 0 };
        Self { surface, profile: ProfileBuilder::default(), lowest: Lowest::default(), last: None }
    }

    /// Adds a triangle.
    ///
    /// # Errors
    /// A text that says how the triangle is out of order, not as [`Triangle`] demands, or out of range. Then it is not added.
    pub(super) fn add(&mut self, triangle: Triangle) -> Result<(), String> {
        if Triangle::new(triangle.corners) != triangle {
            return Err(format!("{triangle:?}: its lowest corner must come first"));
        }
        triangle.check_range()?;
        if self.last.is_some_and(|last| last.key() > triangle.key()) {
            return Err(format!("{triangle:?} comes after a higher one"));
        }
        self.surface.bounds = self.surface.bounds.joined(&triangle.bounds());
        self.surface.triangle_count += 1;
        let [low, high] = triangle.z_range().map(i64::from);
        self.profile.add(low, high);
        self.lowest.add_triangle(&triangle);
        self.last = Some(triangle);
        Ok(())
    }

    /// The header of the triangles added so far.
    pub(super) fn header(&self) -> Surface {
        self.surface.clone()
    }

    /// Their profile.
    pub(super) fn profile(&self) -> &ProfileBuilder {
        &self.profile
    }

    /// Their lowest point, micrometres.
    pub(super) fn bottom_um(&self, quantum_um: f64) -> f64 {
        self.lowest.um(quantum_um)
    }
}
