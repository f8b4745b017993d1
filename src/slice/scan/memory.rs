//! How much memory filling a region takes at most. `fill` charges it. `tests/scan_memory.rs` compares it with what is really taken.
//!
//! Most of it is taken while the border is moved to the side, areas are combined or divided into triangles, or hatches are cut off. The work
//! space of a small region is charged before it is filled, as a bound that follows from its border alone. That bound is wide where a border
//! is long and straight: what is narrow, and where hatches end, is not known yet. So a large region is filled by itself, and triangles and
//! hatches are charged once their areas are known.

use crate::stream::{BudgetExceeded, Charge, MemoryBudget};

use super::convex::least_cosine;
use super::hatch::{Cells, Ground, Hatcher};
use super::layer_plan::{CORNER_REACH, SEAM_UM};
use super::middle::triangle_edge_um;
use super::offset::{ARC_ERROR_UM, Area, to_um};
use super::path::{distance_um, ring_edges};
use super::pieces;
use super::region::Region;
use super::settings::ScanSettings;
use super::thin::{REACH, ThinRules};

/// Moving a border: the edges, what is left of them and of arcs, and how these follow each other, bytes for each edge.
const TRIM_BYTES: f64 = 320.0;

/// Combining two areas in the library, bytes for each edge.
const OVERLAY_BYTES: f64 = 150.0;

/// Triangles of a narrow area and the lines through them, bytes for each edge of the divided border.
const TRIANGLE_BYTES: f64 = 300.0;

/// Where lines cross the border of an area, bytes for each crossing; lists grow by doubling.
const CROSSING_BYTES: f64 = 72.0;

/// Hatches while they are cut and joined to parts, bytes for each.
const CUT_BYTES: f64 = 96.0;

/// Share of a chessboard's hatches that are cut at once: those of one colour, and some, because squares overlap and end at the border.
const ONE_COLOUR: f64 = 0.6;

/// Areas of a region that are there at the same time, of 8 bytes for each point.
const AREA_BYTES: f64 = 7.0 * 8.0;

/// For each ring, and for each region: lists that hold little.
const RING_BYTES: f64 = 300.0;
const REGION_BYTES: f64 = 4000.0;

/// What filling a region takes at most.
#[derive(Clone, Copy, Debug)]
pub(super) struct RegionMemory {
    /// Moving the border and combining areas, bytes.
    pub(super) areas_bytes: u64,
    /// Triangles and hatches, bytes.
    pub(super) filling_bytes: u64,
    /// Contours, in lists that grow by doubling, bytes.
    pub(super) contours_bytes: u64,
    /// Centre lines and hatches, in lists that grow by doubling, bytes.
    pub(super) lines_bytes: u64,
}

/// How the work space of a region is charged.
#[derive(Clone, Copy)]
pub(super) enum Room<'a> {
    /// All of it was charged before the region is filled.
    Charged,
    /// Each part is charged to this budget when its size is known.
    Of(&'a MemoryBudget),
}

impl Room<'_> {
    /// Takes as many bytes as `bytes` returns, until the charge is dropped. `bytes` is called only if they are charged.
    pub(super) fn take(self, bytes: impl FnOnce() -> u64) -> Result<Option<Charge>, BudgetExceeded> {
        match self {
            Self::Charged => Ok(None),
            Self::Of(budget) => budget.charge("filling a region with vectors", bytes()).map(Some),
        }
    }
}

/// What the lines along the middle of an area take, while they are found, bytes.
pub(super) fn middle_bytes(area: &Area, rules: &ThinRules) -> u64 {
    let (points, length_um) = extent(area);
    (TRIANGLE_BYTES * (points + length_um / triangle_edge_um(rules)) + REGION_BYTES) as u64
}

/// What hatches take while they are cut off, bytes.
pub(super) fn hatch_bytes(ground: &Ground<'_>, hatcher: &Hatcher) -> u64 {
    let areas = || ground.within.iter().chain(&ground.without);
    let crossings = |area: &&Area| extent(area).1 / hatcher.spacing_um() + 2.0 * area.rings().count() as f64;
    let all_crossings: f64 = areas().copied().map(|area| crossings(&area)).sum();
    let area_um2 = ground.within.first().map_or(0.0, |area| area.area_um2());
    let cuts = cuts(hatcher.spacing_um(), hatcher.cells(), all_crossings, area_um2);
    (CROSSING_BYTES * all_crossings + CUT_BYTES * cuts[0] + REGION_BYTES) as u64
}

/// The most hatches that are cut at once, and that are found in all.
fn cuts(spacing_um: f64, cells: Option<Cells>, crossings: f64, area_um2: f64) -> [f64; 2] {
    let chords = crossings / 2.0;
    let Some(Cells { pitch_um, is_square, .. }) = cells else { return [chords; 2] };
    let in_cells = area_um2 / spacing_um / pitch_um;
    // A chord begins and ends within a cell, and may touch two rows that overlap.
    let all = 1.2 * in_cells + 4.0 * chords;
    [
        if is_square { ONE_COLOUR * 1.2 * in_cells + 4.0 * chords } else { all },
        if is_square { all + 4.0 * chords } else { all },
    ]
}

/// Number of points, and length of the border, micrometres.
fn extent(area: &Area) -> (f64, f64) {
    let points: usize = area.rings().map(Vec::len).sum();
    let edges = area.rings().flat_map(|ring| ring_edges(ring));
    (points as f64, edges.map(|[a, b]| distance_um(to_um(a), to_um(b))).sum())
}

/// What the memory of a region depends on.
struct Outline {
    points: f64,
    rings: f64,
    length_um: f64,
    /// By how much the border turns in all corners, radians.
    turn: f64,
    /// The corners with an arc of each turn, where the border turns right and left, after it was moved inwards and outwards.
    right: f64,
    left: f64,
    right_at_contour: f64,
}

impl RegionMemory {
    /// That of a region. `neighbour_points`: how many points the regions above and below it have.
    pub(super) fn of(region: &Region, settings: &ScanSettings, rules: &ThinRules, neighbour_points: u64) -> Self {
        let hatches = [&settings.hatch, &settings.up_skin, &settings.down_skin].map(Option::as_ref);
        let end_offset_um = hatches.iter().flatten().map(|hatch| hatch.end_offset_um).fold(0.0, f64::max);
        let masks = hatches.iter().skip(1).flatten().count() as f64;
        let area_um2 = region.area_um2().max(0.0);
        let half_narrow_um = settings.contour_only_below_um / 2.0;
        // No region of this area has room for more contours than a disc.
        let most_contours = 1.0 + (area_um2 / std::f64::consts::PI).sqrt() / settings.contour_spacing_um;
        let contours = most_contours.min(f64::from(settings.contour_count));
        let inner_contours = most_contours.min(1.0 + half_narrow_um / settings.contour_spacing_um);
        let contour_um = settings.contour_offset_um + (contours - 1.0).max(0.0) * settings.contour_spacing_um;
        let inwards_um =
            (rules.below_um / 2.0).max(half_narrow_um).max(contour_um + settings.contour_spacing_um + end_offset_um);
        let outwards_um = (rules.below_um / 2.0 * REACH).max(half_narrow_um * CORNER_REACH + end_offset_um + SEAM_UM);
        let outline = Outline::of(region, [inwards_um, outwards_um, contour_um]);

        // The border moved inwards, and that moved outwards again.
        let inside = outline.points + outline.right;
        let outside = inside + outline.left;
        let neighbours = masks * neighbour_points as f64;
        let combined = OVERLAY_BYTES * (outline.points + outside + neighbours);
        let held = AREA_BYTES * outside + 16.0 * neighbours + RING_BYTES * outline.rings + REGION_BYTES;
        let points = contours * (outline.points + outline.right_at_contour + outline.rings) + inner_contours * inside;
        let rings = (contours + inner_contours) * outline.rings;

        let divided = outline.points + 2.0 * outline.length_um / triangle_edge_um(rules);
        let border_um = outline.length_um + outline.turn * inwards_um;
        let mut filling = TRIANGLE_BYTES * divided;
        let mut found = 0.0;
        for hatch in hatches.into_iter().flatten() {
            let crossings = border_um / hatch.spacing_um + 2.0 * outline.rings;
            let [at_once, all] = cuts(hatch.spacing_um, Cells::of(hatch.strategy), crossings, area_um2);
            filling = filling.max((2.0 + masks) * CROSSING_BYTES * crossings + CUT_BYTES * at_once);
            found += all;
        }
        let grown = |counts: [f64; 3]| 3 * pieces::bytes(counts.map(|count| count.ceil() as usize));
        Self {
            areas_bytes: ((TRIM_BYTES * inside).max(combined) + held) as u64,
            filling_bytes: filling as u64,
            contours_bytes: grown([rings, points, 0.0]),
            lines_bytes: grown([found + divided / 4.0, divided / 2.0, found]),
        }
    }

    /// All of it, bytes.
    pub(super) fn all_bytes(&self) -> u64 {
        self.work_bytes() + self.found_bytes()
    }

    /// Work space, free again when the region is filled, bytes.
    pub(super) fn work_bytes(&self) -> u64 {
        self.areas_bytes + self.filling_bytes
    }

    /// What it is filled with, bytes.
    pub(super) fn found_bytes(&self) -> u64 {
        self.contours_bytes + self.lines_bytes
    }
}

impl Outline {
    /// Of a region whose border is moved inwards, then outwards, and to the innermost contour, by these distances.
    fn of(region: &Region, distances_um: [f64; 3]) -> Self {
        let step = |radius_um: f64| least_cosine(radius_um.max(1e-3), ARC_ERROR_UM).acos();
        let [inwards, outwards, contour] = distances_um.map(step);
        // Angles are halved until they are small enough. A small turn keeps its one point.
        let arc = |turn: f64, step: f64| if turn <= step { 0.0 } else { (turn / step).log2().ceil().exp2() };
        let mut outline =
            Self { points: 0.0, rings: 0.0, length_um: 0.0, turn: 0.0, right: 0.0, left: 0.0, right_at_contour: 0.0 };
        for ring in region.rings() {
            outline.rings += 1.0;
            let Some(last) = ring.last() else { continue };
            let mut before: Option<[f64; 2]> = None;
            let mut from = *last;
            // The first edge once more, for the corner at its beginning.
            for (number, to) in ring.iter().chain(ring.first()).enumerate() {
                let along = [to[0] - from[0], to[1] - from[1]];
                from = *to;
                if let Some(before) = before {
                    let cross = before[0] * along[1] - before[1] * along[0];
                    let turn = cross.atan2(before[0] * along[0] + before[1] * along[1]);
                    outline.turn += turn.abs();
                    if turn < 0.0 {
                        outline.right += arc(-turn, inwards);
                        outline.right_at_contour += arc(-turn, contour);
                    } else {
                        outline.left += arc(turn, outwards);
                    }
                }
                if number < ring.len() {
                    outline.points += 1.0;
                }
                before = Some(along);
            }
            outline.length_um += ring_edges(ring).map(|[a, b]| distance_um(a, b)).sum::<f64>();
        }
        outline
    }
}
