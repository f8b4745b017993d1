//! What a surface leaves of a plane, tile by tile. `probe` looks for solid points in it.

use std::ops::Range;

use super::{TILE_COLUMNS, TILE_ROWS};
use crate::solid::{Crossings, Facet, Resolution, SectionPlane, Segment, set_bits};

/// Bytes of a row of a tile.
const ROW_BYTES: usize = TILE_COLUMNS / 8;

/// A surface that clips, in one plane.
#[derive(Debug)]
pub(crate) struct Cut {
    /// Whether points within the surface are left, or those outside.
    keeps_inside: bool,
    /// Where the plane cuts the surface, in the unit of the probe.
    segments: Vec<Segment>,
    /// Those that reach the current band, in tiles from x = 0 on, and the first row and the length of a row's pixel.
    near: Vec<Segment>,
    pitch: f64,
    crossings: Crossings,
    /// The points of the current tile that are left, a bit each.
    left: Vec<u8>,
}

impl Cut {
    /// A surface of which the points within are left, or those outside.
    pub(crate) fn new(keeps_inside: bool) -> Self {
        Self {
            keeps_inside,
            segments: Vec::new(),
            near: Vec::new(),
            pitch: 1.0,
            crossings: Crossings::new(TILE_COLUMNS, TILE_ROWS, Resolution::CENTRES),
            left: vec![0; TILE_ROWS * ROW_BYTES],
        }
    }

    /// Begins the plane at height `z`, which cuts the surface of these facets.
    pub(crate) fn begin<'a>(&mut self, facets: impl Iterator<Item = &'a Facet>, z: f64) {
        let plane = SectionPlane { z, origin: [0.0; 2], step: [1.0; 2] };
        self.segments.clear();
        self.segments.extend(facets.filter_map(|facet| plane.cut(facet)));
    }

    /// Whether nothing can be left in the plane.
    pub(crate) fn is_empty(&self) -> bool {
        self.keeps_inside && self.segments.is_empty()
    }

    /// Begins a band of rows: the first at `y0`, `pitch` apart.
    pub(super) fn begin_band(&mut self, y0: f64, pitch: f64) {
        let rows = |segment: &Segment| {
            let [from, to] = [segment.from, segment.to].map(|[x, y]| [x / pitch, (y - y0) / pitch]);
            Segment { from, to }
        };
        let reaches = |segment: &Segment| {
            let [one, other] = [segment.from[1], segment.to[1]];
            one.max(other) > -1.0 && one.min(other) < TILE_ROWS as f64
        };
        self.near.clear();
        self.near.extend(self.segments.iter().map(rows).filter(reaches));
        self.pitch = pitch;
    }

    /// Begins the tile of that band whose first column is at `x0`. Returns whether any of its points is left.
    pub(super) fn begin_tile(&mut self, x0: f64) -> bool {
        self.left.fill(0);
        let mut rows = 0..TILE_ROWS;
        while !rows.is_empty() {
            self.cross(x0 / self.pitch, rows.clone());
            if self.crossings.is_full() {
                rows.end = rows.start + rows.len() / 2;
                continue;
            }
            let left = &mut self.left[rows.start * ROW_BYTES..];
            self.crossings.spans(|row, span| set_bits(&mut left[row * ROW_BYTES..][..ROW_BYTES], span));
            rows = rows.end..TILE_ROWS;
        }
        if !self.keeps_inside {
            self.left.iter_mut().for_each(|bits| *bits = !*bits);
        }
        self.left.iter().any(|bits| *bits != 0)
    }

    /// Finds where some rows of the tile cross the segments, `first` columns from x = 0.
    fn cross(&mut self, first: f64, rows: Range<usize>) {
        self.crossings.begin(rows.start, rows.len());
        for Segment { from, to } in &self.near {
            let [from, to] = [from, to].map(|[x, y]| [x - first, *y]);
            self.crossings.add(&Segment { from, to }, false);
            if self.crossings.is_full() {
                return;
            }
        }
    }

    /// The points of a row of the tile that are left, a bit each.
    pub(super) fn row(&self, row: usize) -> &[u8] {
        &self.left[row * ROW_BYTES..][..ROW_BYTES]
    }
}
