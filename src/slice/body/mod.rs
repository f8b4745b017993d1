//! What a layer is drawn from: bodies, each cut by the plane that rises through it.

pub(super) mod lattice;

use super::SliceError;
use super::band::Band;
use super::workers::Workers;
use crate::solid::Effort;

/// A plane through a part, and where its pixels lie.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// Its height, micrometres.
    pub(super) z_um: f64,
    /// How far its pixels lie from the plan's, pixels along x and y.
    pub(super) shift_px: [f64; 2],
}

/// One body of a part. It is asked once a layer and once a band, never for single pixels.
pub(super) trait Body: Send {
    /// Most rows that [`Brush::cover`] takes at once.
    fn rows_per_band(&self) -> usize;

    /// Moves the plane up; planes ascend.
    ///
    /// # Errors
    /// Where what the body is made of cannot be read, or contradicts what its file promised.
    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError>;

    /// What each thread draws the plane last given to [`Body::advance`] with: as many as the body was made for.
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>>;

    /// Primitives within reach of that plane.
    fn active_count(&self) -> usize;

    /// What drawing has taken since the body was made.
    fn effort(&self) -> Effort;
}

/// Draws one body for one thread.
pub(super) trait Brush: Send {
    /// Merges the body into a band.
    fn cover(&mut self, band: &mut Band<'_>);
}
