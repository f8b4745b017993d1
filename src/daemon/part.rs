//! A part ready to print: its build file opened, placed on the machine, its memory counted, and its layers on demand.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::buildfile::{BuildFile, BuildFileError};
use crate::config::{Machine, Recipe};
use crate::device::encoding::{self, Choice};
use crate::layer::{Bitmap, Depth};
use crate::link::message::Encoding;
use crate::slice::{BodySource, Footing, SliceError, SlicePlan, Slicer};
use crate::stream::{Ahead, MemoryBudget, Produced};

/// Memory of the line at most, bytes: queues of the session both ways, the serial buffers, bookkeeping of one layer.
const LINK_BYTES: u64 = 512 << 10;

/// Largest queue of computed layers, bytes. A longer one would not help, and an abort throws its layers away.
const MAX_QUEUE_BYTES: u64 = 16 << 20;

/// A layer as it goes to the device.
#[derive(Debug)]
pub(super) struct EncodedLayer {
    /// Its number.
    pub layer: u32,
    /// Its encoding.
    pub encoding: Encoding,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// CRC-32 of the decoded rows.
    pub decoded_crc32: u32,
}

/// Why a part cannot be printed on this machine. Each text says what to do.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unprintable {
    /// The file cannot be read, is not a build file, or is damaged.
    #[error(transparent)]
    File(#[from] BuildFileError),
    /// The part does not fit the machine.
    #[error("{0}")]
    Part(String),
    /// It needs more memory than the budget.
    #[error(
        "this job needs {} of memory, but memory_budget is {}: raise it to at least {} in the daemon's configuration",
        mebibytes(*.need_bytes), mebibytes(*.limit_bytes), mebibytes(*.need_bytes)
    )]
    Memory {
        /// Peak memory of the print path.
        need_bytes: u64,
        /// The budget.
        limit_bytes: u64,
    },
}

/// Rounded up, so that this budget is enough.
fn mebibytes(bytes: u64) -> String {
    format!("{}MiB", bytes.div_ceil(1 << 20))
}

/// Peak memory of a print, computed from header and index alone. `layerctl check` shows the same figure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PrintMemory {
    /// Number of threads that compute the layers.
    pub(crate) threads: usize,
    slicer_bytes: u64,
    /// Memory of the picture, the encoder's output, a layer that waits for room in the queue, and the line.
    buffer_bytes: u64,
    /// Room for two layers: both in the queue, or one in the queue and one on the line.
    min_queue_bytes: u64,
}

impl PrintMemory {
    /// Of a part on a raster, computed by as many of `max_threads` threads as `limit_bytes` allow: each takes memory of its
    /// own, and a host with many cores is to print what one with few can.
    pub(crate) fn within(file: &Arc<BuildFile>, plan: &SlicePlan, max_threads: usize, limit_bytes: u64) -> Self {
        let bodies = BodySource::of(file);
        let mut several = (2..=max_threads).rev().map(|threads| Self::new(&bodies, plan, threads));
        several.find(|memory| memory.need_bytes() <= limit_bytes).unwrap_or_else(|| Self::new(&bodies, plan, 1))
    }

    fn new(bodies: &[BodySource], plan: &SlicePlan, threads: usize) -> Self {
        let slicer_bytes = Slicer::memory_bytes(bodies, plan, threads);
        Self { threads, slicer_bytes, ..Self::of_pictures(plan.depth, plan.raster.width_px, plan.raster.height_px) }
    }

    /// Without what the struts take.
    fn of_pictures(depth: Depth, width_px: u32, height_px: u32) -> Self {
        let raw_bytes = depth.stride_bytes(width_px) as u64 * u64::from(height_px);
        Self {
            threads: 1,
            slicer_bytes: 0,
            buffer_bytes: raw_bytes + 2 * encoding::largest_encoded_bytes(depth, raw_bytes) + LINK_BYTES,
            min_queue_bytes: 2 * raw_bytes + (64 << 10),
        }
    }

    /// Memory for a part without any strut on a machine of this size, bytes.
    pub(crate) fn min_bytes(depth: Depth, width_px: u32, height_px: u32) -> u64 {
        Self::of_pictures(depth, width_px, height_px).need_bytes()
    }

    /// The least budget that is enough, bytes.
    pub(crate) fn need_bytes(&self) -> u64 {
        self.slicer_bytes.saturating_add(self.buffer_bytes + self.min_queue_bytes)
    }

    /// Size of the queue of computed layers within a budget that is enough, bytes.
    fn queue_bytes(&self, limit_bytes: u64) -> u64 {
        let room_bytes = limit_bytes.saturating_sub(self.need_bytes()).saturating_add(self.min_queue_bytes);
        room_bytes.min(MAX_QUEUE_BYTES.max(self.min_queue_bytes))
    }

    /// The most that a print takes of a budget that is enough, bytes: the queue of computed layers takes what is left, up to its
    /// own limit.
    pub(crate) fn max_bytes(&self, limit_bytes: u64) -> u64 {
        self.need_bytes() - self.min_queue_bytes + self.queue_bytes(limit_bytes)
    }
}

/// A build file placed on a machine.
#[derive(Debug)]
pub(super) struct Part {
    path: PathBuf,
    plan: SlicePlan,
    threads: usize,
    queue_bytes: u64,
    buffer_bytes: u64,
}

impl Part {
    /// Opens a build file and checks that it fits the machine and the budget, from its header and index alone.
    ///
    /// # Errors
    /// [`Unprintable`].
    pub(super) fn open(
        path: &Path,
        machine: &Machine,
        recipe: &Recipe,
        max_threads: usize,
        limit_bytes: u64,
    ) -> Result<Self, Unprintable> {
        let file = Arc::new(BuildFile::open(path)?);
        let (Machine::Dlp(machine), Recipe::Dlp(recipe)) = (machine, recipe);
        let plan = SlicePlan::new(file.header(), machine.raster(), recipe.depth(), recipe.layer_height_um)
            .map_err(|error| Unprintable::Part(error.to_string()))?;
        let memory = PrintMemory::within(&file, &plan, max_threads, limit_bytes);
        let need_bytes = memory.need_bytes();
        if need_bytes > limit_bytes {
            return Err(Unprintable::Memory { need_bytes, limit_bytes });
        }
        let queue_bytes = memory.queue_bytes(limit_bytes);
        let PrintMemory { threads, buffer_bytes, .. } = memory;
        Ok(Self { path: path.into(), plan, threads, queue_bytes, buffer_bytes })
    }

    /// Number of layers.
    pub(super) fn layer_count(&self) -> u32 {
        self.plan.layer_count
    }

    /// Computes the bottom layers and checks that the part would hold to the plate. Needs as much memory as a print, so none may be
    /// under way.
    ///
    /// # Errors
    /// A text for the operator: which layers are dark, or what is damaged, and what to do.
    pub(super) fn check_footing(&self, recipe: &Recipe, limit_bytes: u64) -> Result<(), String> {
        let Recipe::Dlp(recipe) = recipe;
        let file = BuildFile::open(&self.path).map_err(|error| spool_text(&error))?;
        let budget = MemoryBudget::new(limit_bytes);
        let footing = Slicer::new(BodySource::of(&Arc::new(file)), self.plan.clone(), self.threads, 0, &budget)
            .and_then(|mut slicer| Footing::of(&mut slicer, recipe.bottom_layers))
            .map_err(|error| slice_text(&error))?;
        footing.problem(self.plan.layer_count).map_or(Ok(()), Err)
    }

    /// Starts computing layers from `first` on, written in `encoding`.
    ///
    /// # Errors
    /// A text for the operator.
    pub(super) fn layers(
        self: &Arc<Self>,
        first: u32,
        encoding: Choice,
        budget: &MemoryBudget,
    ) -> Result<Ahead<EncodedLayer>, String> {
        let file = BuildFile::open(&self.path).map_err(|error| spool_text(&error))?;
        let buffers = budget
            .charge("the picture and the line's buffers", self.buffer_bytes)
            .map_err(|error| error.to_string())?;
        let mut slicer = Slicer::new(BodySource::of(&Arc::new(file)), self.plan.clone(), self.threads, first, budget)
            .map_err(|error| slice_text(&error))?;
        let raster = &self.plan.raster;
        let mut bitmap = Bitmap::new(raster.width_px, raster.height_px, self.plan.depth);
        let mut encoded = Vec::new();
        let produce = move || -> Produced<EncodedLayer> {
            let _held = &buffers;
            let Some(layer) = slicer.next_layer(&mut bitmap).map_err(|error| slice_text(&error))? else {
                return Ok(None);
            };
            let encoding =
                encoding::encode_shortest(&bitmap, encoding, &mut encoded).map_err(|error| error.to_string())?;
            let decoded_crc32 = encoding::picture_crc32(&bitmap);
            let layer = EncodedLayer { layer, encoding, bytes: encoded.clone(), decoded_crc32 };
            let bytes = layer.bytes.len() as u64;
            Ok(Some((layer, bytes)))
        };
        Ahead::start(budget, self.queue_bytes, produce).map_err(|error| error.to_string())
    }
}

/// Why a part in the spool cannot be used. It is a copy, so the advice of [`BuildFileError`] on the original does not apply.
pub(super) fn spool_text(error: &BuildFileError) -> String {
    error.damage().map_or_else(|| error.to_string(), |damage| damaged(&damage))
}

fn slice_text(error: &SliceError) -> String {
    match error {
        SliceError::Damaged(damage) => damaged(damage),
        SliceError::Source(source) => source.downcast_ref().map_or_else(|| error.to_string(), spool_text),
        _ => error.to_string(),
    }
}

fn damaged(damage: &str) -> String {
    format!(
        "the spool's copy of the part is damaged ({damage}). End this job, start the part again from its original file, and check \
         the spool's disk"
    )
}
