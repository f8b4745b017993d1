//! A part as a stream of layers.

use super::draw::Drawing;
use super::sweep::Sweep;
use super::workers::Workers;
use super::{SlicePlan, StrutSource};
use crate::buildfile::Blend;
use crate::layer::{Bitmap, Depth};
use crate::solid::{Convolution, Effort, Grid, LARGEST_RADIUS_SHARE, Path, Plane, Shape, Union};
use crate::stream::{BudgetExceeded, MemoryBudget};

/// Why a layer could not be computed.
#[derive(Debug, thiserror::Error)]
pub enum SliceError {
    /// Memory the budget does not have.
    #[error(transparent)]
    Budget(#[from] BudgetExceeded),
    /// The struts could not be read.
    #[error("{0:#}")]
    Source(anyhow::Error),
    /// The struts contradict header or index; the text says how.
    #[error("{0}; the file is damaged: pack the part again")]
    Damaged(String),
    /// A strut as thick as the kernel's support has no finite weight.
    #[error(
        "the thickest strut has radius {radius_um} µm, but the kernel's support of {support_um} µm allows less than \
         {LARGEST_RADIUS_SHARE} of it: pack the part again with a larger support"
    )]
    RadiusTooLarge {
        /// Largest strut radius.
        radius_um: f64,
        /// Support R.
        support_um: f64,
    },
    /// A bitmap of another size or depth than the plan's.
    #[error("the bitmap is not of the size and depth the plan asks for")]
    WrongBitmap,
    /// Threads outside 1 to [`Slicer::MOST_THREADS`].
    #[error("{0} threads: allowed are 1 to {most}", most = Slicer::MOST_THREADS)]
    BadThreads(usize),
    /// The operating system gave no threads; the text is its reason.
    #[error("cannot start threads to slice with: {0}")]
    Threads(String),
}

/// Computes the layers of a plan, in ascending order.
pub struct Slicer {
    plan: SlicePlan,
    next_layer: u32,
    engine: Engine,
}

/// What differs between the kinds of solid.
enum Engine {
    Convolution(Machinery<Convolution>),
    Union(Machinery<Union>),
}

struct Machinery<S: Shape> {
    unit_um: f64,
    sweep: Sweep,
    drawing: Drawing<S>,
    workers: Workers,
}

impl Slicer {
    /// More than the cores of any host that drives a printer; each takes the memory of a strip and of a chunk.
    pub const MOST_THREADS: usize = 256;

    /// One thread a core, within [`Slicer::MOST_THREADS`].
    pub fn default_threads() -> usize {
        std::thread::available_parallelism().map_or(1, usize::from).min(Self::MOST_THREADS)
    }

    /// A slicer whose first layer will be `first_layer`; what it needs is charged to `budget` now.
    ///
    /// # Errors
    /// [`SliceError`] where the memory is not free, the part cannot be sliced or `threads` is out of range.
    pub fn new(
        source: impl StrutSource + 'static,
        plan: SlicePlan,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        Self::on_path(Path::detect(), source, plan, threads, first_layer, budget)
    }

    /// The same on a given instruction set: layers are equal bit for bit on every one of [`Path::available`].
    ///
    /// # Errors
    /// As [`Slicer::new`].
    pub fn on_path(
        path: Path,
        source: impl StrutSource + 'static,
        plan: SlicePlan,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        if !(1..=Self::MOST_THREADS).contains(&threads) {
            return Err(SliceError::BadThreads(threads));
        }
        let source: Box<dyn StrutSource> = Box::new(source);
        let engine = match source.header().blend {
            Blend::Convolution { support_um } => {
                let header = source.header();
                let radius_um = f64::from(header.radius_range[1]) * header.quantum_um;
                if radius_um.partial_cmp(&(support_um * LARGEST_RADIUS_SHARE)) != Some(std::cmp::Ordering::Less) {
                    return Err(SliceError::RadiusTooLarge { radius_um, support_um });
                }
                Engine::Convolution(Machinery::new(path, source, &plan, support_um, threads, budget)?)
            }
            Blend::Union => Engine::Union(Machinery::new(path, source, &plan, 1.0, threads, budget)?),
        };
        Ok(Self { plan, next_layer: first_layer, engine })
    }

    /// Bytes a slicer will charge to its budget: known before a chunk is read.
    pub fn memory_bytes(source: &dyn StrutSource, plan: &SlicePlan, threads: usize) -> u64 {
        match source.header().blend {
            Blend::Convolution { .. } => Machinery::<Convolution>::memory_bytes(source, plan, threads),
            Blend::Union => Machinery::<Union>::memory_bytes(source, plan, threads),
        }
    }

    /// Draws the next layer over whatever `bitmap` held and returns its index; `None` after the last.
    ///
    /// # Errors
    /// [`SliceError::Source`] where the struts cannot be read, [`SliceError::WrongBitmap`] where the bitmap does not fit.
    pub fn next_layer(&mut self, bitmap: &mut Bitmap) -> Result<Option<u32>, SliceError> {
        let layer = self.next_layer;
        if layer >= self.plan.layer_count {
            return Ok(None);
        }
        self.draw_plane(self.plan.layer_z_um(layer), [0.0; 2], bitmap)?;
        self.next_layer += 1;
        Ok(Some(layer))
    }

    /// Draws the plane at `z_um`, no lower than any before it. Its pixels lie `shift_px` from the plan's: within half a pixel
    /// along x and y where pixels are bits, else 0.
    pub(super) fn draw_plane(&mut self, z_um: f64, shift_px: [f64; 2], bitmap: &mut Bitmap) -> Result<(), SliceError> {
        let raster = &self.plan.raster;
        let wanted = (raster.width_px, raster.height_px, self.plan.depth);
        if (bitmap.width_px(), bitmap.height_px(), bitmap.depth()) != wanted {
            return Err(SliceError::WrongBitmap);
        }
        match &mut self.engine {
            Engine::Convolution(machinery) => machinery.plane(&self.plan, z_um, shift_px, bitmap),
            Engine::Union(machinery) => machinery.plane(&self.plan, z_um, shift_px, bitmap),
        }
    }

    /// Struts within reach of the layer drawn last.
    pub fn active_struts(&self) -> usize {
        match &self.engine {
            Engine::Convolution(machinery) => machinery.sweep.active().alive(),
            Engine::Union(machinery) => machinery.sweep.active().alive(),
        }
    }

    /// What drawing has taken since the slicer was made.
    pub fn effort(&self) -> Effort {
        match &self.engine {
            Engine::Convolution(machinery) => machinery.drawing.effort(),
            Engine::Union(machinery) => machinery.drawing.effort(),
        }
    }

    /// The plan.
    pub fn plan(&self) -> &SlicePlan {
        &self.plan
    }
}

impl<S: Shape> Machinery<S> {
    fn new(
        path: Path,
        source: Box<dyn StrutSource>,
        plan: &SlicePlan,
        unit_um: f64,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let drawing = Drawing::new(plan, path, threads, budget)?;
        let rows = Drawing::<S>::rows_per_band(plan);
        let sweep = Sweep::new::<S>(source, plan, unit_um, rows, threads, budget)?;
        Ok(Self { unit_um, sweep, drawing, workers: Workers::new(threads)? })
    }

    fn memory_bytes(source: &dyn StrutSource, plan: &SlicePlan, threads: usize) -> u64 {
        let sweep = Sweep::memory_bytes(source, plan, Drawing::<S>::rows_per_band(plan), threads);
        sweep.saturating_add(Drawing::<S>::memory_bytes(plan, threads))
    }

    fn plane(
        &mut self,
        plan: &SlicePlan,
        z_um: f64,
        shift_px: [f64; 2],
        bitmap: &mut Bitmap,
    ) -> Result<(), SliceError> {
        self.sweep.advance(z_um, &self.workers)?;
        let mut grid = grid(plan, self.unit_um);
        grid.x0 += shift_px[0] * grid.dx;
        grid.y0 += shift_px[1] * grid.dy;
        let plane = Plane { grid, z: z_um / self.unit_um, quantum: self.sweep.quantum() };
        self.drawing.draw(self.sweep.active(), &plane, &self.workers, bitmap);
        Ok(())
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
