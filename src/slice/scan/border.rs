//! The border of an area as edges that are found by place, and which part of a line or an arc lies within a distance of them. `trim`
//! and `bare` use it.
//!
//! The points within a distance of an edge are a capsule. Capsules of one width are convex, and a circle of that radius crosses the border
//! of each at most twice. So a capsule takes at most one stretch of a line or an arc.
//!
//! Only additions, products, quotients and roots are used, so the result is the same on every machine.

use super::offset::{Area, Point};

/// Most edges in a box, or boxes in a larger box.
const BOX_EDGES: usize = 8;

/// A place or a direction. Places are nanometres from the origin of a border.
pub(super) type Vector = [f64; 2];

/// An edge of a ring that is longer than nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub(super) from: Vector,
    /// Unit vector.
    pub(super) along: Vector,
    pub(super) length: f64,
    pub(super) bounds: Bounds,
    /// Number of the next edge of its ring.
    pub(super) next: u32,
}

/// The edges of an area, ring by ring, in nested boxes.
pub(super) struct Border {
    pub(super) edges: Vec<Edge>,
    /// First the boxes of [`BOX_EDGES`] edges each, then those of as many smaller boxes each, and so on. The last level has at most as many.
    levels: Vec<Vec<Bounds>>,
}

/// A box: its low corner, and its high corner with the signs changed, so that a smaller number is farther out on each side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds([f64; 4]);

/// A box as [`Bounds::meets`] compares it: for each side of the other box, the farthest place at which the two still meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reach([f64; 4]);

impl Edge {
    pub(super) fn end(&self) -> Vector {
        along(self.from, self.along, self.length)
    }
}

impl Bounds {
    /// The box around two points.
    pub(super) fn of(a: Vector, b: Vector) -> Self {
        Self([a[0].min(b[0]), a[1].min(b[1]), -a[0].max(b[0]), -a[1].max(b[1])])
    }

    /// The box with each side moved outwards.
    pub(super) fn grown(self, by: f64) -> Self {
        Self(self.0.map(|side| side - by))
    }

    /// The box around both.
    pub(super) fn with(self, other: Self) -> Self {
        Self([0, 1, 2, 3].map(|side| self.0[side].min(other.0[side])))
    }

    /// What [`Bounds::meets`] takes.
    pub(super) fn reach(self) -> Reach {
        let [left, low, right, high] = self.0;
        Reach([-right, -high, -left, -low])
    }

    /// Whether it meets another box. All sides are compared at once.
    pub(super) fn meets(&self, other: &Reach) -> bool {
        self.0.iter().zip(&other.0).fold(true, |meets, (side, limit)| meets & (side <= limit))
    }
}

impl Border {
    /// The border of an area; places are measured from `origin`.
    pub(super) fn of(area: &Area, origin: Point) -> Self {
        let mut edges: Vec<Edge> = Vec::with_capacity(area.rings().map(Vec::len).sum());
        for ring in area.rings() {
            let first = edges.len();
            let Some(last) = ring.last() else { continue };
            let mut from = place(origin, *last);
            for point in ring {
                let to = place(origin, *point);
                let [x, y] = [to[0] - from[0], to[1] - from[1]];
                let length = (x * x + y * y).sqrt();
                if length > 0.0 {
                    let next = edges.len() as u32 + 1;
                    let bounds = Bounds::of(from, to);
                    edges.push(Edge { from, along: [x / length, y / length], length, bounds, next });
                }
                from = to;
            }
            if let Some(last) = edges[first..].last_mut() {
                last.next = first as u32;
            }
        }
        let mut levels = Vec::new();
        let mut boxes: Vec<Bounds> =
            edges.chunks(BOX_EDGES).filter_map(|edges| union(edges.iter().map(|edge| edge.bounds))).collect();
        while boxes.len() > BOX_EDGES {
            let larger = boxes.chunks(BOX_EDGES).filter_map(|boxes| union(boxes.iter().copied())).collect();
            levels.push(std::mem::replace(&mut boxes, larger));
        }
        levels.push(boxes);
        Self { edges, levels }
    }

    /// Shows the edges whose box meets another, in order, until `see` returns false.
    pub(super) fn near(&self, bounds: Bounds, see: &mut impl FnMut(u32) -> bool) {
        let top = self.levels.len() - 1;
        self.near_in(top, 0..self.levels[top].len(), &bounds.reach(), see);
    }

    fn near_in(
        &self,
        level: usize,
        boxes: std::ops::Range<usize>,
        bounds: &Reach,
        see: &mut impl FnMut(u32) -> bool,
    ) -> bool {
        for number in boxes {
            if !self.levels[level][number].meets(bounds) {
                continue;
            }
            let first = number * BOX_EDGES;
            let go_on = if level == 0 {
                let end = self.edges.len().min(first + BOX_EDGES);
                (first..end).all(|number| !self.edges[number].bounds.meets(bounds) || see(number as u32))
            } else {
                let end = self.levels[level - 1].len().min(first + BOX_EDGES);
                self.near_in(level - 1, first..end, bounds, see)
            };
            if !go_on {
                return false;
            }
        }
        true
    }
}

fn union(mut boxes: impl Iterator<Item = Bounds>) -> Option<Bounds> {
    let first = boxes.next()?;
    Some(boxes.fold(first, Bounds::with))
}

/// A point as nanometres from an origin.
pub(super) fn place(origin: Point, point: Point) -> Vector {
    [f64::from(point.x) - f64::from(origin.x), f64::from(point.y) - f64::from(origin.y)]
}

pub(super) fn along(from: Vector, direction: Vector, far: f64) -> Vector {
    [from[0] + direction[0] * far, from[1] + direction[1] * far]
}

pub(super) fn minus(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1]]
}

pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

pub(super) fn cross(a: Vector, b: Vector) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// The stretches of a line or an arc that are left, in order.
#[derive(Debug, Default)]
pub(super) struct Spans {
    pub(super) left: Vec<[f64; 2]>,
}

impl Spans {
    /// Begins with one stretch.
    pub(super) fn begin(&mut self, span: [f64; 2]) {
        self.left.clear();
        self.left.push(span);
    }

    /// Takes a stretch out. Returns whether anything is left.
    pub(super) fn remove(&mut self, [low, high]: [f64; 2]) -> bool {
        let mut number = 0;
        while number < self.left.len() {
            let [begin, end] = self.left[number];
            if low >= high || high <= begin || low >= end {
                number += 1;
                continue;
            }
            match (begin < low, high < end) {
                (true, true) => {
                    self.left[number] = [begin, low];
                    self.left.insert(number + 1, [high, end]);
                    number += 2;
                }
                (true, false) => {
                    self.left[number] = [begin, low];
                    number += 1;
                }
                (false, true) => {
                    self.left[number] = [high, end];
                    number += 1;
                }
                (false, false) => {
                    self.left.remove(number);
                }
            }
        }
        !self.left.is_empty()
    }
}

/// Which stretch of a line lies within a radius of an edge. `None` if none does of the part with the given length.
pub(super) fn line_in_capsule(
    from: Vector,
    direction: Vector,
    length: f64,
    edge: &Edge,
    radius: f64,
) -> Option<[f64; 2]> {
    let away = minus(from, edge.from);
    // How position along the edge, and distance from its line, grow along the line.
    let (s_rate, h_rate) = (dot(direction, edge.along), cross(edge.along, direction));
    let ends = [cross(edge.along, away), cross(edge.along, away) + length * h_rate];
    if ends.iter().all(|end| *end >= radius) || ends.iter().all(|end| *end <= -radius) {
        return None;
    }
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    // Around the two ends.
    let (foot, off) = (-dot(away, direction), cross(direction, away));
    for (foot, off) in [(foot, off), (foot + edge.length * s_rate, off + edge.length * h_rate)] {
        let squared = (radius - off) * (radius + off);
        if squared > 0.0 {
            let half = squared.sqrt();
            (low, high) = (low.min(foot - half), high.max(foot + half));
        }
    }
    // Between them.
    let side = within(dot(away, edge.along), s_rate, 0.0, edge.length);
    let strip = within(cross(edge.along, away), h_rate, -radius, radius);
    let (begin, end) = (side[0].max(strip[0]), side[1].min(strip[1]));
    if begin < end {
        (low, high) = (low.min(begin), high.max(end));
    }
    (low < high).then_some([low, high])
}

/// Where `start + t × rate` lies between two numbers.
fn within(start: f64, rate: f64, low: f64, high: f64) -> [f64; 2] {
    if rate == 0.0 {
        let is_inside = low < start && start < high;
        return if is_inside { [f64::NEG_INFINITY, f64::INFINITY] } else { [0.0, 0.0] };
    }
    let inverse = 1.0 / rate;
    let [a, b] = [(low - start) * inverse, (high - start) * inverse];
    [a.min(b), a.max(b)]
}

/// What part of a circle lies nearer to an edge than its radius.
pub(super) enum CircleCut {
    None,
    /// The two unit vectors from the centre to where it ends, and one between them.
    Some {
        ends: [Vector; 2],
        middle: Vector,
    },
    /// The centre lies on the edge, or rounding hides a crossing.
    Unknown,
}

/// What part of the circle around a centre lies nearer to an edge than its radius.
pub(super) fn circle_in_capsule(centre: Vector, edge: &Edge, radius: f64) -> CircleCut {
    let away = minus(centre, edge.from);
    // Position along the edge, and distance from its line.
    let [s, h] = [dot(away, edge.along), cross(edge.along, away)];
    let nearest = [s.clamp(0.0, edge.length) - s, -h];
    let distance = dot(nearest, nearest).sqrt();
    if distance >= 2.0 * radius {
        return CircleCut::None;
    }
    if distance <= 0.0 {
        return CircleCut::Unknown;
    }
    let middle = nearest.map(|part| part / distance);
    let mut ends = [None; 2];
    let mut see = |x: f64, y: f64| {
        let end = [x / radius, y / radius];
        ends[usize::from(cross(middle, end) > 0.0)] = Some(end);
    };
    for rise in [radius - h, -radius - h] {
        let squared = (radius - rise) * (radius + rise);
        if squared >= 0.0 {
            let half = squared.sqrt();
            [half, -half].into_iter().filter(|x| (0.0..=edge.length).contains(&(s + x))).for_each(|x| see(x, rise));
        }
    }
    for (end, is_low) in [(0.0, true), (edge.length, false)] {
        let to_end = [end - s, -h];
        let squared = dot(to_end, to_end);
        if squared > 0.0 && squared < 4.0 * radius * radius {
            let share = (radius * radius / squared - 0.25).max(0.0).sqrt();
            for share in [share, -share] {
                let [x, y] = [to_end[0] / 2.0 - to_end[1] * share, to_end[1] / 2.0 + to_end[0] * share];
                let is_beyond = if is_low { s + x <= 0.0 } else { s + x >= edge.length };
                if is_beyond {
                    see(x, y);
                }
            }
        }
    }
    let [Some(a), Some(b)] = ends else { return CircleCut::Unknown };
    let turned = |[x, y]: Vector| [x * edge.along[0] - y * edge.along[1], x * edge.along[1] + y * edge.along[0]];
    CircleCut::Some { ends: [turned(a), turned(b)], middle: turned(middle) }
}
