//! A lattice as a body: struts are read in ascending order (`sweep`), kept while they are active (`active`), and drawn (`brush`).

mod active;
mod brush;
pub(super) mod joined;
mod sweep;

use super::source::ChunkSource;
use super::{Body, Brush, Cut, FieldBody, FieldBrush, PixelBody};
use crate::buildfile::Strut;
use crate::layer::Depth;
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{
    Convolution, Effort, FieldShape, Grid, InstructionSet, MAX_RADIUS_SHARE, PixelShape, Plane, Shape, Union,
    UnionExcess,
};
use crate::stream::MemoryBudget;
use brush::{FieldStripBrush, Scale, StripBrush, Strips};
use sweep::Sweep;

/// Struts and balls of one joint, as a body.
struct Lattice<S: Shape> {
    /// The pixels of the plan, in the unit of length of the solid.
    grid: Grid,
    /// Unit of length of the solid, micrometres.
    unit_um: f64,
    /// Largest radius of a strut, micrometres.
    radius_um: f64,
    sweep: Sweep,
    strips: Strips<S>,
}

/// A lattice to be drawn as pixels with `instructions` on `threads` threads. Its memory is charged to `budget`.
///
/// # Errors
/// [`SliceError`] if the memory is not free, or a strut is too thick for the support.
pub(in crate::slice) fn pixels(
    instructions: InstructionSet,
    source: Box<dyn ChunkSource<Strut>>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn PixelBody>, SliceError> {
    let unit_um = unit_um(&*source)?;
    Ok(if is_convolution(&*source) {
        let halo = brush::halo::<Convolution>(plan.depth);
        Box::new(Lattice::<Convolution>::new(instructions, source, plan, unit_um, halo, threads, budget)?)
    } else {
        let halo = brush::halo::<Union>(plan.depth);
        Box::new(Lattice::<Union>::new(instructions, source, plan, unit_um, halo, threads, budget)?)
    })
}

/// As [`pixels`], as a field.
///
/// # Errors
/// As [`pixels`].
pub(in crate::slice) fn field(
    instructions: InstructionSet,
    source: Box<dyn ChunkSource<Strut>>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn FieldBody>, SliceError> {
    let unit_um = unit_um(&*source)?;
    Ok(if is_convolution(&*source) {
        Box::new(Lattice::<Convolution>::new(instructions, source, plan, unit_um, 0, threads, budget)?)
    } else {
        Box::new(Lattice::<UnionExcess>::new(instructions, source, plan, unit_um, 0, threads, budget)?)
    })
}

/// Memory that [`pixels`] charges, bytes. It is known before a chunk is read.
pub(in crate::slice) fn pixels_memory_bytes(source: &dyn ChunkSource<Strut>, plan: &SlicePlan, threads: usize) -> u64 {
    if is_convolution(source) {
        Lattice::<Convolution>::memory_bytes(source, plan, brush::halo::<Convolution>(plan.depth), threads)
    } else {
        Lattice::<Union>::memory_bytes(source, plan, brush::halo::<Union>(plan.depth), threads)
    }
}

/// Memory that [`field`] charges, bytes. It is known before a chunk is read.
pub(in crate::slice) fn field_memory_bytes(source: &dyn ChunkSource<Strut>, plan: &SlicePlan, threads: usize) -> u64 {
    if is_convolution(source) {
        Lattice::<Convolution>::memory_bytes(source, plan, 0, threads)
    } else {
        Lattice::<UnionExcess>::memory_bytes(source, plan, 0, threads)
    }
}

/// Whether its struts have fields that are added. Elliptic arcs change nothing in a lattice of one material.
fn is_convolution(source: &dyn ChunkSource<Strut>) -> bool {
    source.header().joint.support_um().is_some()
}

/// Unit of length of the solid: the support of a convolution, else a micrometre.
fn unit_um(source: &dyn ChunkSource<Strut>) -> Result<f64, SliceError> {
    let Some(support_um) = source.header().joint.support_um() else { return Ok(1.0) };
    let radius_um = radius_um(source);
    if radius_um.partial_cmp(&(support_um * MAX_RADIUS_SHARE)) != Some(std::cmp::Ordering::Less) {
        return Err(SliceError::RadiusTooLarge { radius_um, support_um });
    }
    Ok(support_um)
}

fn radius_um(source: &dyn ChunkSource<Strut>) -> f64 {
    f64::from(source.header().radius_range[1]) * source.quantum_um()
}

impl<S: Shape> Lattice<S> {
    fn new(
        instructions: InstructionSet,
        source: Box<dyn ChunkSource<Strut>>,
        plan: &SlicePlan,
        unit_um: f64,
        halo: usize,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let strips = Strips::new(plan, instructions, halo, threads, budget)?;
        let radius_um = radius_um(&*source);
        let sweep = Sweep::new::<S>(source, plan, unit_um, strips.rows_per_band(), threads, budget)?;
        Ok(Self { grid: grid(plan, unit_um), unit_um, radius_um, sweep, strips })
    }

    fn memory_bytes(source: &dyn ChunkSource<Strut>, plan: &SlicePlan, halo: usize, threads: usize) -> u64 {
        let sweep = Sweep::memory_bytes(source, plan, brush::rows_per_band::<S>(plan, halo), threads);
        sweep.saturating_add(Strips::<S>::memory_bytes(plan, halo, threads))
    }

    /// A brush for each thread.
    fn strip_brushes(&mut self, cut: &Cut) -> impl Iterator<Item = StripBrush<'_, S>> {
        let mut grid = self.grid;
        grid.x0 += cut.shift_px[0] * grid.dx;
        grid.y0 += cut.shift_px[1] * grid.dy;
        let plane = Plane { grid, z: cut.z_um / self.unit_um, quantum: self.sweep.quantum() };
        let (active, instructions) = (self.sweep.active(), self.strips.instructions());
        self.strips.each_mut().map(move |strip| StripBrush { active, plane, instructions, strip })
    }
}

impl<S: Shape> Body for Lattice<S> {
    fn rows_per_band(&self) -> usize {
        self.strips.rows_per_band()
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.sweep.advance(z_um, workers)
    }

    fn active_count(&self) -> usize {
        self.sweep.active().alive()
    }

    fn effort(&self) -> Effort {
        self.strips.effort()
    }
}

impl<S: PixelShape> PixelBody for Lattice<S> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>> {
        self.strip_brushes(cut).map(|brush| Box::new(brush) as Box<dyn Brush>).collect()
    }
}

impl<S: FieldShape> FieldBody for Lattice<S> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn FieldBrush + '_>> {
        let scale = Scale::of::<S>(&self.grid, self.unit_um, self.radius_um);
        let brush = |strip| Box::new(FieldStripBrush { strip, scale }) as Box<dyn FieldBrush>;
        self.strip_brushes(cut).map(brush).collect()
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
