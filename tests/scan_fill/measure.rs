//! What vectors melt, and how deep in regions they lie. The other files here use it.

use layerd::layer::{Mark, MarkClass, Vectors};
use layerd::slice::scan::Region;

/// Shares of the regions' area: what tracks of a beam's width cover, and what they cover beside it. Pixels of 5 µm.
pub(crate) struct Melted {
    pub(crate) covered: f64,
    pub(crate) spilled: f64,
}

const PIXEL_UM: f64 = 5.0;

pub(crate) fn melted(vectors: &Vectors, regions: &[Region], beam_um: f64) -> Melted {
    let points = || regions.iter().flat_map(|region| &region.outer);
    let low = [0, 1].map(|axis| points().map(|point| point[axis]).fold(f64::MAX, f64::min) - 2.0 * beam_um);
    let high = [0, 1].map(|axis| points().map(|point| point[axis]).fold(f64::MIN, f64::max) + 2.0 * beam_um);
    let [width, height] = [0, 1].map(|axis| ((high[axis] - low[axis]) / PIXEL_UM).ceil() as usize);
    let mut is_solid = vec![false; width * height];
    for row in 0..height {
        let y = low[1] + (row as f64 + 0.5) * PIXEL_UM;
        let mut crossings: Vec<f64> =
            regions.iter().flat_map(Region::rings).flat_map(|ring| ring_crossings(ring, y)).collect();
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks(2) {
            let [from, to] = [pair[0], pair[1]].map(|x| ((x - low[0]) / PIXEL_UM - 0.5).ceil() as usize);
            is_solid[row * width + from..row * width + to].fill(true);
        }
    }
    let mut is_melted = vec![false; width * height];
    for mark in vectors.marks() {
        let [a, b] = [mark.from_um, mark.to_um].map(|point| [0, 1].map(|axis| f64::from(point[axis]) - low[axis]));
        let pixel = |um: f64| (um / PIXEL_UM).max(0.0) as usize;
        let first = [0, 1].map(|axis| pixel(a[axis].min(b[axis]) - beam_um / 2.0));
        let last = [0, 1].map(|axis| pixel(a[axis].max(b[axis]) + beam_um / 2.0));
        for row in first[1]..=last[1].min(height - 1) {
            for column in first[0]..=last[0].min(width - 1) {
                let at = [column, row].map(|pixel| (pixel as f64 + 0.5) * PIXEL_UM);
                if off_um(at, a, b) <= beam_um / 2.0 {
                    is_melted[row * width + column] = true;
                }
            }
        }
    }
    let count = |wanted: fn(bool, bool) -> bool| {
        is_solid.iter().zip(&is_melted).filter(|(solid, melted)| wanted(**solid, **melted)).count() as f64
    };
    let solid = count(|solid, _| solid);
    Melted {
        covered: count(|solid, melted| solid && melted) / solid,
        spilled: count(|solid, melted| !solid && melted) / solid,
    }
}

fn ring_crossings(ring: &[[f64; 2]], y: f64) -> impl Iterator<Item = f64> {
    (0..ring.len()).filter_map(move |number| {
        let [a, b] = [ring[number], ring[(number + 1) % ring.len()]];
        ((a[1] <= y) != (b[1] <= y)).then(|| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
    })
}

/// Distance from a point to a segment.
pub(crate) fn off_um(point: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let [x, y] = [b[0] - a[0], b[1] - a[1]];
    let [px, py] = [point[0] - a[0], point[1] - a[1]];
    let squared = x * x + y * y;
    let share = if squared > 0.0 { ((px * x + py * y) / squared).clamp(0.0, 1.0) } else { 0.0 };
    (px - x * share).hypot(py - y * share)
}

/// Distance from a point to the nearest border, negative outside.
pub(crate) fn depth_um(regions: &[Region], point: [f64; 2]) -> f64 {
    let rings = || regions.iter().flat_map(Region::rings);
    let right = rings().flat_map(|ring| ring_crossings(ring, point[1])).filter(|x| *x > point[0]).count();
    let edges = rings().flat_map(|ring| (0..ring.len()).map(|number| [ring[number], ring[(number + 1) % ring.len()]]));
    let nearest = edges.map(|[a, b]| off_um(point, a, b)).fold(f64::MAX, f64::min);
    if right % 2 == 1 { nearest } else { -nearest }
}

/// Hatches end at least `least_um` inside, less what rounding to whole micrometres takes.
pub(crate) fn assert_hatches_inside(vectors: &Vectors, regions: &[Region], least_um: f64) {
    let is_hatch = |mark: &Mark| !matches!(mark.class, MarkClass::Contour | MarkClass::Thin | MarkClass::Point);
    for mark in vectors.marks().filter(is_hatch) {
        for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
            let at = [0, 1].map(|axis| {
                let [from, to] = [mark.from_um[axis], mark.to_um[axis]].map(f64::from);
                from + (to - from) * share
            });
            let depth = depth_um(regions, at);
            // Half a micrometre is what an arc leaves its circle.
            assert!(depth >= least_um - 1.5, "{mark:?} is {depth} µm inside");
        }
    }
}

/// Distance from one point to another.
pub(crate) fn far_um(a: [i32; 2], b: [i32; 2]) -> f64 {
    (f64::from(a[0]) - f64::from(b[0])).hypot(f64::from(a[1]) - f64::from(b[1]))
}
