//! The contours of a part, layer after layer. [`scan`](super) has an example.
//!
//! A layer is drawn as a field and marched through band by band. Some bands are done at once, one on each free thread; then `join` adds
//! them in order, so memory holds the crossings of the layer, and the field of a few bands only.

use std::time::{Duration, Instant};

use super::Region;
use super::charged::Charged;
use super::field::{Field, KeptRow, Piece};
use super::join::{Join, Rings, Span};
use super::nest::{self, Places};
use super::simplify::{Kept, Simplifier};
use crate::slice::bodies::{self, Bodies};
use crate::slice::body::fields::FieldSource;
use crate::slice::body::{BodySource, Cut, FieldBody, FieldBrush};
use crate::slice::{SliceError, SlicePlan};
use crate::solid::InstructionSet;
use crate::stream::{BudgetExceeded, Charge, MemoryBudget};

/// Bands that are done before they are joined, for each thread: enough that threads seldom wait for the last one.
const BANDS_PER_THREAD: usize = 4;

/// Most rows of a band: as many as the strips of a lattice have.
const MAX_ROWS: usize = 64;

/// Computes the regions of the layers of a plan, in ascending order. They do not depend on the number of threads, the instruction set, or
/// the first layer.
pub struct Contours {
    plan: SlicePlan,
    next_layer: u32,
    bodies: Bodies<dyn FieldBody>,
    simplifier: Simplifier,
    places: Places,
    rows_per_band: usize,
    fields: Vec<Field>,
    pieces: Vec<Piece>,
    join: Join,
    frame: KeptRow,
    rings: Rings,
    /// Memory of each thread to simplify with.
    kept: Vec<(Charged<Kept>, Result<(), BudgetExceeded>)>,
    times: ContourTimes,
    budget: MemoryBudget,
    _charge: Charge,
}

/// The regions of a layer. Dropping them returns their memory to the budget.
#[derive(Debug)]
pub struct LayerRegions {
    layer: u32,
    regions: Vec<Region>,
    _charge: Charge,
}

/// Time that the steps took, of all threads together.
#[derive(Clone, Copy, Debug, Default)]
pub struct ContourTimes {
    /// Reading struts and drawing the field.
    pub field: Duration,
    /// Marching through the bands.
    pub march: Duration,
    /// Joining bands, tracing rings and making regions.
    pub join: Duration,
    /// Simplification.
    pub simplify: Duration,
}

impl Contours {
    /// Contours from layer `first_layer` on, computed on `threads` threads. A contour leaves the border by at most
    /// `simplify_tolerance_um`, micrometres, where points are left out; 0 keeps all points. What [`Contours::memory_bytes`] says is charged
    /// to `budget` now. What crossings and regions take is charged while a layer is computed, because it depends on how complex it is.
    ///
    /// # Errors
    /// [`SliceError`] if the memory is not free, the part cannot be sliced, `threads` is out of range, or the tolerance is negative or
    /// not finite.
    pub fn new(
        bodies: Vec<BodySource>,
        plan: SlicePlan,
        simplify_tolerance_um: f64,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let instructions = InstructionSet::detect();
        Self::with_instructions(instructions, whole(bodies), plan, simplify_tolerance_um, threads, first_layer, budget)
    }

    /// As [`Contours::new`], of a material, if the sources are [`FieldSource::of_material`].
    ///
    /// # Errors
    /// As [`Contours::new`].
    pub fn of_sources(
        bodies: Vec<FieldSource>,
        plan: SlicePlan,
        simplify_tolerance_um: f64,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let instructions = InstructionSet::detect();
        Self::with_instructions(instructions, bodies, plan, simplify_tolerance_um, threads, first_layer, budget)
    }

    /// As [`Contours::new`], with a given instruction set. All sets of [`InstructionSet::available`] give equal regions.
    ///
    /// # Errors
    /// As [`Contours::new`].
    pub fn with_instructions(
        instructions: InstructionSet,
        bodies: Vec<FieldSource>,
        plan: SlicePlan,
        simplify_tolerance_um: f64,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        if !(simplify_tolerance_um >= 0.0 && simplify_tolerance_um.is_finite()) {
            return Err(SliceError::BadTolerance(simplify_tolerance_um));
        }
        let body = |source: FieldSource| source.field(instructions, &plan, threads, budget);
        let file_bytes = bodies::file_bytes(bodies.iter().flat_map(FieldSource::files), threads);
        let bodies = Bodies::new(bodies, file_bytes, threads, budget, body)?;
        let raster = &plan.raster;
        let width_px = raster.width_px as usize;
        let rows_per_band = bodies.rows_per_band().unwrap_or(MAX_ROWS).min(MAX_ROWS);
        let charge = budget.charge("the field of a layer", own_bytes(&plan, threads))?;
        Ok(Self {
            simplifier: Simplifier { pixel_um: raster.pixel_um, tolerance_um: simplify_tolerance_um },
            places: Places::new(raster),
            rows_per_band,
            fields: (0..threads).map(|_| Field::new(width_px, rows_per_band)).collect(),
            pieces: (0..threads * BANDS_PER_THREAD).map(|_| Piece::new(width_px, budget)).collect(),
            join: Join::new(width_px, budget),
            frame: KeptRow::frame(width_px),
            rings: Rings::new(budget),
            kept: (0..threads).map(|_| (Charged::new(budget), Ok(()))).collect(),
            times: ContourTimes::default(),
            budget: budget.clone(),
            _charge: charge,
            next_layer: first_layer,
            plan,
            bodies,
        })
    }

    /// Memory that the contours charge to their budget before the first layer, bytes. It is known before a chunk is read. A layer takes
    /// some 50 bytes more for each edge of the pixel grid that its border crosses, and its regions 16 bytes for each point.
    pub fn memory_bytes(bodies: &[BodySource], plan: &SlicePlan, threads: usize) -> u64 {
        let each = bodies.iter().map(|body| body.field_memory_bytes(plan, threads));
        let files = bodies::file_bytes(bodies.iter().flat_map(BodySource::files), threads);
        each.fold(files.saturating_add(own_bytes(plan, threads)), u64::saturating_add)
    }

    /// As [`Contours::memory_bytes`], for [`Contours::of_sources`].
    pub fn memory_bytes_of_sources(bodies: &[FieldSource], plan: &SlicePlan, threads: usize) -> u64 {
        let each = bodies.iter().map(|body| body.memory_bytes(plan, threads));
        let files = bodies::file_bytes(bodies.iter().flat_map(FieldSource::files), threads);
        each.fold(files.saturating_add(own_bytes(plan, threads)), u64::saturating_add)
    }

    /// The regions of the next layer; `None` after the last. Outer rings and holes lie on the border of the solid, without the
    /// compensation of a beam.
    ///
    /// # Errors
    /// [`SliceError`] if the primitives cannot be read or contradict the build file, or if the layer is too complex for the memory
    /// budget.
    pub fn next_layer(&mut self) -> Result<Option<LayerRegions>, SliceError> {
        let layer = self.next_layer;
        if layer >= self.plan.layer_count {
            return Ok(None);
        }
        let began = Instant::now();
        let z_um = self.plan.layer_z_um(layer);
        self.bodies.advance(z_um)?;
        self.times.field += began.elapsed();
        let (regions, charge) = self.regions(z_um).map_err(|exceeded| SliceError::TooComplex { layer, exceeded })?;
        self.next_layer += 1;
        Ok(Some(LayerRegions { layer, regions, _charge: charge }))
    }

    /// The plan.
    pub fn plan(&self) -> &SlicePlan {
        &self.plan
    }

    /// Time that the steps took since the contours were made, for benchmarks.
    pub fn times(&self) -> ContourTimes {
        let mut times = self.times;
        for [field, march] in self.fields.iter().map(|field| field.times) {
            times.field += field;
            times.march += march;
        }
        times
    }

    fn regions(&mut self, z_um: f64) -> Result<(Vec<Region>, Charge), BudgetExceeded> {
        self.trace(z_um)?;
        if self.simplifier.tolerance_um > 0.0 {
            let began = Instant::now();
            self.simplify()?;
            self.times.simplify += began.elapsed();
        }
        let began = Instant::now();
        let charge = self.budget.charge("the regions of a layer", nest::bytes(&self.rings))?;
        let regions = nest::regions(&self.rings, &self.places);
        self.times.join += began.elapsed();
        Ok((regions, charge))
    }

    /// Finds the rings of a plane.
    fn trace(&mut self, z_um: f64) -> Result<(), BudgetExceeded> {
        let height_px = self.plan.raster.height_px as usize;
        let mirror = self.plan.raster.mirror;
        // With one axis mirrored, left and right are exchanged.
        let reversed = mirror.x != mirror.y;
        let (bodies, workers) = self.bodies.parts();
        let cut = Cut { z_um, shift_px: [0.0; 2], layer: self.next_layer };
        let mut brushes: Vec<Vec<Box<dyn FieldBrush + '_>>> = self.fields.iter().map(|_| Vec::new()).collect();
        for body in bodies {
            for (brushes, brush) in brushes.iter_mut().zip(body.brushes(&cut)) {
                brushes.push(brush);
            }
        }
        let mut threads: Vec<_> = brushes.iter_mut().zip(&mut self.fields).collect();
        self.join.begin();
        for first in (0..height_px).step_by(self.rows_per_band * self.pieces.len()) {
            let bands = (first..height_px).step_by(self.rows_per_band).zip(&mut self.pieces);
            let rows = |first: usize| [first, self.rows_per_band.min(height_px - first)];
            workers.run(bands, &mut threads, |(brushes, field), (first, piece)| {
                field.cover(brushes, rows(first), reversed, piece);
            });
            let began = Instant::now();
            let bands = (first..height_px).step_by(self.rows_per_band).len();
            for piece in self.pieces.iter_mut().take(bands) {
                std::mem::replace(&mut piece.outcome, Ok(()))?;
                self.join.add(piece, reversed)?;
            }
            self.times.join += began.elapsed();
        }
        let began = Instant::now();
        self.join.finish(&mut self.frame, height_px, reversed, &mut self.rings)?;
        self.times.join += began.elapsed();
        Ok(())
    }

    /// Simplifies the rings, each on any thread.
    fn simplify(&mut self) -> Result<(), BudgetExceeded> {
        let Rings { crossings, spans } = &mut self.rings;
        // Any thread may simplify the longest ring: what is charged does not depend on which one does.
        let longest = spans.iter().map(|span| (span.end - span.start) as usize).max().unwrap_or(0);
        self.kept.iter_mut().try_for_each(|(kept, _)| kept.reserve(longest))?;
        let mut rest: &mut [_] = crossings;
        let rings = spans.iter_mut().map(|span| {
            let (ring, others) = std::mem::take(&mut rest).split_at_mut((span.end - span.start) as usize);
            rest = others;
            (span, ring)
        });
        let simplifier = self.simplifier;
        let (_, workers) = self.bodies.parts();
        workers.run(rings, &mut self.kept, |(kept, outcome), (span, ring): (&mut Span, _)| {
            match simplifier.simplify(ring, kept) {
                Ok(count) => span.end = span.start + count as u32,
                Err(exceeded) => *outcome = Err(exceeded),
            }
        });
        // All are taken, so that none is left for the next layer.
        let mut all = Ok(());
        for (_, outcome) in &mut self.kept {
            all = all.and(std::mem::replace(outcome, Ok(())));
        }
        all
    }
}

impl LayerRegions {
    /// Number of the layer.
    pub fn layer(&self) -> u32 {
        self.layer
    }

    /// The regions, in the order of their first pixels, row by row.
    pub fn regions(&self) -> &[Region] {
        &self.regions
    }
}

/// Memory of fields, bands and rows, bytes.
fn own_bytes(plan: &SlicePlan, threads: usize) -> u64 {
    let width_px = plan.raster.width_px as usize;
    let per_thread = Field::bytes(width_px, MAX_ROWS) + BANDS_PER_THREAD as u64 * Piece::bytes(width_px);
    threads as u64 * per_thread + Join::bytes(width_px) + KeptRow::bytes(width_px)
}

/// Bodies of which all is drawn.
fn whole(bodies: Vec<BodySource>) -> Vec<FieldSource> {
    bodies.into_iter().map(FieldSource::Whole).collect()
}
