//! Points with normals as a surface: each becomes a disc, so wide that it overlaps its neighbours. `mesh/ply.rs` reads points;
//! `tests/relief/points.rs` prints them.

use glam::DVec3;

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

/// Memory for each point while discs are made, besides the point and its normal, bytes: its place in the grid.
pub(super) const BYTES_PER_POINT: u64 = size_of::<(u64, u32)>() as u64;

/// Bits of a key for the number of a cell along each axis. There are at most 2¹⁵ along the longest, because a file has at most 2³² points.
const AXIS_BITS: u32 = 21;

/// Number of triangles of all discs.
pub(super) fn triangle_count(points: u64) -> u64 {
    points.saturating_mul(TRIANGLES)
}

/// Hands on the triangles of the discs of all points, which have these normals, of any length: counter-clockwise seen from where the normals
/// point to, with the number of their point.
///
/// # Errors
/// That of `take`.
pub(super) fn discs<E>(
    points: &[DVec3],
    normals: &[DVec3],
    mut take: impl FnMut([DVec3; 3], usize) -> Result<(), E>,
) -> Result<(), E> {
    let grid = Grid::new(points);
    let mut distances = Vec::with_capacity(MAX_LOOKED_AT);
    for (number, (at, normal)) in points.iter().zip(normals).enumerate() {
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
    points: &'a [DVec3],
    low: DVec3,
    cell: f64,
    /// The key of each point's cell and the number of the point, in ascending order: no list of cells is needed, however many there are.
    order: Vec<(u64, u32)>,
}

impl<'a> Grid<'a> {
    fn new(points: &'a [DVec3]) -> Self {
        let low = points.iter().fold(DVec3::MAX, |low, at| low.min(*at));
        let high = points.iter().fold(DVec3::MIN, |high, at| high.max(*at));
        let share = (POINTS_IN_CELL / points.len().max(1) as f64).sqrt().min(1.0);
        // All points may be in one place.
        let cell = ((high - low).max_element() * share).max(1e-9);
        let mut order: Vec<_> =
            points.iter().zip(0..).map(|(at, number)| (key(cell_of(*at, low, cell)), number)).collect();
        order.sort_unstable();
        Self { points, low, cell, order }
    }

    /// The points of three cells along x.
    fn row(&self, [x, y, z]: [u64; 3]) -> &[(u64, u32)] {
        let [first, last] = [x - 1, x + 1].map(|x| key([x, y, z]));
        let begin = self.order.partition_point(|(key, _)| *key < first);
        let rest = &self.order[begin..];
        &rest[..rest.partition_point(|(key, _)| *key <= last)]
    }

    /// How far the neighbour of a point is; the length of a cell if it has too few.
    fn spacing(&self, at: DVec3, distances: &mut Vec<f64>) -> f64 {
        let [x, y, z] = cell_of(at, self.low, self.cell);
        let rows: [[_; 3]; 3] =
            std::array::from_fn(|dz| std::array::from_fn(|dy| self.row([x, y + dy as u64 - 1, z + dz as u64 - 1])));
        let count: usize = rows.as_flattened().iter().map(|row| row.len()).sum();
        let step = count.div_ceil(MAX_LOOKED_AT);
        distances.clear();
        let numbers = rows.as_flattened().iter().copied().flatten().step_by(step.max(1));
        distances.extend(numbers.map(|(_, number)| self.points[*number as usize].distance_squared(at)));
        if distances.len() <= NEIGHBOUR {
            return self.cell;
        }
        let (_, squared, _) = distances.select_nth_unstable_by(NEIGHBOUR, f64::total_cmp);
        // Of a surface, a share of the points is farther apart by the root of it.
        (*squared / step as f64).sqrt()
    }
}

/// The number of a cell along each axis, at least 1, so that each has a neighbour on both sides.
fn cell_of(at: DVec3, low: DVec3, cell: f64) -> [u64; 3] {
    ((at - low) / cell).to_array().map(|at| at as u64 + 1)
}

/// An order of cells in which those along x follow one another.
fn key([x, y, z]: [u64; 3]) -> u64 {
    (z << AXIS_BITS | y) << AXIS_BITS | x
}
