//! What boxes of texels hold, from a pyramid: each of its cells knows that of four cells below. `map` asks it.

/// Texels along each side of the smallest cells.
const CELL: usize = 4;

/// What a box holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cell {
    pub(super) least: u16,
    pub(super) most: u16,
    /// Half the greatest second difference along columns, along rows, or along both, rounded up: how far the map is from a plane.
    pub(super) half_bend: u16,
}

impl Cell {
    /// Of no texels.
    pub(super) const EMPTY: Self = Self { least: u16::MAX, most: 0, half_bend: 0 };

    pub(super) fn joined(self, other: Self) -> Self {
        Self {
            least: self.least.min(other.least),
            most: self.most.max(other.most),
            half_bend: self.half_bend.max(other.half_bend),
        }
    }
}

/// The pyramid.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ranges {
    levels: Vec<Level>,
}

/// Cells of one size.
#[derive(Clone, Debug, PartialEq)]
struct Level {
    /// Cells in a row.
    width: usize,
    /// Row by row.
    cells: Vec<Cell>,
}

impl Ranges {
    /// Of a map of `size[0]` columns and `size[1]` rows. `texel` takes column and row, which may be one beyond the map.
    pub(super) fn new(size: [usize; 2], texel: impl Fn([i64; 2]) -> u16) -> Self {
        let mut levels: Vec<Level> = Vec::new();
        for [width, height] in sizes(size) {
            let level = match levels.last() {
                None => Level::of(width, height, CELL, size, |place| cell(place, &texel)),
                Some(below) => {
                    let below_size = [below.width, below.cells.len() / below.width];
                    Level::of(width, height, 2, below_size, |[column, row]| below.cells[row * below.width + column])
                }
            };
            levels.push(level);
        }
        Self { levels }
    }

    /// Memory of the pyramid of such a map, bytes.
    pub(super) fn bytes(size: [usize; 2]) -> usize {
        sizes(size).map(|[width, height]| width * height * size_of::<Cell>()).sum()
    }

    /// A bound of what a box holds, whose ranges have both ends.
    pub(super) fn of(&self, columns: [usize; 2], rows: [usize; 2]) -> Cell {
        let longest = (columns[1] - columns[0]).max(rows[1] - rows[0]);
        // So high that the box lies in two or three cells along each axis.
        let number = (longest / CELL).max(1).ilog2() as usize;
        let number = number.min(self.levels.len() - 1);
        let (level, cell) = (&self.levels[number], CELL << number);
        let (first, last) = (columns[0] / cell, columns[1] / cell);
        let row = |row: usize| &level.cells[row * level.width..][first..=last];
        (rows[0] / cell..=rows[1] / cell).flat_map(row).fold(Cell::EMPTY, |sum, cell| sum.joined(*cell))
    }
}

/// A single texel and its bend.
fn cell([column, row]: [usize; 2], texel: &impl Fn([i64; 2]) -> u16) -> Cell {
    let at = |right: i64, down: i64| i32::from(texel([column as i64 + right, row as i64 + down]));
    let here = at(0, 0);
    let twice = [at(-1, 0) - 2 * here + at(1, 0), at(0, -1) - 2 * here + at(0, 1)];
    let both = [-1, 1].map(|right| [-1, 1].map(|down| here - at(right, 0) - at(0, down) + at(right, down)));
    let bend = twice.iter().chain(both.as_flattened()).map(|bend| bend.unsigned_abs()).max().unwrap_or(0);
    Cell { least: here as u16, most: here as u16, half_bend: bend.div_ceil(2) as u16 }
}

impl Level {
    /// `width` × `height` cells of `side` × `side` of those below, of which there are `below`.
    fn of(width: usize, height: usize, side: usize, below: [usize; 2], value: impl Fn([usize; 2]) -> Cell) -> Self {
        let cell = |row: usize, column: usize| {
            let columns = column * side..((column + 1) * side).min(below[0]);
            let rows = row * side..((row + 1) * side).min(below[1]);
            let all = rows.flat_map(|row| columns.clone().map(move |column| [column, row]));
            all.fold(Cell::EMPTY, |sum, place| sum.joined(value(place)))
        };
        // Of this size from the beginning, because it is charged.
        let mut cells = Vec::with_capacity(width * height);
        for row in 0..height {
            cells.extend((0..width).map(|column| cell(row, column)));
        }
        Self { width, cells }
    }
}

/// Columns and rows of cells of each level, down to a single cell.
fn sizes(size: [usize; 2]) -> impl Iterator<Item = [usize; 2]> {
    let first = size.map(|count| count.div_ceil(CELL));
    std::iter::successors(Some(first), |size| (size != &[1, 1]).then(|| size.map(|count| count.div_ceil(2))))
}
