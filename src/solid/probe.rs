//! Does a lattice have a solid point anywhere in a plane of unlimited extent? It may be clipped by a surface (`probe/cut.rs`).
//!
//! The plane is divided into bands of rows, and bands into tiles. A sweep along y finds the struts of each band, and a sweep along x
//! those of each tile; empty regions are skipped. Each tile has its own grid, so `f32` is precise enough however far tiles are apart.
//! `buildfile/store/bottom.rs` and `clipped.rs` find the lowest point of a part with it.

mod cut;

use super::{Block, Grid, InstructionSet, PixelShape, Plane, Strip, StrutRecord};
pub(crate) use cut::Cut;

/// Rows and columns of a tile: 256 KiB of fields, which fit a level-2 cache.
const TILE_ROWS: usize = 64;
const TILE_COLUMNS: usize = 1024;

/// Probes planes. Unit of length: that of the shape.
pub(crate) struct PlaneProbe<S: PixelShape> {
    quantum: f64,
    /// The most that a strut reaches from its axis.
    reach: f64,
    pitch: f64,
    strip: Strip<S::Cell>,
    /// Strips of the members and what makes one of them; none if there is one member.
    members: Vec<Strip<S::Cell>>,
    join: Join<S::Cell>,
    bits: [u8; TILE_COLUMNS / 8],
}

/// Makes cells of one strip of those of several members.
type Join<Cell> = Box<dyn Fn(&[&[Cell]], &mut [Cell])>;

/// A strut, and the member that it belongs to; 0 if nothing is joined.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProbeRecord {
    pub(crate) record: StrutRecord,
    pub(crate) member: u8,
}

/// The range of one axis that a strut may reach, and the index of its record.
#[derive(Clone, Copy, Debug)]
struct Span {
    low: f64,
    high: f64,
    at: usize,
}

impl<S: PixelShape> PlaneProbe<S> {
    /// A probe of points at distances of `pitch`, for struts that reach so far, and whose quantum has length `quantum`.
    pub(crate) fn new(quantum: f64, reach: f64, pitch: f64) -> Self {
        Self::joined(quantum, reach, pitch, 0, Box::new(|_, _| {}))
    }

    /// As [`PlaneProbe::new`], of struts of several members, each of which is drawn on its own before they are joined.
    pub(crate) fn joined(quantum: f64, reach: f64, pitch: f64, members: usize, join: Join<S::Cell>) -> Self {
        let strip = || Strip::new(TILE_COLUMNS, TILE_ROWS, 0);
        let members = (0..members).map(|_| strip()).collect();
        Self { quantum, reach, pitch, strip: strip(), members, join, bits: [0; TILE_COLUMNS / 8] }
    }

    /// Whether any point of the plane at height `z` is solid, and left by the cut of this plane. Allocates some 48 bytes for each record
    /// that may reach the plane.
    pub(crate) fn is_solid(&mut self, records: &[ProbeRecord], z: f64, mut cut: Option<&mut Cut>) -> bool {
        let height = TILE_ROWS as f64 * self.pitch;
        let seen =
            |at: usize| self.seen(&records[at].record, z, [f64::NEG_INFINITY, f64::INFINITY]).map(|[_, y]| (at, y));
        let mut waiting: Vec<Span> =
            (0..records.len()).filter_map(seen).map(|(at, [low, high])| Span { low, high, at }).collect();
        // The last one is the next to be taken.
        waiting.sort_unstable_by(|one, other| other.low.total_cmp(&one.low).then(other.at.cmp(&one.at)));
        let mut active: Vec<Span> = Vec::new();
        let mut low = f64::NEG_INFINITY;
        loop {
            active.retain(|span| span.high >= low);
            if active.is_empty() {
                let Some(next) = waiting.last() else { return false };
                low = low.max(next.low);
            }
            let band = [low, low + height];
            while let Some(next) = waiting.pop_if(|next| next.low < band[1]) {
                active.push(next);
            }
            if self.is_solid_in(records, &active, z, band, cut.as_deref_mut()) {
                return true;
            }
            low = band[1];
        }
    }

    /// [`PlaneProbe::is_solid`] within one band of rows.
    fn is_solid_in(
        &mut self,
        records: &[ProbeRecord],
        active: &[Span],
        z: f64,
        band: [f64; 2],
        mut cut: Option<&mut Cut>,
    ) -> bool {
        if let Some(cut) = &mut cut {
            cut.begin_band(band[0], self.pitch);
        }
        let seen = |span: &Span| {
            let [[low, high], _] = self.seen(&records[span.at].record, z, band)?;
            Some(Span { low, high, at: span.at })
        };
        let mut spans: Vec<Span> = active.iter().filter_map(seen).collect();
        // The order depends on the struts alone, so that sums are reproducible.
        spans.sort_unstable_by(|one, other| one.low.total_cmp(&other.low).then(one.at.cmp(&other.at)));
        let width = TILE_COLUMNS as f64 * self.pitch;
        let mut rest = spans.as_slice();
        let mut tile: Vec<Span> = Vec::new();
        let mut left = f64::NEG_INFINITY;
        loop {
            tile.retain(|span| span.high >= left);
            if tile.is_empty() {
                let Some(next) = rest.first() else { return false };
                left = left.max(next.low);
            }
            let end = rest.partition_point(|span| span.low < left + width);
            tile.extend_from_slice(&rest[..end]);
            rest = &rest[end..];
            let is_left = cut.as_deref_mut().is_none_or(|cut| cut.begin_tile(left));
            if is_left && self.is_solid_tile(records, &tile, [left, band[0], z], cut.as_deref()) {
                return true;
            }
            left += width;
        }
    }

    /// [`PlaneProbe::is_solid`] within the tile whose corner is given.
    fn is_solid_tile(
        &mut self,
        records: &[ProbeRecord],
        tile: &[Span],
        [x0, y0, z]: [f64; 3],
        cut: Option<&Cut>,
    ) -> bool {
        let instructions = InstructionSet::detect();
        let grid = Grid { x0, dx: self.pitch, y0, dy: self.pitch, width: TILE_COLUMNS, samples: 1 };
        let plane = Plane { grid, z, quantum: self.quantum };
        let draw = |spans: &mut dyn Iterator<Item = &Span>, strip: &mut Strip<S::Cell>| {
            strip.begin(0, TILE_ROWS);
            let mut block = Block::default();
            for span in spans {
                if !block.push(records[span.at].record) {
                    S::draw(instructions, std::iter::once(&block), &plane, strip);
                    block = Block::default();
                    block.push(records[span.at].record);
                }
            }
            S::draw(instructions, std::iter::once(&block), &plane, strip);
        };
        if self.members.is_empty() {
            draw(&mut tile.iter(), &mut self.strip);
        } else {
            for (member, strip) in self.members.iter_mut().enumerate() {
                draw(&mut tile.iter().filter(|span| usize::from(records[span.at].member) == member), strip);
            }
            let members: Vec<&Strip<S::Cell>> = self.members.iter().collect();
            self.strip.join(&members, &self.join);
        }
        for pixels in self.strip.used_pixels(TILE_COLUMNS) {
            let bytes = pixels.start / 8..pixels.end.div_ceil(8);
            for row in 0..TILE_ROWS {
                let bits = &mut self.bits[bytes.clone()];
                bits.fill(0);
                S::merge_bits(instructions, &self.strip, row, bytes.start, bits);
                if let Some(cut) = cut {
                    let left = &cut.row(row)[bytes.clone()];
                    bits.iter_mut().zip(left).for_each(|(bits, left)| *bits &= left);
                }
                if bits.iter().any(|byte| *byte != 0) {
                    return true;
                }
            }
        }
        false
    }

    /// The ranges of x and y that a strut may reach in a plane and within a band; `None` if it does not reach them.
    fn seen(&self, record: &StrutRecord, z: f64, [low, high]: [f64; 2]) -> Option<[[f64; 2]; 2]> {
        let [a, b] = [record.a, record.b].map(|node| node.map(|x| f64::from(x) * self.quantum));
        let reach = self.reach;
        let along_z = within(a[2], b[2], [z - reach, z + reach])?;
        let along_y = within(a[1], b[1], [low - reach, high + reach])?;
        let (from, to) = (along_z[0].max(along_y[0]), along_z[1].min(along_y[1]));
        if from > to {
            return None;
        }
        let range = |axis: usize| {
            let [one, two] = [from, to].map(|share| a[axis] + share * (b[axis] - a[axis]));
            [one.min(two) - reach, one.max(two) + reach]
        };
        Some([range(0), range(1)])
    }
}

/// The part of the segment from `a` to `b` within a range, as shares of its length; `None` if no part is.
fn within(a: f64, b: f64, [low, high]: [f64; 2]) -> Option<[f64; 2]> {
    if a.max(b) < low || a.min(b) > high {
        return None;
    }
    let share = |x: f64| if a == b { 0.0 } else { ((x - a) / (b - a)).clamp(0.0, 1.0) };
    let (one, two) = (share(low), share(high));
    Some(if a == b { [0.0, 1.0] } else { [one.min(two), one.max(two)] })
}
