//! The field of a layer, band by band, and the crossings within each band. `contours` calls it for several bands at once, and `join` puts
//! the bands together.

use std::time::{Duration, Instant};

use super::contour::{Chains, VertexRow, find_solid, words};
use crate::slice::band::FieldBand;
use crate::slice::body::FieldBrush;
use crate::stream::{BudgetExceeded, MemoryBudget};

/// What one thread draws and marches with.
pub(super) struct Field {
    values: Vec<f32>,
    /// Which vertices are solid, of two successive rows.
    solid: [Vec<u64>; 2],
    width_px: usize,
    /// Time spent with drawing and with marching since it was made.
    pub(super) times: [Duration; 2],
}

impl Field {
    /// For bands of `rows` rows.
    pub(super) fn new(width_px: usize, rows: usize) -> Self {
        let solid = || vec![0; words(width_px)];
        Self { values: vec![0.0; width_px * rows], solid: [solid(), solid()], width_px, times: [Duration::ZERO; 2] }
    }

    /// Its memory, bytes.
    pub(super) fn bytes(width_px: usize, rows: usize) -> u64 {
        (width_px * rows * size_of::<f32>() + 2 * words(width_px) * size_of::<u64>()) as u64
    }

    /// Draws `rows` rows from `first` on, and finds the crossings between them.
    pub(super) fn cover(
        &mut self,
        brushes: &mut [Box<dyn FieldBrush + '_>],
        [first, rows]: [usize; 2],
        reversed: bool,
        piece: &mut Piece,
    ) {
        let began = Instant::now();
        let values = &mut self.values[..rows * self.width_px];
        let mut band = FieldBand::empty(first, values, self.width_px);
        for brush in brushes {
            brush.raise(&mut band);
        }
        let drawn = Instant::now();
        piece.outcome = self.march([first, rows], reversed, piece);
        self.times[0] += drawn - began;
        self.times[1] += drawn.elapsed();
    }

    fn march(&mut self, [first, rows]: [usize; 2], reversed: bool, piece: &mut Piece) -> Result<(), BudgetExceeded> {
        piece.chains.clear();
        let mut before = None;
        let [one, other] = &mut self.solid;
        let (mut solid, mut solid_before) = (one, other);
        for (row, field) in self.values.chunks_exact(self.width_px).take(rows).enumerate() {
            find_solid(field, solid);
            // Rows are at most `Raster::MAX_PX`.
            let y = (first + row + 1) as u16;
            let number = piece.chains.push_row(y, field, solid)?;
            let here = VertexRow { y, field: Some(field), solid: &*solid, first: number };
            if let Some((y, field, first)) = before {
                let south = VertexRow { y, field: Some(field), solid: &*solid_before, first };
                piece.chains.march(&south, &here, reversed)?;
            } else {
                piece.first.copy(&here);
            }
            if row + 1 == rows {
                piece.last.copy(&here);
            }
            before = Some((y, field, number));
            std::mem::swap(&mut solid, &mut solid_before);
        }
        Ok(())
    }
}

/// The crossings of a band, and its first and last row.
pub(super) struct Piece {
    pub(super) chains: Chains,
    pub(super) first: KeptRow,
    pub(super) last: KeptRow,
    /// Whether the budget had room.
    pub(super) outcome: Result<(), BudgetExceeded>,
}

impl Piece {
    /// An empty piece.
    pub(super) fn new(width_px: usize, budget: &MemoryBudget) -> Self {
        let row = || KeptRow::frame(width_px);
        Self { chains: Chains::new(budget), first: row(), last: row(), outcome: Ok(()) }
    }

    /// Memory of its rows, bytes.
    pub(super) fn bytes(width_px: usize) -> u64 {
        2 * KeptRow::bytes(width_px)
    }
}

/// A copy of a row of vertices.
pub(super) struct KeptRow {
    y: u16,
    is_frame: bool,
    field: Vec<f32>,
    solid: Vec<u64>,
    /// Number of the first crossing along the row.
    pub(super) first: u32,
}

impl KeptRow {
    /// A row of the frame, the one before the first row of pixels.
    pub(super) fn frame(width_px: usize) -> Self {
        Self { y: 0, is_frame: true, field: vec![0.0; width_px], solid: vec![0; words(width_px)], first: 0 }
    }

    /// Its memory, bytes.
    pub(super) fn bytes(width_px: usize) -> u64 {
        (width_px * size_of::<f32>() + words(width_px) * size_of::<u64>()) as u64
    }

    /// Makes it the frame's row before row `row` of pixels.
    pub(super) fn make_frame(&mut self, row: usize) {
        (self.y, self.is_frame, self.first) = (row as u16, true, 0);
        self.solid.fill(0);
    }

    fn copy(&mut self, row: &VertexRow<'_>) {
        if let Some(field) = row.field {
            self.field.copy_from_slice(field);
        }
        self.solid.copy_from_slice(row.solid);
        (self.y, self.is_frame, self.first) = (row.y, row.field.is_none(), row.first);
    }

    /// The row.
    pub(super) fn row(&self) -> VertexRow<'_> {
        let field = (!self.is_frame).then_some(&self.field[..]);
        VertexRow { y: self.y, field, solid: &self.solid, first: self.first }
    }
}
