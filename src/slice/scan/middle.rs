//! The lines along the middle of a narrow area. `thin` uses them.
//!
//! The border is divided into short edges, and the area into triangles between them. In a strip each triangle has two sides that cross it,
//! and the line goes through their middles. Triangles with three such sides are where it branches. Branches into corners are shorter than
//! the area is wide there, and are cut off.

use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay::IntOverlayOptions;
use i_overlay::core::solver::Solver;
use i_triangle::advanced::delaunay::IntDelaunay;
use i_triangle::int::triangulator::IntTriangulator;
use i_triangle::int::validation::Validation;

use super::offset::{Area, Contour, Point, to_um};
use super::path::{distance_um, length_um, ring_edges};
use super::thin::ThinRules;

/// How often branches are cut off, each time all short ones. Two or three passes are usual.
const MAX_PASSES: u32 = 32;

/// Edges of the divided border, parts of the width below which an area is thin, and the shortest, micrometres.
const EDGE_SHARE: f64 = 0.25;
const SHORTEST_EDGE_UM: f64 = 5.0;

/// Parts shorter than so many times the width of their joints are stubs.
const STUB_SHARE: f64 = 1.5;

/// Where a narrow area meets a wide one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Joint {
    /// Middle of the border between them, micrometres.
    pub(super) at_um: [f64; 2],
    /// Unit vector into the wide area.
    pub(super) outwards: [f64; 2],
    /// Length of the border between them, micrometres.
    pub(super) width_um: f64,
}

impl Joint {
    /// The point so far from the joint within the wide area.
    fn beyond(&self, distance_um: f64) -> [f64; 2] {
        [0, 1].map(|axis| self.at_um[axis] + self.outwards[axis] * distance_um)
    }

    /// How far a point lies behind the joint, in the narrow area.
    fn depth_um(&self, point: [f64; 2]) -> f64 {
        (0..2).map(|axis| (self.at_um[axis] - point[axis]) * self.outwards[axis]).sum()
    }
}

/// Lines along the middle of an area. At a free end they stop half a beam before the border; at a joint they go on to the contour of the
/// wide part. Empty if the area is so small or round that nothing is left between its ends.
pub(super) fn middle_lines(area: &Area, joints: &[Joint], rules: &ThinRules) -> Vec<Vec<[f64; 2]>> {
    if let Some(line) = stub_line(area, joints, rules) {
        return vec![line];
    }
    let mut net = Net::new(&triangles(area, triangle_edge_um(rules)));
    net.prune(joints);
    let mut lines = net.lines();
    for joint in joints {
        connect(&mut lines, joint, rules.contour_um);
    }
    for line in &mut lines {
        for _ in 0..2 {
            if line.is_free[1] {
                end_before_border(&mut line.points, area, rules);
            }
            line.points.reverse();
            line.is_free.reverse();
        }
    }
    lines.into_iter().map(|line| line.points).filter(|points| length_um(points) > 0.0).collect()
}

/// The line of a tip or a web that is hardly longer than wide; `None` if the area is none. Beside a wide part it has two horns, which are
/// as long as the stub itself: a line through triangles would run across it, from horn to horn.
fn stub_line(area: &Area, joints: &[Joint], rules: &ThinRules) -> Option<Vec<[f64; 2]>> {
    if area.rings().count() != 1 {
        return None;
    }
    let beyond = |joint: &Joint| joint.beyond(rules.contour_um);
    match joints {
        [joint] => {
            let points = area.rings().flatten().map(|point| to_um(*point));
            let (depth_um, tip) =
                points.map(|point| (joint.depth_um(point), point)).max_by(|a, b| a.0.total_cmp(&b.0))?;
            if depth_um >= STUB_SHARE * joint.width_um {
                return None;
            }
            // Half a beam before the border.
            let share = 1.0 - rules.beam_um / 2.0 / distance_um(joint.at_um, tip);
            let end = [0, 1].map(|axis| joint.at_um[axis] + share * (tip[axis] - joint.at_um[axis]));
            let line = [end, joint.at_um, beyond(joint)];
            Some(line[usize::from(share <= 0.0)..].to_vec())
        }
        [one, other] => {
            let is_short = distance_um(one.at_um, other.at_um) < STUB_SHARE * one.width_um.max(other.width_um);
            is_short.then(|| vec![beyond(one), one.at_um, other.at_um, beyond(other)])
        }
        _ => None,
    }
}

/// Length of the edges into which the border is divided, micrometres.
pub(super) fn triangle_edge_um(rules: &ThinRules) -> f64 {
    (rules.below_um * EDGE_SHARE).max(SHORTEST_EDGE_UM)
}

/// A line through the middles of triangle sides.
struct Line {
    points: Vec<[f64; 2]>,
    /// Whether the first and the last point lie in a tip of the area.
    is_free: [bool; 2],
}

/// Divides an area into triangles with short edges along the border, as round as possible.
fn triangles(area: &Area, edge_um: f64) -> IntDelaunay<i32> {
    let mut found = IntDelaunay { triangles: Vec::new(), points: Vec::new() };
    let Some(shape) = area.shapes().first() else { return found };
    let divided: Vec<Contour> = shape.iter().map(|ring| divide(ring, edge_um)).collect();
    let validation = Validation { fill_rule: FillRule::NonZero, options: IntOverlayOptions::keep_all_points() };
    let points = divided.iter().map(Vec::len).sum();
    IntTriangulator::<i32, u32>::new(points, validation, Solver::default()).delaunay_shape_into(&divided, &mut found);
    found
}

/// A ring with points at most `edge_um` apart.
fn divide(ring: &[Point], edge_um: f64) -> Contour {
    let pairs = ring_edges(ring).flat_map(|[a, b]| {
        let [x, y] = [f64::from(b.x) - f64::from(a.x), f64::from(b.y) - f64::from(a.y)];
        let steps = (x.hypot(y) / 1000.0 / edge_um).ceil().max(1.0);
        (0..steps as u32).map(move |step| {
            let share = f64::from(step) / steps;
            Point::new(a.x + (x * share).round() as i32, a.y + (y * share).round() as i32)
        })
    });
    pairs.collect()
}

/// The middles of triangle sides, and of the triangles where three of them meet, with links between them.
#[derive(Default)]
struct Net {
    knots: Vec<Knot>,
}

struct Knot {
    at_um: [f64; 2],
    /// How wide the area is here: the longest side.
    width_um: f64,
    /// At most three.
    links: Vec<u32>,
    /// How far the longest branch reached that was cut off here. It keeps a line from being cut off bit by bit.
    tip_um: f64,
}

/// A branch without the fork at which it begins, from its end on.
struct Branch {
    knots: Vec<u32>,
    fork: u32,
    /// With what was cut off at its end before.
    length_um: f64,
}

impl Net {
    fn new(mesh: &IntDelaunay<i32>) -> Self {
        let mut net = Self::default();
        let mut side_knots = vec![[u32::MAX; 3]; mesh.triangles.len()];
        for (number, triangle) in mesh.triangles.iter().enumerate() {
            let corners = triangle.vertices.map(|vertex| to_um(vertex.point));
            let mut knots = Vec::with_capacity(3);
            for side in 0..3 {
                let neighbour = triangle.neighbors[side];
                let Some(other) = mesh.triangles.get(neighbour) else { continue };
                if side_knots[number][side] == u32::MAX {
                    let ends = [corners[(side + 1) % 3], corners[(side + 2) % 3]];
                    side_knots[number][side] = net.add(middle(&ends), distance_um(ends[0], ends[1]));
                    if let Some(side_there) = (0..3).find(|side| other.neighbors[*side] == number) {
                        side_knots[neighbour][side_there] = side_knots[number][side];
                    }
                }
                knots.push(side_knots[number][side]);
            }
            match knots[..] {
                [a, b] => net.link(a, b),
                [a, b, c] => {
                    let widths = [a, b, c].map(|knot| net.knots[knot as usize].width_um);
                    let centre = net.add(middle(&corners), widths[0].max(widths[1]).max(widths[2]));
                    [a, b, c].into_iter().for_each(|knot| net.link(knot, centre));
                }
                _ => {}
            }
        }
        net
    }

    fn add(&mut self, at_um: [f64; 2], width_um: f64) -> u32 {
        self.knots.push(Knot { at_um, width_um, links: Vec::new(), tip_um: 0.0 });
        self.knots.len() as u32 - 1
    }

    fn link(&mut self, a: u32, b: u32) {
        self.knots[a as usize].links.push(b);
        self.knots[b as usize].links.push(a);
    }

    /// Cuts off branches that end in corners. Of three short ones the shortest goes, so that a line remains of a compact area.
    fn prune(&mut self, joints: &[Joint]) {
        for _ in 0..MAX_PASSES {
            let ends = (0..self.knots.len() as u32).filter(|knot| self.knots[*knot as usize].links.len() == 1);
            let mut branches: Vec<Branch> = ends.filter_map(|end| self.short_branch(end, joints)).collect();
            if branches.is_empty() {
                return;
            }
            branches.sort_by(|a, b| a.fork.cmp(&b.fork).then(a.length_um.total_cmp(&b.length_um)));
            for at_fork in branches.chunk_by(|a, b| a.fork == b.fork) {
                let count = if at_fork.len() == 3 { 1 } else { at_fork.len() };
                at_fork[..count].iter().for_each(|branch| self.cut_off(branch));
            }
        }
    }

    fn cut_off(&mut self, branch: &Branch) {
        for knot in &branch.knots {
            self.knots[*knot as usize].links.clear();
        }
        let fork = &mut self.knots[branch.fork as usize];
        fork.links.retain(|knot| !branch.knots.contains(knot));
        fork.tip_um = fork.tip_um.max(branch.length_um);
    }

    /// The branch from an end to a fork, if it is shorter than the area is wide there. At a joint the area has two horns along the sides of
    /// the wide part, which are longer.
    fn short_branch(&self, end: u32, joints: &[Joint]) -> Option<Branch> {
        let mut knots = Vec::new();
        let mut length_um = self.knots[end as usize].tip_um;
        let (mut before, mut at) = (u32::MAX, end);
        while self.knots[at as usize].links.len() < 3 {
            let next = *self.knots[at as usize].links.iter().find(|next| **next != before)?;
            length_um += distance_um(self.knots[at as usize].at_um, self.knots[next as usize].at_um);
            knots.push(at);
            (before, at) = (at, next);
        }
        let fork = &self.knots[at as usize];
        let is_at_joint = joints.iter().any(|joint| distance_um(joint.at_um, fork.at_um) <= joint.width_um);
        let limit_um = if is_at_joint { 2.0 * fork.width_um } else { fork.width_um };
        (length_um < limit_um).then_some(Branch { knots, fork: at, length_um })
    }

    /// The lines between ends and forks, then those that run in a ring.
    fn lines(&mut self) -> Vec<Line> {
        let mut lines = Vec::new();
        for number in 0..self.knots.len() as u32 {
            let count = self.knots[number as usize].links.len();
            if count == 1 || count == 3 {
                for next in self.knots[number as usize].links.clone() {
                    lines.extend(self.walk(number, next));
                }
            }
        }
        for number in 0..self.knots.len() as u32 {
            if let Some(next) = self.knots[number as usize].links.first().copied() {
                lines.extend(self.walk(number, next));
            }
        }
        lines
    }

    /// Follows links to the next end or fork, or around a ring, and takes them out. `None` if the link is gone.
    fn walk(&mut self, start: u32, next: u32) -> Option<Line> {
        if !self.knots[start as usize].links.contains(&next) {
            return None;
        }
        let mut is_free = [self.degree(start) == 1, false];
        let mut points = vec![self.knots[start as usize].at_um];
        let (mut before, mut at) = (start, next);
        loop {
            points.push(self.knots[at as usize].at_um);
            let degree = self.degree(at);
            self.knots[before as usize].links.retain(|knot| *knot != at);
            self.knots[at as usize].links.retain(|knot| *knot != before);
            is_free[1] = degree == 1 && at != start;
            if degree != 2 || at == start {
                break;
            }
            let Some(onward) = self.knots[at as usize].links.first().copied() else { break };
            (before, at) = (at, onward);
        }
        Some(Line { points, is_free })
    }

    fn degree(&self, knot: u32) -> usize {
        self.knots[knot as usize].links.len()
    }
}

/// Leads a line on to the contour of the wide area beyond a joint: the line that ends there, or a new one from the nearest point.
fn connect(lines: &mut Vec<Line>, joint: &Joint, contour_um: f64) {
    let beyond = joint.beyond(contour_um);
    let ends = lines.iter_mut().flat_map(|line| {
        let Line { points, is_free } = line;
        let [first, last] = [points[0], points[points.len() - 1]].map(|end| distance_um(end, joint.at_um));
        let number = usize::from(last < first);
        is_free[number].then_some((first.min(last), number, points, &mut is_free[number]))
    });
    let nearest = ends.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(far_um, ..)| *far_um <= 1.5 * joint.width_um);
    if let Some((_, number, points, is_free)) = nearest {
        *is_free = false;
        let at = if number == 0 { 0 } else { points.len() };
        let added = if number == 0 { [beyond, joint.at_um] } else { [joint.at_um, beyond] };
        points.splice(at..at, added);
        return;
    }
    let points = lines.iter().flat_map(|line| line.points.iter().copied());
    let near = points.min_by(|a, b| distance_um(*a, joint.at_um).total_cmp(&distance_um(*b, joint.at_um)));
    let points = near.into_iter().chain([joint.at_um, beyond]).collect();
    lines.push(Line { points, is_free: [near.is_none(), false] });
}

/// Moves the last point of a line along its direction, so that it lies half a beam before the border. Of a line that is too short, one
/// point remains.
fn end_before_border(points: &mut Vec<[f64; 2]>, area: &Area, rules: &ThinRules) {
    let [.., end] = points[..] else { return };
    // The direction over a quarter of the width: the last segments may be tiny.
    let far_enough = |point: &&[f64; 2]| distance_um(**point, end) >= rules.below_um / 4.0;
    let Some(from) = points.iter().rev().find(far_enough).or(points.first()) else { return };
    let length = distance_um(*from, end);
    if length == 0.0 {
        return;
    }
    let along = [0, 1].map(|axis| (end[axis] - from[axis]) / length);
    let ahead_um = border_ahead_um(area, end, along).unwrap_or(0.0);
    let more_um = ahead_um - rules.beam_um / 2.0;
    if more_um >= 0.0 {
        // No farther than the area is wide: beyond that the direction means little.
        let more_um = more_um.min(rules.below_um);
        points.push([0, 1].map(|axis| end[axis] + along[axis] * more_um));
        return;
    }
    let mut rest_um = -more_um;
    while let [.., before, last] = points[..] {
        let step_um = distance_um(before, last);
        points.pop();
        if step_um > rest_um {
            let share = rest_um / step_um;
            points.push([0, 1].map(|axis| last[axis] + (before[axis] - last[axis]) * share));
            return;
        }
        rest_um -= step_um;
    }
}

/// Distance from a point to the border in a direction.
fn border_ahead_um(area: &Area, from: [f64; 2], along: [f64; 2]) -> Option<f64> {
    let turned = |point: Point| {
        let [x, y] = to_um(point);
        let [x, y] = [x - from[0], y - from[1]];
        [x * along[0] + y * along[1], y * along[0] - x * along[1]]
    };
    let crossings = area.rings().flat_map(|ring| {
        ring_edges(ring).filter_map(move |[a, b]| {
            let [a, b] = [turned(a), turned(b)];
            let crosses = (a[1] < 0.0) != (b[1] < 0.0);
            crosses.then(|| a[0] - a[1] * (b[0] - a[0]) / (b[1] - a[1]))
        })
    });
    crossings.filter(|ahead_um| *ahead_um >= 0.0).min_by(f64::total_cmp)
}

/// The middle of some points.
fn middle<const N: usize>(points: &[[f64; 2]; N]) -> [f64; 2] {
    [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / N as f64)
}
