//! A lattice as a body: struts are read in ascending order (`sweep`), kept while they are active (`active`), and drawn (`brush`).

mod active;
mod brush;
mod source;
mod sweep;

pub(in crate::slice) use source::StoredLattice;
pub use source::{ChunkSpan, MemoryStruts, StrutSource};

use super::{Body, Brush, Cut};
use crate::buildfile::Blend;
use crate::layer::Depth;
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{Convolution, Effort, Grid, InstructionSet, MAX_RADIUS_SHARE, Plane, Shape, Union};
use crate::stream::MemoryBudget;
use brush::{StripBrush, Strips};
use sweep::Sweep;

/// Struts and balls of one blend, as a body.
struct Lattice<S: Shape> {
    /// The pixels of the plan, in the unit of length of the solid.
    grid: Grid,
    /// Unit of length of the solid, micrometres.
    unit_um: f64,
    sweep: Sweep,
    strips: Strips<S>,
}

/// A lattice to be drawn with `instructions` on `threads` threads. Its memory is charged to `budget`.
///
/// # Errors
/// [`SliceError`] if the memory is not free, or a strut is too thick for the support.
pub(in crate::slice) fn body(
    instructions: InstructionSet,
    source: Box<dyn StrutSource>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn Body>, SliceError> {
    match source.lattice().blend {
        Blend::Convolution { support_um } => {
            let radius_um = f64::from(source.lattice().radius_range[1]) * source.quantum_um();
            if radius_um.partial_cmp(&(support_um * MAX_RADIUS_SHARE)) != Some(std::cmp::Ordering::Less) {
                return Err(SliceError::RadiusTooLarge { radius_um, support_um });
            }
            Ok(Box::new(Lattice::<Convolution>::new(instructions, source, plan, support_um, threads, budget)?))
        }
        Blend::Union => Ok(Box::new(Lattice::<Union>::new(instructions, source, plan, 1.0, threads, budget)?)),
    }
}

/// Memory that [`body`] charges, bytes. It is known before a chunk is read.
pub(in crate::slice) fn memory_bytes(source: &dyn StrutSource, plan: &SlicePlan, threads: usize) -> u64 {
    match source.lattice().blend {
        Blend::Convolution { .. } => Lattice::<Convolution>::memory_bytes(source, plan, threads),
        Blend::Union => Lattice::<Union>::memory_bytes(source, plan, threads),
    }
}

impl<S: Shape> Lattice<S> {
    fn new(
        instructions: InstructionSet,
        source: Box<dyn StrutSource>,
        plan: &SlicePlan,
        unit_um: f64,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let strips = Strips::new(plan, instructions, threads, budget)?;
        let sweep = Sweep::new::<S>(source, plan, unit_um, strips.rows_per_band(), threads, budget)?;
        Ok(Self { grid: grid(plan, unit_um), unit_um, sweep, strips })
    }

    fn memory_bytes(source: &dyn StrutSource, plan: &SlicePlan, threads: usize) -> u64 {
        let sweep = Sweep::memory_bytes(source, plan, brush::rows_per_band::<S>(plan), threads);
        sweep.saturating_add(Strips::<S>::memory_bytes(plan, threads))
    }
}

impl<S: Shape> Body for Lattice<S> {
    fn rows_per_band(&self) -> usize {
        self.strips.rows_per_band()
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.sweep.advance(z_um, workers)
    }

    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>> {
        let mut grid = self.grid;
        grid.x0 += cut.shift_px[0] * grid.dx;
        grid.y0 += cut.shift_px[1] * grid.dy;
        let plane = Plane { grid, z: cut.z_um / self.unit_um, quantum: self.sweep.quantum() };
        let (active, instructions) = (self.sweep.active(), self.strips.instructions());
        let brush = |strip| Box::new(StripBrush::<S> { active, plane, instructions, strip }) as Box<dyn Brush>;
        self.strips.each_mut().map(brush).collect()
    }

    fn active_count(&self) -> usize {
        self.sweep.active().alive()
    }

    fn effort(&self) -> Effort {
        self.strips.effort()
    }
}

fn grid(plan: &SlicePlan, unit_um: f64) -> Grid {
    let [dx, dy] = plan.step_um();
    Grid {
        x0: plan.origin_um[0] / unit_um,
        dx: dx / unit_um,
        y0: plan.origin_um[1] / unit_um,
        dy: dy / unit_um,
        width: plan.raster.width_px as usize,
        samples: match plan.depth {
            Depth::Bit => 1,
            Depth::Grey => 8,
        },
    }
}
