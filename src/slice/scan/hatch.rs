//! Hatches: parallel lines cut off by areas. `layer_plan` and `pieces` use them.
//!
//! The lines of a layer pass through a fixed point of the field, not of a region. So hatches of neighbouring regions lie on the same
//! lines, and a layer does not depend on how its regions are found. Crossings with the border are computed in `f64`. Ends are rounded
//! inwards to whole micrometres along the line, so a hatch ends in the area, except that its points are rounded to whole micrometres.

use crate::layer::{HatchFrame, HatchLine, hatch_frame};

use super::counts::ScanCounts;
use super::offset::{Area, Point, to_um};
use super::settings::{HatchSettings, HatchStrategy};

/// The lines of a layer for one kind of filling.
pub(super) struct Hatcher {
    strategy: HatchStrategy,
    shortest_um: i32,
    /// The lines, and for a chessboard those at a right angle to them.
    frames: [HatchFrame; 2],
}

/// Neighbouring hatches, in the order of their lines: each overlaps the next and no other. Each runs from its low to its high end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// Which of [`Hatcher::frames`].
    pub(super) turned: bool,
    /// Number of hatches, at least 1.
    pub(super) count: u32,
}

/// Hatches, and the parts that they make, in the same order.
#[derive(Debug, Default)]
pub(super) struct Hatches {
    pub(super) lines: Vec<HatchLine>,
    pub(super) parts: Vec<Part>,
}

/// Where hatches lie: within all of some areas, and outside of all of others. At most eight together.
#[derive(Debug, Default)]
pub(super) struct Ground<'a> {
    pub(super) within: Vec<&'a Area>,
    pub(super) without: Vec<&'a Area>,
}

/// Shortest stretch of a line that counts, micrometres: areas have whole nanometres.
const LEAST_CHORD_UM: f64 = 0.01;

/// Where a line crosses the border of an area.
#[derive(Clone, Copy, Debug)]
struct Crossing {
    line: i32,
    at_um: f64,
    /// The area's.
    bit: u8,
}

/// Where a line runs through the ground.
#[derive(Clone, Copy, Debug)]
struct Chord {
    line: i32,
    from_um: f64,
    to_um: f64,
}

/// A hatch, and the stripe or square it lies in.
#[derive(Clone, Copy, Debug)]
struct Cut {
    cell: [i32; 2],
    hatch: HatchLine,
}

impl Hatcher {
    /// For a layer, counted from 0.
    pub(super) fn new(settings: &HatchSettings, layer: u32, shortest_um: f64) -> Self {
        let angle_deg = (settings.angle_deg + f64::from(layer) * settings.rotation_deg).rem_euclid(360.0);
        let spacing_nm = (settings.spacing_um * 1000.0).round() as u32;
        let frame = hatch_frame([0, 0], angle_deg, spacing_nm);
        // Exactly a right angle: x along the turned lines is the distance across the others.
        let turned = HatchFrame { along: [-frame.along[1], frame.along[0]], ..frame };
        let shortest_um = (shortest_um.ceil() as i32).max(1);
        Self { strategy: settings.strategy, shortest_um, frames: [frame, turned] }
    }

    /// The lines, and those at a right angle to them.
    pub(super) fn frames(&self) -> [HatchFrame; 2] {
        self.frames
    }

    /// Whether a part may be marked beginning with its last hatch and its high end, in any combination. Otherwise all hatches run from
    /// low to high.
    pub(super) fn goes_both_ways(&self) -> bool {
        self.strategy != HatchStrategy::Unidirectional
    }

    /// Distance from one line to the next, micrometres.
    pub(super) fn spacing_um(&self) -> f64 {
        f64::from(self.frames[0].spacing_nm) / 1000.0
    }

    /// Its stripes or squares, if it has any.
    pub(super) fn cells(&self) -> Option<Cells> {
        Cells::of(self.strategy)
    }

    /// Fills the ground, part by part.
    pub(super) fn fill(&self, ground: &Ground<'_>, counts: &mut ScanCounts) -> Hatches {
        let mut hatches = Hatches::default();
        let mut cuts = Vec::new();
        let cells = self.cells();
        if let (HatchStrategy::Chessboard { .. }, Some(cells)) = (self.strategy, cells) {
            for (frame, turned) in self.frames.iter().zip([false, true]) {
                cuts.clear();
                self.cut_squares(&chords(ground, frame), cells, turned, &mut cuts, counts);
                join_parts(&mut cuts, turned, &mut hatches);
            }
            return hatches;
        }
        for chord in chords(ground, &self.frames[0]) {
            self.cut(chord, cells, |_| true, &mut cuts, counts);
        }
        join_parts(&mut cuts, false, &mut hatches);
        hatches
    }

    /// Cuts chords at the borders of the squares of one colour: odd ones for turned lines.
    fn cut_squares(&self, chords: &[Chord], cells: Cells, odd: bool, cuts: &mut Vec<Cut>, counts: &mut ScanCounts) {
        let spacing_um = self.spacing_um();
        // Left of a turned line is back along the others.
        let across_um = |line: i32| f64::from(line) * if odd { -spacing_um } else { spacing_um };
        for chord in chords {
            for row in cells.touching(across_um(chord.line), across_um(chord.line)) {
                let begin = cuts.len();
                self.cut(*chord, Some(cells), |cell| ((cell ^ row) & 1 != 0) == odd, cuts, counts);
                cuts[begin..].iter_mut().for_each(|cut| cut.cell[1] = row);
            }
        }
    }

    /// Cuts a chord into the wanted cells, or leaves it whole, and rounds the ends inwards. A remainder that is too short becomes part of
    /// the cell before or behind it, if that is wanted too, and is left out otherwise.
    fn cut(
        &self,
        chord: Chord,
        cells: Option<Cells>,
        wanted: impl Fn(i32) -> bool,
        cuts: &mut Vec<Cut>,
        counts: &mut ScanCounts,
    ) {
        let (begin_um, end_um) = (chord.from_um.ceil() as i32, chord.to_um.floor() as i32);
        let touched = cells.map_or(0..=0, |cells| cells.touching(chord.from_um, chord.to_um));
        if end_um - begin_um < self.shortest_um {
            counts.dropped_hatches += u64::from(touched.into_iter().any(wanted));
            return;
        }
        let bounds = |cell| cells.map_or((begin_um, end_um), |cells| cells.bounds(cell));
        let first_cut = cuts.len();
        // A remainder at the beginning, which waits for the next cell.
        let mut lead: Option<HatchLine> = None;
        for cell in touched.filter(|&cell| wanted(cell)) {
            let (low_um, high_um) = bounds(cell);
            let hatch = HatchLine { line: chord.line, from_um: low_um.max(begin_um), to_um: high_um.min(end_um) };
            let before =
                cuts[first_cut..].last_mut().map(|cut| &mut cut.hatch).filter(|cut| cut.to_um >= hatch.from_um);
            let in_before = before.as_ref().is_some_and(|before| before.to_um >= hatch.to_um);
            let in_next = cells.is_some() && wanted(cell + 1) && bounds(cell + 1).0 <= hatch.from_um;
            if in_before || in_next || hatch.to_um <= hatch.from_um {
                continue;
            }
            if hatch.to_um - hatch.from_um >= self.shortest_um {
                let joined = lead.take().map(|lead| (lead.from_um, lead.to_um >= hatch.from_um));
                counts.merged_hatches += u64::from(joined.is_some_and(|(_, touches)| touches));
                counts.dropped_hatches += u64::from(joined.is_some_and(|(_, touches)| !touches));
                let from_um = joined.filter(|(_, touches)| *touches).map_or(hatch.from_um, |(from_um, _)| from_um);
                cuts.push(Cut { cell: [cell, 0], hatch: HatchLine { from_um, ..hatch } });
            } else if let Some(before) = before {
                before.to_um = hatch.to_um;
                counts.merged_hatches += 1;
            } else {
                counts.dropped_hatches += u64::from(lead.replace(hatch).is_some());
            }
        }
        counts.dropped_hatches += u64::from(lead.is_some());
    }
}

/// Stripes, or the rows of squares: cell `n` begins at `n` times the pitch.
#[derive(Clone, Copy)]
pub(super) struct Cells {
    /// Distance from one to the next.
    pub(super) pitch_um: f64,
    /// Whether they are squares.
    pub(super) is_square: bool,
    size_um: f64,
}

impl Cells {
    /// Those of a strategy, if it has any.
    pub(super) fn of(strategy: HatchStrategy) -> Option<Self> {
        let (size_um, overlap_um, is_square) = match strategy {
            HatchStrategy::Zigzag | HatchStrategy::Unidirectional => return None,
            HatchStrategy::Stripes { width_um, overlap_um } => (width_um, overlap_um, false),
            HatchStrategy::Chessboard { island_um, overlap_um } => (island_um, overlap_um, true),
        };
        Some(Self { pitch_um: size_um - overlap_um, is_square, size_um })
    }

    fn bounds(&self, cell: i32) -> (i32, i32) {
        let low_um = f64::from(cell) * self.pitch_um;
        (low_um.round() as i32, (low_um + self.size_um).round() as i32)
    }

    /// Cells that have part of an interval.
    fn touching(&self, from_um: f64, to_um: f64) -> std::ops::RangeInclusive<i32> {
        let first = ((from_um - self.size_um) / self.pitch_um).ceil() as i32;
        first..=(to_um / self.pitch_um).floor() as i32
    }
}

/// Where the lines of a frame run through the ground, by line and position: even-odd over the rings of each area.
fn chords(ground: &Ground<'_>, frame: &HatchFrame) -> Vec<Chord> {
    let mut crossings: Vec<Crossing> = Vec::new();
    // A bit for each area: set while the line is inside.
    let mut bit = 1;
    let mut wanted: u8 = 0;
    for (areas, is_wanted) in [(&ground.within, true), (&ground.without, false)] {
        for area in areas {
            area.rings().for_each(|ring| cross_ring(ring, bit, frame, &mut crossings));
            wanted |= if is_wanted { bit } else { 0 };
            bit <<= 1;
        }
    }
    crossings.sort_unstable_by(|a, b| a.line.cmp(&b.line).then(a.at_um.total_cmp(&b.at_um)).then(a.bit.cmp(&b.bit)));
    let mut chords = Vec::new();
    for on_line in crossings.chunk_by(|a, b| a.line == b.line) {
        let mut inside = 0;
        for pair in on_line.windows(2) {
            inside ^= pair[0].bit;
            // Shorter ones are rounding, where borders lie on each other.
            if inside == wanted && pair[1].at_um - pair[0].at_um > LEAST_CHORD_UM {
                chords.push(Chord { line: pair[0].line, from_um: pair[0].at_um, to_um: pair[1].at_um });
            }
        }
    }
    chords
}

/// Adds where the lines of a frame cross a ring.
fn cross_ring(ring: &[Point], bit: u8, frame: &HatchFrame, crossings: &mut Vec<Crossing>) {
    let unit = f64::from(1 << 30);
    let [ux, uy] = frame.along.map(|share| f64::from(share) / unit);
    let spacing_um = f64::from(frame.spacing_nm) / 1000.0;
    let turned = |point: &Point| {
        let [x, y] = to_um(*point);
        [x * ux + y * uy, (y * ux - x * uy) / spacing_um]
    };
    let Some(last) = ring.last() else { return };
    let mut before = turned(last);
    for point in ring {
        let here = turned(point);
        let (low, high) = if before[1] <= here[1] { (before, here) } else { (here, before) };
        // Each line belongs to the upper of two edges that meet on it, so that it is counted once.
        let (first, end) = (low[1].ceil() as i32, high[1].ceil() as i32);
        if first < end {
            let slope = (high[0] - low[0]) / (high[1] - low[1]);
            let at_um = |line: i32| low[0] + (f64::from(line) - low[1]) * slope;
            crossings.extend((first..end).map(|line| Crossing { line, at_um: at_um(line), bit }));
        }
        before = here;
    }
}

/// Joins hatches to parts: a hatch continues the part of the one on the line before if the two overlap each other and nothing else.
fn join_parts(cuts: &mut [Cut], turned: bool, Hatches { lines, parts }: &mut Hatches) {
    cuts.sort_unstable_by_key(|cut| (cut.cell, cut.hatch.line, cut.hatch.from_um));
    // Coordinates have 32 bits, so numbers of hatches do.
    let mut part_of = vec![0_u32; cuts.len()];
    let mut part_count = 0;
    // The line before, and whose parts may still grow.
    let mut before = 0..0;
    let mut at = 0;
    while at < cuts.len() {
        let Cut { cell, hatch } = cuts[at];
        let end = at + cuts[at..].iter().take_while(|cut| cut.cell == cell && cut.hatch.line == hatch.line).count();
        let follows = |cut: &Cut| cut.cell == cell && cut.hatch.line + 1 == hatch.line;
        if !before.clone().next().is_some_and(|first| follows(&cuts[first])) {
            before = at..at;
        }
        let only = |cut: usize, others: std::ops::Range<usize>| {
            let own = cuts[cut].hatch;
            // Sorted and apart from each other, so those that overlap lie side by side.
            let first = others.start + cuts[others.clone()].partition_point(|other| other.hatch.to_um <= own.from_um);
            let overlaps = |other: usize| other < others.end && cuts[other].hatch.from_um < own.to_um;
            (overlaps(first) && !overlaps(first + 1)).then_some(first)
        };
        for number in at..end {
            let known = only(number, before.clone()).filter(|&other| only(other, at..end) == Some(number));
            part_of[number] = known.map_or(part_count, |other| part_of[other]);
            part_count += u32::from(known.is_none());
        }
        (before, at) = (at..end, end);
    }
    // By part; within a part the order of lines stays.
    let mut order: Vec<u32> = (0..cuts.len() as u32).collect();
    order.sort_unstable_by_key(|&number| (part_of[number as usize], number));
    let first_part = parts.len();
    parts.reserve_exact(part_count as usize);
    parts.resize(first_part + part_count as usize, Part { turned, count: 0 });
    lines.reserve_exact(cuts.len());
    for number in order {
        parts[first_part + part_of[number as usize] as usize].count += 1;
        lines.push(cuts[number as usize].hatch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slice::scan::Region;

    fn square(low: [f64; 2], side_um: f64) -> Area {
        let [x, y] = low;
        let outer = vec![[x, y], [x + side_um, y], [x + side_um, y + side_um], [x, y + side_um]];
        Area::of(&Region { outer, holes: Vec::new() })
    }

    #[test]
    fn chords_lie_within_all_and_without_all() {
        let (a, b) = (square([100.0, 100.0], 1000.0), square([600.0, 600.0], 1000.0));
        // Shares a border with `a`, and one with `b`.
        let (c, d) = (square([900.0, 900.0], 200.0), square([600.0, 600.0], 100.0));
        for angle_deg in [0.0, 33.0, 90.0, 147.0] {
            let frame = hatch_frame([0, 0], angle_deg, 1000);
            let length_um = |within: &[&Area], without: &[&Area]| {
                let ground = Ground { within: within.to_vec(), without: without.to_vec() };
                chords(&ground, &frame).iter().map(|chord| chord.to_um - chord.from_um).sum::<f64>()
            };
            // Lines 1 µm apart: as many micrometres as the area has square micrometres.
            let close = |found: f64, expected: f64| {
                assert!((found / expected - 1.0).abs() < 0.01, "{angle_deg}: {found} {expected}");
            };
            close(length_um(&[&a], &[]), 1e6);
            close(length_um(&[&a, &b], &[]), 500.0 * 500.0);
            close(length_um(&[&a, &b], &[&c, &d]), 500.0 * 500.0 - 200.0 * 200.0 - 100.0 * 100.0);
            let combined = a.intersect(&b).subtract(&c).subtract(&d);
            close(length_um(&[&a, &b], &[&c, &d]), length_um(&[&combined], &[]));
            assert_eq!(length_um(&[&a], &[&a]), 0.0);
        }
    }
}
