//! The film between the struts: Voronoi edges, divided and lifted to where the struts' surfaces intersect (Luo & Zou 2025, §3.3.1,
//! Fig. 7). `control` joins it to the struts.

use glam::DVec3;

use super::voronoi::Voronoi;
use super::{across, unit_or};

/// Cosine of the widest angle that a piece of the film may subtend around a strut, 30°. The slack keeps pieces of exactly 30° whole,
/// whatever their rounding.
const WIDEST_PIECE: f64 = 0.866_025_403_784_438_7 - 1e-9;

/// An edge subtends less than 180°, and halving it this often makes pieces of 30° of all but broken ones.
const MOST_HALVINGS: u32 = 6;

/// A straight piece of the film between two of its vertices.
pub(super) type Segment = [u32; 2];

/// One step along the border of a cell: a vertex of the film, and the segment from it to the next vertex, in either direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) vertex: u32,
    pub(super) segment: u32,
}

/// A Voronoi edge that was divided.
#[derive(Clone, Copy, Debug)]
struct Line {
    from: u32,
    to: u32,
    /// The cell that runs along it from `from` to `to`, and the one that runs back, once it is known.
    cell: usize,
    is_closed: bool,
    first_vertex: u32,
    first_segment: u32,
    segments: u32,
}

/// A film; it can be filled again.
#[derive(Debug, Default)]
pub(super) struct Film {
    /// Vertices, in radii from the node.
    pub(super) points: Vec<DVec3>,
    pub(super) segments: Vec<Segment>,
    /// The borders of all cells, one after the other, each counter-clockwise as seen from outside.
    pub(super) steps: Vec<Step>,
    /// Where the border of each cell begins, and where the last one ends.
    pub(super) starts: Vec<u32>,
    directions: Vec<DVec3>,
    lines: Vec<Line>,
    corners: Vec<(f64, u32)>,
    between: Vec<DVec3>,
}

impl Film {
    /// Fills it; false if rounding left no diagram whose cells fit together.
    pub(super) fn fill(&mut self, voronoi: &Voronoi) -> bool {
        self.clear();
        self.directions.extend(&voronoi.vertices);
        for cell in 0..voronoi.sites.len() {
            self.starts.push(self.steps.len() as u32);
            let mut corners = std::mem::take(&mut self.corners);
            voronoi.cell(cell, &mut corners);
            let fits = self.add_cell(cell, &corners, voronoi);
            self.corners = corners;
            if !fits {
                return false;
            }
        }
        self.starts.push(self.steps.len() as u32);
        self.points
            .extend(self.directions.iter().map(|direction| lifted(*direction, &voronoi.sites[..voronoi.struts])));
        self.lines.iter().all(|line| line.is_closed)
    }

    /// The border of a cell.
    pub(super) fn border(&self, cell: usize) -> &[Step] {
        &self.steps[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// A film of two cells whose border has `points`, counter-clockwise around the first cell.
    pub(super) fn fill_loop(&mut self, points: impl Iterator<Item = DVec3>) {
        self.clear();
        self.points.extend(points);
        let count = self.points.len() as u32;
        self.segments.extend((0..count).map(|at| [at, (at + 1) % count]));
        self.steps.extend((0..count).map(|at| Step { vertex: at, segment: at }));
        self.steps.extend((0..count).rev().map(|at| Step { vertex: at, segment: (at + count - 1) % count }));
        self.starts.extend([0, count, 2 * count]);
    }

    fn clear(&mut self) {
        self.points.clear();
        self.segments.clear();
        self.steps.clear();
        self.starts.clear();
        self.directions.clear();
        self.lines.clear();
    }

    /// Adds the border of a cell with these corners; false if it does not fit to the cells before.
    fn add_cell(&mut self, cell: usize, corners: &[(f64, u32)], voronoi: &Voronoi) -> bool {
        if corners.len() < 3 {
            return false;
        }
        for (at, (_, from)) in corners.iter().enumerate() {
            let (_, to) = corners[(at + 1) % corners.len()];
            // The neighbour ran along the same edge the other way, unless it comes later.
            let back = |line: &Line| line.from == to && line.to == *from && line.cell != cell;
            if let Some(found) = self.lines.iter().position(back) {
                let line = &mut self.lines[found];
                if line.is_closed {
                    return false;
                }
                line.is_closed = true;
                let line = *line;
                self.run_back(&line);
            } else {
                // Two cells that both run from here to there: no neighbours are alike.
                if self.lines.iter().any(|line| line.from == *from && line.to == to) {
                    return false;
                }
                let Some(neighbour) = voronoi.neighbour(cell, *from, to) else { return false };
                self.add_line(cell, neighbour, *from, to, voronoi);
            }
        }
        true
    }

    /// Divides the edge between two cells and runs along it.
    fn add_line(&mut self, cell: usize, neighbour: usize, from: u32, to: u32, voronoi: &Voronoi) {
        let ends = [from, to].map(|vertex| voronoi.vertices[vertex as usize]);
        self.between.clear();
        divide(ends, [cell, neighbour].map(|site| voronoi.sites[site]), &mut self.between);
        let (first_vertex, first_segment) = (self.directions.len() as u32, self.segments.len() as u32);
        self.directions.extend(&self.between);
        let mut before = from;
        for vertex in (first_vertex..self.directions.len() as u32).chain([to]) {
            self.steps.push(Step { vertex: before, segment: self.segments.len() as u32 });
            self.segments.push([before, vertex]);
            before = vertex;
        }
        let segments = self.segments.len() as u32 - first_segment;
        self.lines.push(Line { from, to, cell, is_closed: false, first_vertex, first_segment, segments });
    }

    /// Runs along an edge of a cell before, the other way.
    fn run_back(&mut self, line: &Line) {
        for at in (0..line.segments).rev() {
            let vertex = if at + 1 == line.segments { line.to } else { line.first_vertex + at };
            self.steps.push(Step { vertex, segment: line.first_segment + at });
        }
    }
}

/// The vertex in a unit direction: on the cylinder of the strut that is nearest to it, or on the ball where it faces none (Fig. 7a).
pub(super) fn lifted(direction: DVec3, struts: &[DVec3]) -> DVec3 {
    let nearest = struts.iter().map(|strut| strut.dot(direction)).fold(0.0, f64::max);
    // Directions are at least 10° apart, so no vertex comes near an axis, and the root near 0.
    direction / (1.0 - nearest * nearest).sqrt()
}

/// Directions that divide the edge between two cells, without its ends, so that its pieces are narrow around both.
fn divide(ends: [DVec3; 2], cells: [DVec3; 2], between: &mut Vec<DVec3>) {
    let [from, to] = ends;
    let middle = unit_or(cells[0] + cells[1], from);
    let whole = from.dot(to);
    // The intersection of two cylinders is nearest to the node between their axes. If this lies on the edge, it is a vertex (Fig. 7b).
    // Edges that are narrow as a whole stay whole, or long slivers would run from them to the circles.
    if from.dot(middle) > whole && to.dot(middle) > whole && !are_narrow(ends, cells) {
        halve([from, middle], cells, MOST_HALVINGS, between);
        between.push(middle);
        halve([middle, to], cells, MOST_HALVINGS, between);
    } else {
        halve(ends, cells, MOST_HALVINGS, between);
    }
}

/// Halves a piece until its parts are narrow around both cells.
fn halve(ends: [DVec3; 2], cells: [DVec3; 2], halvings: u32, between: &mut Vec<DVec3>) {
    if halvings == 0 || are_narrow(ends, cells) {
        return;
    }
    let half = unit_or(ends[0] + ends[1], ends[0]);
    halve([ends[0], half], cells, halvings - 1, between);
    between.push(half);
    halve([half, ends[1]], cells, halvings - 1, between);
}

/// Whether the piece between two directions subtends at most [`WIDEST_PIECE`] around both cells.
fn are_narrow(ends: [DVec3; 2], cells: [DVec3; 2]) -> bool {
    cells.into_iter().all(|axis| {
        let [from, to] = ends.map(|end| across(end, axis));
        from.dot(to) >= WIDEST_PIECE * (from.length_squared() * to.length_squared()).sqrt()
    })
}
