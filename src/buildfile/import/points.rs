//! Points with normals as a surface: each becomes a disc, so wide that it overlaps its neighbours. `mesh/ply.rs` reads points;
//! `tests/relief/points.rs` prints them.

use std::collections::HashMap;
use std::ops::Range;

use glam::DVec3;

/// A point and its normal, of any length.
pub(super) type Point = (DVec3, DVec3);

/// A disc is as wide as this neighbour is far: on an even grid there are six, and more on a dense one.
const NEIGHBOUR: usize = 6;

/// Radius of a disc, in distances of that neighbour. On an even grid discs overlap by half.
const RADIUS: f64 = 0.8;

/// Points in a cell of the grid in which neighbours are sought, about, if they lie on a plane.
const POINTS_IN_CELL: f64 = 4.0;

/// Most points that are looked at to find a neighbour. Of more, some are left out evenly: a cloud with all points in one place would take forever.
const MAX_LOOKED_AT: usize = 512;

/// Triangles of a disc, which is a hexagon.
const TRIANGLES: u64 = 4;

/// Memory for each point while discs are made, bytes: the point, and its place in the grid.
pub(super) const BYTES_PER_POINT: u64 = size_of::<Point>() as u64 + 4 + 32;

/// Number of triangles of all discs.
pub(super) fn triangle_count(points: u64) -> u64 {
    points.saturating_mul(TRIANGLES)
}

/// Hands on the triangles of all discs, counter-clockwise seen from where the normals point to, with the number of their point.
///
/// # Errors
/// That of `take`.
pub(super) fn discs<E>(points: &[Point], mut take: impl FnMut([DVec3; 3], usize) -> Result<(), E>) -> Result<(), E> {
    let grid = Grid::new(points);
    let mut distances = Vec::with_capacity(MAX_LOOKED_AT);
    for (number, (at, normal)) in points.iter().enumerate() {
        let radius = RADIUS * grid.spacing(*at, &mut distances);
        let (along, across) = normal.normalize_or_zero().any_orthonormal_pair();
        let corner = |place: u32| {
            let angle = f64::from(place) * std::f64::consts::FRAC_PI_3;
            *at + along * (radius * angle.cos()) + across * (radius * angle.sin())
        };
        for triangle in [[0, 1, 2], [2, 3, 4], [4, 5, 0], [0, 2, 4]] {
            take(triangle.map(corner), number)?;
        }
    }
    Ok(())
}

/// Points in cells.
struct Grid<'a> {
    points: &'a [Point],
    low: DVec3,
    cell: f64,
    /// Numbers of the points, cell by cell.
    order: Vec<u32>,
    /// Where each cell is in the order.
    cells: HashMap<[i64; 3], Range<usize>>,
}

impl<'a> Grid<'a> {
    fn new(points: &'a [Point]) -> Self {
        let low = points.iter().fold(DVec3::MAX, |low, (at, _)| low.min(*at));
        let high = points.iter().fold(DVec3::MIN, |high, (at, _)| high.max(*at));
        let share = (POINTS_IN_CELL / points.len().max(1) as f64).sqrt().min(1.0);
        // All points may be in one place.
        let cell = ((high - low).max_element() * share).max(1e-9);
        let cell_of = |number: u32| cell_of(points[number as usize].0, low, cell);
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.sort_unstable_by_key(|number| cell_of(*number));
        let mut cells = HashMap::new();
        let mut begin = 0;
        for numbers in order.chunk_by(|a, b| cell_of(*a) == cell_of(*b)) {
            cells.insert(cell_of(numbers[0]), begin..begin + numbers.len());
            begin += numbers.len();
        }
        Self { points, low, cell, order, cells }
    }

    /// How far the neighbour of a point is; the length of a cell if it has too few.
    fn spacing(&self, at: DVec3, distances: &mut Vec<f64>) -> f64 {
        let [x, y, z] = cell_of(at, self.low, self.cell);
        let around =
            (-1..=1).flat_map(|dx| (-1..=1).flat_map(move |dy| (-1..=1).map(move |dz| [x + dx, y + dy, z + dz])));
        let cells: Vec<_> = around.filter_map(|cell| self.cells.get(&cell)).cloned().collect();
        let count: usize = cells.iter().map(ExactSizeIterator::len).sum();
        let step = count.div_ceil(MAX_LOOKED_AT);
        distances.clear();
        let numbers = cells.into_iter().flatten().step_by(step.max(1)).map(|place| self.order[place] as usize);
        distances.extend(numbers.map(|number| self.points[number].0.distance_squared(at)));
        if distances.len() <= NEIGHBOUR {
            return self.cell;
        }
        let (_, squared, _) = distances.select_nth_unstable_by(NEIGHBOUR, f64::total_cmp);
        // Of a surface, a share of the points is farther apart by the root of it.
        (*squared / step as f64).sqrt()
    }
}

fn cell_of(at: DVec3, low: DVec3, cell: f64) -> [i64; 3] {
    ((at - low) / cell).floor().to_array().map(|at| at as i64)
}
