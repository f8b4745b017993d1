//! A height map: values from 0 to 1 over texture coordinates. `patch` samples it; `tests/relief/` prints it.

use bincode::{Decode, Encode};

use super::range::{Cell, Ranges};

/// What lies beyond the unit square of texture coordinates (3MF displacement extension 0.8, §3.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub enum Tile {
    /// The map again.
    #[default]
    Wrap,
    /// The map again, every other time mirrored.
    Mirror,
    /// The value at the edge.
    Clamp,
    /// No displacement.
    Nothing,
}

impl Tile {
    /// The texel of a map of `count` texels that stands for texel `at`.
    #[inline]
    fn texel(self, at: i64, count: usize) -> usize {
        if (0..count as i64).contains(&at) { at as usize } else { self.texel_beyond(at, count) }
    }

    fn texel_beyond(self, at: i64, count: usize) -> usize {
        let count = count as i64;
        let inside = match self {
            Self::Wrap => at.rem_euclid(count),
            Self::Mirror => {
                let place = at.rem_euclid(2 * count);
                place.min(2 * count - 1 - place)
            }
            Self::Clamp | Self::Nothing => at.clamp(0, count - 1),
        };
        inside as usize
    }

    /// The texels that stand for those from `first` to `last`, as one or two ranges with both ends. They may be too wide.
    fn texels(self, first: i64, last: i64, count: usize) -> [[usize; 2]; 2] {
        let all = [0, count - 1];
        let length = last - first;
        if length + 1 >= count as i64 {
            return [all; 2];
        }
        let ends = [self.texel(first, count), self.texel(last, count)];
        match self {
            Self::Wrap if ends[0] > ends[1] => [[0, ends[1]], [ends[0], count - 1]],
            // It turns round at an edge of the map.
            Self::Mirror if ends[0].abs_diff(ends[1]) as i64 != length => {
                let is_low = ends[0] + ends[1] < count;
                let range = if is_low { [0, ends[0].max(ends[1])] } else { [ends[0].min(ends[1]), count - 1] };
                [range; 2]
            }
            _ => [[ends[0].min(ends[1]), ends[0].max(ends[1])]; 2],
        }
    }
}

/// Grey values, and how they are read between and beyond the texels.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightMap {
    /// Columns and rows.
    size: [usize; 2],
    /// Along u and v.
    tiles: [Tile; 2],
    /// Whether a point has the value of the nearest texel, instead of one interpolated between four.
    is_nearest: bool,
    /// Row by row, the highest v first: 0 to 65,535.
    texels: Vec<u16>,
    ranges: Ranges,
}

/// What a map holds in a box of texture coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MapRange {
    /// Least and greatest value.
    pub(super) values: [f64; 2],
    /// The greatest second difference of texels between which values are interpolated; then a line over `n` texels is at most `n²/8` or `n/4`
    /// times that from straight, whichever is greater.
    pub(super) bend: f64,
    /// The greatest step, where they are not.
    pub(super) step: f64,
    /// Whether there may be no displacement somewhere.
    pub(super) may_be_nothing: bool,
}

impl HeightMap {
    /// A map of `size[0]` columns and `size[1]` rows, the one with the highest v first; `tiles` are those along u and v.
    ///
    /// # Panics
    /// If there are no texels, or more or fewer than `size` says.
    pub fn new(size: [usize; 2], tiles: [Tile; 2], is_nearest: bool, texels: Vec<u16>) -> Self {
        assert!(!texels.is_empty() && texels.len() == size[0] * size[1], "{} texels for {size:?}", texels.len());
        let texel =
            |[column, row]: [i64; 2]| texels[tiles[1].texel(row, size[1]) * size[0] + tiles[0].texel(column, size[0])];
        let ranges = Ranges::new(size, texel);
        Self { size, tiles, is_nearest, texels, ranges }
    }

    /// Memory of a map of this size, bytes.
    pub(crate) fn bytes(size: [usize; 2]) -> u64 {
        ((size[0] * size[1] * size_of::<u16>()) + Ranges::bytes(size)) as u64
    }

    /// The value at a point, 0 to 1; `None` if there is no displacement.
    pub(super) fn sample(&self, texture: [f64; 2]) -> Option<f64> {
        if (0..2).any(|axis| self.tiles[axis] == Tile::Nothing && !(0.0..=1.0).contains(&texture[axis])) {
            return None;
        }
        let [x, y] = self.place(texture);
        if self.is_nearest {
            return Some(f64::from(self.texel([floor(x + 0.5), floor(y + 0.5)])) / 65_535.0);
        }
        let (left, top) = (floor(x), floor(y));
        let (right, below) = (x - left as f64, y - top as f64);
        let row = |row: i64| {
            let (a, b) = (f64::from(self.texel([left, row])), f64::from(self.texel([left + 1, row])));
            a + (b - a) * right
        };
        let (a, b) = (row(top), row(top + 1));
        Some((a + (b - a) * below) / 65_535.0)
    }

    /// A bound of the values in a box of texture coordinates, widened by `margin` texels.
    pub(super) fn range(&self, low: [f64; 2], high: [f64; 2], margin: i64) -> MapRange {
        let outside = |axis: usize| self.tiles[axis] == Tile::Nothing && (low[axis] < 0.0 || high[axis] > 1.0);
        // Rows run downwards.
        let (first, last) = (self.place([low[0], high[1]]), self.place([high[0], low[1]]));
        let first = [floor(first[0]) - margin, floor(first[1]) - margin];
        let last = [floor(last[0]) + 1 + margin, floor(last[1]) + 1 + margin];
        let is_inside = |axis: usize| first[axis] >= 0 && last[axis] < self.size[axis] as i64;
        let Cell { least, most, half_bend } = if is_inside(0) && is_inside(1) {
            let along = |axis: usize| [first[axis] as usize, last[axis] as usize];
            self.ranges.of(along(0), along(1))
        } else {
            self.cells(first, last)
        };
        let values = [least, most].map(|value| f64::from(value) / 65_535.0);
        MapRange {
            values,
            bend: if self.is_nearest { 0.0 } else { 2.0 * f64::from(half_bend) / 65_535.0 },
            step: if self.is_nearest { values[1] - values[0] } else { 0.0 },
            may_be_nothing: outside(0) || outside(1),
        }
    }

    /// What a box of texels holds that may lie beyond the map; both ends belong to it.
    fn cells(&self, first: [i64; 2], last: [i64; 2]) -> Cell {
        let [columns, rows] = [0, 1].map(|axis| self.tiles[axis].texels(first[axis], last[axis], self.size[axis]));
        let parts = distinct(&columns).flat_map(|columns| distinct(&rows).map(move |rows| (columns, rows)));
        let cells = parts.map(|(columns, rows)| self.ranges.of(columns, rows));
        cells.reduce(Cell::joined).unwrap_or(Cell::EMPTY)
    }

    /// Texels along a box of texture coordinates, both ways together.
    pub(super) fn texels_between(&self, low: [f64; 2], high: [f64; 2]) -> f64 {
        (0..2).map(|axis| (high[axis] - low[axis]).abs() * self.size[axis] as f64).sum()
    }

    /// Texture coordinates in columns and rows, counted from the middle of the first texel.
    fn place(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [u * self.size[0] as f64 - 0.5, (1.0 - v) * self.size[1] as f64 - 0.5]
    }

    fn texel(&self, [column, row]: [i64; 2]) -> u16 {
        let [column, row] = [self.tiles[0].texel(column, self.size[0]), self.tiles[1].texel(row, self.size[1])];
        self.texels[row * self.size[0] + column]
    }
}

/// The largest whole number that is not above a coordinate. `f64::floor` is a function call on processors without SSE 4.1.
fn floor(at: f64) -> i64 {
    let whole = at as i64;
    whole - i64::from(whole as f64 > at)
}

/// The ranges of a pair, without the second if it is the first again.
fn distinct(ranges: &[[usize; 2]; 2]) -> impl Iterator<Item = [usize; 2]> + Clone {
    ranges.iter().copied().take(if ranges[0] == ranges[1] { 1 } else { 2 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix;

    fn map(tiles: [Tile; 2], is_nearest: bool) -> HeightMap {
        let mut random = SplitMix::new(4);
        HeightMap::new([13, 9], tiles, is_nearest, (0..13 * 9).map(|_| random.next_u64() as u16).collect())
    }

    #[test]
    fn texels_lie_where_the_extension_says() {
        let tiles = [Tile::Wrap, Tile::Clamp];
        let map = HeightMap::new([2, 2], tiles, false, vec![0, 65_535, 13_107, 26_214]);
        // The middle of the texel at the lower right.
        assert_eq!(map.sample([0.75, 0.25]), Some(0.4));
        assert_eq!(map.sample([0.5, 0.25]), Some(0.3), "between two");
        assert_eq!(map.sample([0.0, 0.75]), Some(0.5), "the last column lies to the left of the first");
        assert_eq!(map.sample([0.25, -7.0]), Some(0.2), "the edge");
    }

    #[test]
    fn tiles_continue_the_map() {
        let at = |tile, u| map([tile, Tile::Wrap], false).sample([u, 0.3]);
        assert_eq!(at(Tile::Wrap, 0.25), at(Tile::Wrap, 3.25));
        assert_eq!(at(Tile::Mirror, 0.25), at(Tile::Mirror, -0.25));
        assert_eq!(at(Tile::Mirror, 0.25), at(Tile::Mirror, 1.75));
        assert_eq!(at(Tile::Clamp, 1.25), at(Tile::Clamp, 4.0));
        assert_eq!(at(Tile::Nothing, 1.25), None);
        assert!(at(Tile::Nothing, 0.25).is_some());
    }

    #[test]
    fn no_value_in_a_box_leaves_its_range() {
        let tiles = [Tile::Wrap, Tile::Mirror, Tile::Clamp, Tile::Nothing];
        let mut random = SplitMix::new(8);
        let mut tight = 0;
        for round in 0..4000 {
            let map = map([tiles[round % 4], tiles[round / 4 % 4]], round % 3 == 0);
            let mut number = |scale: f64| (random.next_u64() % 1_000_000) as f64 / 1e6 * scale;
            let low = [number(5.0) - 2.5, number(5.0) - 2.5];
            let high = [low[0] + number(0.6), low[1] + number(0.6)];
            let MapRange { values: [least, most], may_be_nothing, .. } = map.range(low, high, 0);
            tight += u32::from(least > 0.1 || most < 0.9);
            for _ in 0..20 {
                let share = [number(1.0), number(1.0)];
                let at = [0, 1].map(|axis| low[axis] + share[axis] * (high[axis] - low[axis]));
                match map.sample(at) {
                    Some(value) => assert!((least..=most).contains(&value), "{value} at {at:?} in {least} to {most}"),
                    None => assert!(may_be_nothing, "{at:?}"),
                }
            }
        }
        assert!(tight > 500, "{tight} ranges say anything");
    }
}
