//! A surface as a body: triangles or patches (`element`, `patches` with their `slabs`) are read in ascending order (`sweep`), kept while the plane cuts them (`active`),
//! and drawn (`brush`).

mod active;
mod brush;
mod element;
mod patches;
mod slabs;
mod sweep;

use super::source::ChunkSource;
use super::{Body, Brush, Cut, FieldBody, FieldBrush, PixelBody};
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{Effort, SectionPlane};
use crate::stream::{Charge, MemoryBudget};
use brush::{FieldSheet, PixelSheet, Sheet, SurfaceBrush};
use element::Element;
use sweep::Sweep;

/// Rows of a band. A facet is cut once for each band that it may reach, so bands are not too low; and a small picture has work for several
/// threads, so they are not too high.
pub(super) const ROWS_PER_BAND: usize = 64;

/// Elements and what they enclose, as a body. Each thread draws with a sheet.
struct Surface<E: Element, S> {
    sweep: Sweep<E>,
    sheets: Vec<S>,
    /// Centre of the first pixel, and from one to the next, quanta.
    origin: [f64; 2],
    step: [f64; 2],
    quantum_um: f64,
    _charge: Charge,
}

/// A surface to be drawn as pixels on `threads` threads. Its memory is charged to `budget`.
///
/// # Errors
/// [`SliceError`] if the memory is not free.
pub(in crate::slice) fn pixels<E: Element>(
    source: Box<dyn ChunkSource<E>>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn PixelBody>, SliceError> {
    Ok(Box::new(Surface::<E, PixelSheet>::new(source, plan, threads, budget)?))
}

/// As [`pixels`], as a field.
///
/// # Errors
/// As [`pixels`].
pub(in crate::slice) fn field<E: Element>(
    source: Box<dyn ChunkSource<E>>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn FieldBody>, SliceError> {
    Ok(Box::new(Surface::<E, FieldSheet>::new(source, plan, threads, budget)?))
}

/// Memory that [`pixels`] charges, bytes. It is known before a chunk is read.
pub(in crate::slice) fn pixels_memory_bytes<E: Element>(
    source: &dyn ChunkSource<E>,
    plan: &SlicePlan,
    threads: usize,
) -> u64 {
    Surface::<E, PixelSheet>::memory_bytes(source, plan, threads)
}

/// Memory that [`field`] charges, bytes. It is known before a chunk is read.
pub(in crate::slice) fn field_memory_bytes<E: Element>(
    source: &dyn ChunkSource<E>,
    plan: &SlicePlan,
    threads: usize,
) -> u64 {
    Surface::<E, FieldSheet>::memory_bytes(source, plan, threads)
}

fn sheets_bytes<S: Sheet>(plan: &SlicePlan, threads: usize) -> u64 {
    S::bytes(plan).saturating_mul(threads as u64)
}

impl<E: Element, S: Sheet> Surface<E, S> {
    fn new(
        source: Box<dyn ChunkSource<E>>,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let charge = budget.charge("the rows that triangles cross", sheets_bytes::<S>(plan, threads))?;
        let quantum_um = source.quantum_um();
        let [origin, step] = [plan.origin_um, plan.step_um()].map(|um| um.map(|um| um / quantum_um));
        let sweep = Sweep::new(source, plan, threads, budget)?;
        let sheets = (0..threads).map(|_| S::new(plan)).collect();
        Ok(Self { sweep, sheets, origin, step, quantum_um, _charge: charge })
    }

    fn memory_bytes(source: &dyn ChunkSource<E>, plan: &SlicePlan, threads: usize) -> u64 {
        Sweep::memory_bytes(source, plan, threads).saturating_add(sheets_bytes::<S>(plan, threads))
    }

    /// A brush for each thread.
    fn sheet_brushes(&mut self, cut: &Cut) -> impl Iterator<Item = SurfaceBrush<'_, E, S>> {
        let origin = [0, 1].map(|axis| self.origin[axis] + cut.shift_px[axis] * self.step[axis]);
        let plane = SectionPlane { z: cut.z_um / self.quantum_um, origin, step: self.step };
        let (active, cutter) = (self.sweep.active(), self.sweep.cutter());
        self.sheets.iter_mut().map(move |sheet| SurfaceBrush { active, cutter, plane, sheet })
    }
}

impl<E: Element, S: Sheet> Body for Surface<E, S> {
    fn rows_per_band(&self) -> usize {
        ROWS_PER_BAND
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.sweep.advance(z_um / self.quantum_um, workers)
    }

    fn active_count(&self) -> usize {
        self.sweep.active().count()
    }

    fn effort(&self) -> Effort {
        Effort::default()
    }
}

impl<E: Element> PixelBody for Surface<E, PixelSheet> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>> {
        self.sheet_brushes(cut).map(|brush| Box::new(brush) as Box<dyn Brush>).collect()
    }
}

impl<E: Element> FieldBody for Surface<E, FieldSheet> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn FieldBrush + '_>> {
        self.sheet_brushes(cut).map(|brush| Box::new(brush) as Box<dyn FieldBrush>).collect()
    }
}
