//! Puts the bands of a layer together: the cells between two bands, and then the closed rings, each with the ring that surrounds it.
//! `contours` hands it one band after the other; `nest` makes regions of the rings.

use super::charged::Charged;
use super::contour::{Chains, Crossing};
use super::field::{KeptRow, Piece};
use crate::layer::Raster;
use crate::stream::{BudgetExceeded, MemoryBudget};

/// The crossings of a layer, from its first row on.
pub(super) struct Join {
    chains: Chains,
    /// The last row of the band added last.
    last: KeptRow,
}

/// The rings of a layer: their crossings one after the other.
pub(super) struct Rings {
    pub(super) crossings: Charged<Crossing>,
    pub(super) spans: Charged<Span>,
}

/// A ring.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    /// Its first crossing.
    pub(super) start: u32,
    /// The one after its last.
    pub(super) end: u32,
    /// Number of the outer ring of the region that it bounds: its own if it is an outer ring.
    pub(super) outer: u32,
}

/// Marks the number of a ring, in place of the next crossing: a traced crossing is not traced again.
const TRACED: u32 = 1 << 31;

// A row of an even number of pixels has at most as many crossings, for their number is even, and so has a column.
const _: () = assert!(2 * (Raster::MAX_PX as u64) * (Raster::MAX_PX as u64) <= TRACED as u64);

impl Join {
    /// No bands yet.
    pub(super) fn new(width_px: usize, budget: &MemoryBudget) -> Self {
        Self { chains: Chains::new(budget), last: KeptRow::frame(width_px) }
    }

    /// Memory of a row, bytes.
    pub(super) fn bytes(width_px: usize) -> u64 {
        KeptRow::bytes(width_px)
    }

    /// Begins a layer.
    pub(super) fn begin(&mut self) {
        self.chains.clear();
        self.last.make_frame(0);
    }

    /// Adds the next band.
    ///
    /// # Errors
    /// [`BudgetExceeded`] if the memory is not free.
    pub(super) fn add(&mut self, piece: &mut Piece, reversed: bool) -> Result<(), BudgetExceeded> {
        let base = self.chains.crossings.len() as u32;
        self.chains.crossings.extend(piece.chains.crossings.iter().copied())?;
        // Ends that are still open are connected by the cells on both sides of the band.
        self.chains.next.extend(piece.chains.next.iter().map(|next| next.wrapping_add(base)))?;
        (piece.first.first, piece.last.first) = (piece.first.first + base, piece.last.first + base);
        self.chains.march(&self.last.row(), &piece.first.row(), reversed)?;
        std::mem::swap(&mut self.last, &mut piece.last);
        Ok(())
    }

    /// Ends the layer after `height_px` rows, and traces its rings. They come in the order of their first pixels, row by row.
    ///
    /// # Errors
    /// [`BudgetExceeded`] if the memory is not free.
    pub(super) fn finish(
        &mut self,
        frame: &mut KeptRow,
        height_px: usize,
        reversed: bool,
        rings: &mut Rings,
    ) -> Result<(), BudgetExceeded> {
        frame.make_frame(height_px + 1);
        self.chains.march(&self.last.row(), &frame.row(), reversed)?;
        rings.clear();
        let Chains { crossings, next } = &mut self.chains;
        for first in 0..crossings.len() {
            if next[first] & TRACED != 0 {
                continue;
            }
            let (ring, start) = (rings.spans.len() as u32, rings.crossings.len() as u32);
            let mut at = first;
            loop {
                rings.crossings.push(crossings[at])?;
                at = std::mem::replace(&mut next[at], TRACED | ring) as usize;
                if at == first {
                    break;
                }
            }
            // The numbers of crossings ascend along a row, and from row to row, before those between the rows. So this crossing is the
            // one before the ring's first pixel. In a hole that pixel is not solid, and the one to its left is. The crossing before
            // that solid run belongs to the same region, and to a ring that begins earlier.
            let outer = if crossings[first].low_is_solid {
                rings.spans[(next[first - 1] & !TRACED) as usize].outer
            } else {
                ring
            };
            rings.spans.push(Span { start, end: rings.crossings.len() as u32, outer })?;
        }
        Ok(())
    }
}

impl Rings {
    /// No rings.
    pub(super) fn new(budget: &MemoryBudget) -> Self {
        Self { crossings: Charged::new(budget), spans: Charged::new(budget) }
    }

    fn clear(&mut self) {
        self.crossings.clear();
        self.spans.clear();
    }
}
