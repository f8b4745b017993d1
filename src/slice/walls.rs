//! Finds walls thinner than a pixel in a layer of grey pixels, which say how much of each is solid. `inspection` hands it layers;
//! `tests/surface/inspected.rs` tests it.
//!
//! A wall is thin where what is solid of a row of pixels between two dark ones, or of a column, is less than one pixel, and where that goes on
//! from row to row, or from column to column. So tips and upright edges, which are thin in one or two rows alone, are no walls.

use std::ops::Range;

/// What is solid of less than a pixel, in 255ths of it. Along a column there are 8 samples a pixel, so that a wall of 7/8 of a pixel, and
/// no thicker one, is surely found; rounding makes one of a whole pixel seem thinner by two samples of 256 at most.
const THIN: u32 = 255 * 15 / 16;

/// Rows or columns through which a wall goes on at least. An edge sharper than 7° is as thin over this length, and is a wall, too.
const LEAST_LENGTH_PX: u32 = 8;

/// A thin place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Thin {
    /// Column and row.
    pub(super) at: [u32; 2],
    /// Thickness, pixels.
    pub(super) thickness_px: f64,
}

/// Takes the rows of a layer, one after the other.
#[derive(Debug, Default)]
pub(super) struct Walls {
    /// What is solid of the columns, down to the row before.
    columns: Vec<Column>,
    /// Through how many rows the thin stretch of the row before goes on that holds a pixel; 0 where there is none.
    before: Vec<u32>,
    /// The same of the current row. It is 0 beyond it.
    now: Vec<u32>,
    /// Columns of the row before, from the first to the last that is not dark.
    lit: Range<usize>,
    row: u32,
    found: Option<Thin>,
}

/// What is solid of a column between two dark pixels.
#[derive(Clone, Debug, Default)]
struct Column {
    /// Where it begins, and how much of it is solid, in 255ths of a pixel, up to [`THIN`]; nothing if the last pixel was dark.
    begin: u32,
    solid: u32,
    /// The rows of the last one that was thin, and through how many columns that goes on.
    thin: Range<u32>,
    length: u32,
}

impl Walls {
    /// Of layers of this width.
    pub(super) fn new(width_px: u32) -> Self {
        let width = width_px as usize;
        Self {
            columns: vec![Column::default(); width],
            before: vec![0; width],
            now: vec![0; width],
            lit: 0..0,
            row: 0,
            found: None,
        }
    }

    /// The first thin wall in a layer, row by row.
    pub(super) fn find<'a>(&mut self, rows: impl Iterator<Item = &'a [u8]>) -> Option<Thin> {
        self.columns.fill(Column::default());
        self.before.fill(0);
        self.now.fill(0);
        (self.lit, self.row, self.found) = (0..0, 0, None);
        for row in rows {
            self.add(row);
            if self.found.is_some() {
                break;
            }
        }
        self.end_columns();
        self.found
    }

    fn add(&mut self, row: &[u8]) {
        let lit = lit(row);
        // Beside it, nothing was solid, and nothing is.
        let both = match (lit.is_empty(), self.lit.is_empty()) {
            (true, _) => self.lit.clone(),
            (_, true) => lit.clone(),
            _ => lit.start.min(self.lit.start)..lit.end.max(self.lit.end),
        };
        let mut column = both.start;
        while column < both.end {
            if row[column] == 0 {
                self.end_column(column);
                column += 1;
                continue;
            }
            let begin = column;
            let mut solid = 0;
            while column < row.len() && row[column] != 0 {
                solid = (solid + u32::from(row[column])).min(THIN);
                self.go_on(column, row[column]);
                column += 1;
            }
            self.end_of_stretch(begin..column, solid);
        }
        std::mem::swap(&mut self.before, &mut self.now);
        self.now[self.lit.clone()].fill(0);
        self.lit = lit;
        self.row += 1;
    }

    /// A pixel of a column that is not dark.
    fn go_on(&mut self, column: usize, grey: u8) {
        let column = &mut self.columns[column];
        if column.solid == 0 {
            column.begin = self.row;
        }
        column.solid = (column.solid + u32::from(grey)).min(THIN);
    }

    /// The end of what is solid of a row.
    fn end_of_stretch(&mut self, columns: Range<usize>, solid: u32) {
        if solid >= THIN {
            return;
        }
        let beside = columns.start.saturating_sub(1)..(columns.end + 1).min(self.before.len());
        let length = 1 + self.before[beside].iter().copied().max().unwrap_or(0);
        self.now[columns.clone()].fill(length);
        self.note(length, [columns.start as u32, self.row], solid);
    }

    /// A dark pixel of a column: what was solid above it ends.
    fn end_column(&mut self, column: usize) {
        let Column { begin, solid, .. } = self.columns[column];
        if solid == 0 {
            return;
        }
        self.columns[column].solid = 0;
        if solid >= THIN {
            return;
        }
        let rows = begin..self.row;
        let goes_on = |other: &&Column| {
            let thin = &other.thin;
            !thin.is_empty() && thin.start <= rows.end && rows.start <= thin.end
        };
        let beside = [column.wrapping_sub(1), column + 1];
        let beside = beside.into_iter().filter_map(|other| self.columns.get(other)).filter(goes_on);
        let length = 1 + beside.map(|other| other.length).max().unwrap_or(0);
        let ended = &mut self.columns[column];
        (ended.thin, ended.length) = (rows, length);
        self.note(length, [column as u32, begin], solid);
    }

    /// The lower end of the picture.
    fn end_columns(&mut self) {
        (0..self.columns.len()).for_each(|column| self.end_column(column));
    }

    fn note(&mut self, length: u32, at: [u32; 2], solid: u32) {
        if length >= LEAST_LENGTH_PX && self.found.is_none() {
            self.found = Some(Thin { at, thickness_px: f64::from(solid) / 255.0 });
        }
    }
}

/// The columns of a row from the first to the last that is not dark.
fn lit(row: &[u8]) -> Range<usize> {
    /// Pixels that are looked at together.
    const BLOCK: usize = 64;
    let is_lit = |block: &[u8]| block.iter().fold(0, |all, grey| all | grey) != 0;
    let Some(first) = row.chunks(BLOCK).position(is_lit) else { return 0..0 };
    let first = first * BLOCK + row[first * BLOCK..].iter().position(|grey| *grey != 0).unwrap_or(0);
    // Blocks from the end on.
    let dark = row.rchunks(BLOCK).take_while(|block| !is_lit(block)).map(<[u8]>::len).sum::<usize>();
    let last = row[..row.len() - dark].iter().rposition(|grey| *grey != 0).unwrap_or(0);
    first..last + 1
}
