//! A triangular grid, whose edges may have fewer pieces than its inside. `dice` divides parts of patches with it.

/// Most pieces along an edge of a grid. With more, a grid would reach beyond what most layers need of it.
pub(super) const MAX_PIECES: usize = 8;

/// Points of the largest grid.
const MAX_POINTS: usize = (MAX_PIECES + 1) * (MAX_PIECES + 2) / 2;

/// Points with the shares `[i, j, k] / pieces` of three corners, where `i + j + k = pieces`. On an edge that has fewer pieces, each is moved to
/// the nearest end of such a piece. Facets between points that are one then vanish, and the others still cover the grid once.
pub(super) struct Grid {
    pieces: usize,
    /// Of the edges from each corner to the next.
    edge_pieces: [usize; 3],
}

/// The points of a grid, and for each point the number of the one that it was moved to.
pub(super) type Points<P> = ([P; MAX_POINTS], [u8; MAX_POINTS]);

impl Grid {
    /// A grid of so many pieces along each edge; `edge_pieces` are those that the edges from each corner to the next really have. All are
    /// powers of two, and `pieces`, at most [`MAX_PIECES`], is the greatest of them.
    pub(super) fn new(pieces: usize, edge_pieces: [usize; 3]) -> Self {
        Self { pieces, edge_pieces }
    }

    /// Hands on the facets between [`Grid::points`], in the orientation of the corners.
    pub(super) fn facets<P: Copy>(&self, (points, names): &Points<P>, mut take: impl FnMut([P; 3])) {
        let mut facet = |corners: [usize; 3]| {
            let [a, b, c] = corners.map(|corner| names[corner]);
            if a != b && b != c && c != a {
                take([a, b, c].map(|name| points[usize::from(name)]));
            }
        };
        // Row i has i + 1 points, the first of them on the edge from corner 0 to 1, the last on that from 0 to 2.
        for row in 0..self.pieces {
            let (above, below) = (first(row), first(row + 1));
            for column in 0..=row {
                facet([above + column, below + column, below + column + 1]);
                if column < row {
                    facet([above + column, below + column + 1, above + column + 1]);
                }
            }
        }
    }

    /// The points. `point` takes shares of the corners, and is not called for these.
    pub(super) fn points<P: Copy>(&self, corners: [P; 3], point: impl Fn([f64; 3]) -> P) -> Points<P> {
        let mut points = [corners[0]; MAX_POINTS];
        let mut names = [0; MAX_POINTS];
        let share = 1.0 / self.pieces as f64;
        for row in 0..=self.pieces {
            for column in 0..=row {
                let number = first(row) + column;
                let name = self.moved(row, column);
                names[number] = name as u8;
                if name == number {
                    points[number] = match (row, column) {
                        (0, _) => corners[0],
                        (row, 0) if row == self.pieces => corners[1],
                        (row, column) if row == self.pieces && column == row => corners[2],
                        _ => point([self.pieces - row, row - column, column].map(|part| part as f64 * share)),
                    };
                }
            }
        }
        (points, names)
    }

    /// The number of the point to which one is moved.
    fn moved(&self, row: usize, column: usize) -> usize {
        let nearest = |at: usize, pieces: usize| {
            let step = self.pieces / pieces;
            (at + step / 2) / step * step
        };
        let [ab, bc, ca] = self.edge_pieces;
        if column == 0 && row < self.pieces {
            first(nearest(row, ab))
        } else if row == self.pieces {
            first(row) + nearest(column, bc)
        } else if column == row {
            let row = nearest(row, ca);
            first(row) + row
        } else {
            first(row) + column
        }
    }
}

/// Number of the first point of a row.
fn first(row: usize) -> usize {
    row * (row + 1) / 2
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn facets_cover_the_grid_once_and_end_at_the_pieces_of_its_edges() {
        let corners = [DVec3::new(0.0, 0.0, 0.0), DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.0, 1.0, 0.0)];
        let counts = [1, 2, 4, 8];
        for number in 0..64 {
            let edge_pieces = [counts[number % 4], counts[number / 4 % 4], counts[number / 16]];
            for pieces in counts.into_iter().filter(|count| edge_pieces.iter().all(|edge| edge <= count)) {
                let mut area = 0.0;
                let mut outline: Vec<[DVec3; 2]> = Vec::new();
                let point = |[a, b, c]: [f64; 3]| corners[0] * a + corners[1] * b + corners[2] * c;
                let grid = Grid::new(pieces, edge_pieces);
                grid.facets(&grid.points(corners, point), |[a, b, c]| {
                    let twice = (b - a).cross(c - a).z;
                    assert!(twice >= 0.0, "turned over");
                    area += twice / 2.0;
                    for edge in [[a, b], [b, c], [c, a]] {
                        let before = outline.len();
                        outline.retain(|[from, to]| [*to, *from] != edge);
                        assert!(before - outline.len() <= 1);
                        if before == outline.len() {
                            outline.push(edge);
                        }
                    }
                });
                assert!((area - 0.5).abs() < 1e-12, "{area} with {pieces} and {edge_pieces:?}");
                assert_eq!(outline.len(), edge_pieces.iter().sum::<usize>(), "{pieces} and {edge_pieces:?}");
                for (edge, count) in edge_pieces.into_iter().enumerate() {
                    let [from, to] = [corners[edge], corners[(edge + 1) % 3]];
                    for piece in 0..count {
                        let ends = [piece, piece + 1].map(|at| from.lerp(to, at as f64 / count as f64));
                        assert!(outline.contains(&ends), "{ends:?} is missing");
                    }
                }
            }
        }
    }
}
