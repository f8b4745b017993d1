//! Memory of a print, added up before it begins. `tests/print.rs` holds a print to the figure, and `layerctl check` shows it.

use std::sync::Arc;

use crate::buildfile::BuildFile;
use crate::config::Machine;
use crate::device::encoding;
use crate::layer::{Depth, Raster};
use crate::slice::scan::Contours;
use crate::slice::{BodySource, SlicePlan, Slicer};

/// Memory of the line at most, bytes: queues of the session both ways, the serial buffers, bookkeeping of one layer.
const MAX_LINK_BYTES: u64 = 512 << 10;

/// Largest queue of computed layers, bytes. A longer one would not help, and an abort throws its layers away.
const MAX_QUEUE_BYTES: u64 = 16 << 20;

/// Least queue of layers of scan vectors, bytes: 300,000 vectors. No layer may be larger than the queue.
const MIN_VECTORS_QUEUE_BYTES: u64 = 1 << 20;

/// Share of the rest of the budget that the queue of layers of scan vectors takes. A vector takes some 3 bytes in it, and more than 70 in
/// the contours, or where one large region is filled with many hatches. So it is not the queue that limits a layer.
const VECTORS_QUEUE_SHARE: u64 = 24;

/// Least memory for contours and vectors of a layer, bytes: some 30,000 vectors. How much layers take is known when they are computed;
/// `layerctl check` computes all of them.
const MIN_SCAN_BYTES: u64 = 8 << 20;

/// By how much the peak of a layer may differ from one run to the next, bytes: threads do not always hold their lists at the same time.
/// It is twenty times the largest difference that was seen.
const THREADS_VARY_BYTES: u64 = 1 << 20;

/// Peak memory of a print, computed from header and index alone. `layerctl check` shows the same figure.
#[derive(Clone, Copy, Debug)]
pub struct PrintMemory {
    /// Number of threads that compute the layers.
    pub threads: usize,
    slicer_bytes: u64,
    /// Memory of the picture, the encoder's output, a layer that waits for room in the queue, and the line. For scan vectors, the line alone.
    buffer_bytes: u64,
    /// Room for two layers: both in the queue, or one in the queue and one on the line.
    min_queue_bytes: u64,
    is_vectors: bool,
    /// Memory of the check of how far the part's patches reach, before the print, when nothing else is held.
    check_bytes: u64,
}

impl PrintMemory {
    /// Of a part on a raster, computed by as many of `max_threads` threads as `limit_bytes` allow: each takes memory of its
    /// own, and a host with many cores is to print what one with few can.
    pub(super) fn within(
        file: &Arc<BuildFile>,
        plan: &SlicePlan,
        scans: bool,
        max_threads: usize,
        limit_bytes: u64,
    ) -> Self {
        let bodies = BodySource::of(file);
        let with = |threads| {
            let memory = match scans {
                true => Self::of_vectors(&bodies, plan, threads),
                false => Self::new(&bodies, plan, threads),
            };
            Self { check_bytes: file.verify_bytes(), ..memory }
        };
        let mut several = (2..=max_threads).rev().map(with);
        several.find(|memory| memory.print_bytes() <= limit_bytes).unwrap_or_else(|| with(1))
    }

    /// For scan vectors. What contours and vectors of a layer need is charged when it is computed.
    fn of_vectors(bodies: &[BodySource], plan: &SlicePlan, threads: usize) -> Self {
        let slicer_bytes = Contours::memory_bytes(bodies, plan, threads).saturating_add(MIN_SCAN_BYTES);
        let min_queue_bytes = MIN_VECTORS_QUEUE_BYTES;
        Self { threads, slicer_bytes, buffer_bytes: MAX_LINK_BYTES, min_queue_bytes, is_vectors: true, check_bytes: 0 }
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
            buffer_bytes: raw_bytes + 2 * encoding::largest_encoded_bytes(depth, raw_bytes) + MAX_LINK_BYTES,
            min_queue_bytes: 2 * raw_bytes + (64 << 10),
            is_vectors: false,
            check_bytes: 0,
        }
    }

    /// The least memory of any print on this machine, bytes: that of a part without struts, in one bit a pixel.
    pub fn min_bytes(machine: &Machine) -> u64 {
        let Raster { width_px, height_px, .. } = machine.raster();
        Self::of_pictures(Depth::Bit, width_px, height_px).need_bytes()
    }

    /// The least budget that is enough, bytes. Layers of scan vectors may need more.
    pub fn need_bytes(&self) -> u64 {
        self.print_bytes().max(self.check_bytes)
    }

    /// The least memory of the print itself, bytes.
    fn print_bytes(&self) -> u64 {
        self.slicer_bytes.saturating_add(self.buffers(self.min_queue_bytes) + self.min_queue_bytes)
    }

    /// Memory of what holds one layer, and of the line, beside a queue of this size, bytes.
    fn buffers(&self, queue_bytes: u64) -> u64 {
        // The encoder's output and a layer that waits for room: no larger than the queue, which has to take them.
        self.buffer_bytes + if self.is_vectors { 2 * queue_bytes } else { 0 }
    }

    /// Size of the queue of computed layers within a budget that is enough, bytes.
    pub fn queue_bytes(&self, limit_bytes: u64) -> u64 {
        let rest_bytes = limit_bytes.saturating_sub(self.print_bytes());
        let more_bytes = if self.is_vectors { rest_bytes / VECTORS_QUEUE_SHARE } else { rest_bytes };
        (self.min_queue_bytes + more_bytes).min(MAX_QUEUE_BYTES.max(self.min_queue_bytes))
    }

    /// Memory of what holds one layer, and of the line, within a budget that is enough, bytes.
    pub(super) fn buffer_bytes(&self, limit_bytes: u64) -> u64 {
        self.buffers(self.queue_bytes(limit_bytes))
    }

    /// The most that a print takes of a budget that is enough, bytes: the queue of computed layers takes what is left, up to its
    /// own limit. Layers of scan vectors may need more.
    pub fn max_bytes(&self, limit_bytes: u64) -> u64 {
        let queue_bytes = self.queue_bytes(limit_bytes);
        (self.slicer_bytes + self.buffers(queue_bytes) + queue_bytes).max(self.check_bytes)
    }

    /// The least budget with which a print computes a layer of scan vectors that took `peak_bytes`, together with the buffers of a budget of
    /// `limit_bytes`.
    pub fn budget_of_layer(&self, peak_bytes: u64, limit_bytes: u64) -> u64 {
        let layer_bytes = peak_bytes.saturating_sub(self.buffer_bytes(limit_bytes)) + THREADS_VARY_BYTES;
        let mut budget_bytes = self.need_bytes();
        // A larger budget has a larger queue, by a small share, so this ends soon.
        loop {
            let taken_bytes = layer_bytes + self.buffer_bytes(budget_bytes) + self.queue_bytes(budget_bytes);
            if taken_bytes <= budget_bytes {
                return budget_bytes;
            }
            budget_bytes = taken_bytes;
        }
    }
}
