//! Puts the pieces of an offset border together: into rings, and these into shapes. `trim` makes the pieces.
//!
//! Each piece begins where another ends. If one has no other (rounding, or a border that touches itself), there is no result, and `offset`
//! asks the library.

use super::border::{Vector, along, dot, minus};
use super::convex::{arc, least_cosine, rounded};
use super::offset::{Contour, LEAST_AREA_NM2, Point, doubled_area_nm2, doubled_triangle_nm2};
use super::path::ring_edges;

/// How far the end of a piece may lie from the beginning of the next, nanometres. Rounding makes it some thousandths. It is more where the
/// border bends by less than a ten thousandth of a degree, because a corner then looks like a straight line.
const TOUCH_NM: f64 = 4.0;

/// What is left of an edge that was moved, or of an arc around its end. There may be two for each edge of a large region, so it is small.
pub(super) struct Piece {
    pub(super) from: Vector,
    pub(super) to: Vector,
    /// Number of an arc; [`NONE`] for a line.
    pub(super) arc: u32,
    /// Whether it begins or ends where the line or arc does.
    pub(super) is_whole: [bool; 2],
    /// Number of the line or arc, and of the next one on the ring.
    pub(super) place: u32,
    pub(super) after: u32,
    pub(super) next: u32,
}

/// No piece yet, or no arc.
pub(super) const NONE: u32 = u32::MAX;

/// What is left of an arc.
pub(super) struct Arc {
    pub(super) centre: Vector,
    /// Unit vectors from the centre to its ends.
    pub(super) ends: [Vector; 2],
}

/// All pieces of one offset.
pub(super) struct Pieces {
    pub(super) pieces: Vec<Piece>,
    pub(super) arcs: Vec<Arc>,
}

/// What the pieces of one offset have in common. Lengths are nanometres.
pub(super) struct Stitcher {
    /// Distance of the offset: the radius of the arcs.
    pub(super) radius: f64,
    /// 1 if the arcs turn to the right, -1 if to the left.
    pub(super) side: f64,
    /// Most by which an arc may leave its circle.
    pub(super) error: f64,
    /// Where places are measured from.
    pub(super) origin: Point,
}

impl Stitcher {
    /// The shapes, each an outer ring and its holes. `None` if the pieces do not fit together.
    pub(super) fn shapes(&self, Pieces { mut pieces, arcs }: Pieces) -> Option<Vec<Vec<Contour>>> {
        link(&mut pieces)?;
        nest(self.rings(&pieces, &arcs))
    }

    /// The rings that the pieces make.
    fn rings(&self, pieces: &[Piece], arcs: &[Arc]) -> Vec<Contour> {
        let least = least_cosine(self.radius, self.error);
        let mut rings = Vec::new();
        let mut is_done = vec![false; pieces.len()];
        let mut points = Vec::new();
        for first in 0..pieces.len() {
            points.clear();
            let mut at = first;
            let mut is_begun = false;
            // Whether the piece before goes on to this one without a cut.
            let mut follows = false;
            while !std::mem::replace(&mut is_done[at], true) {
                let piece = &pieces[at];
                let is_followed = Self::is_followed(pieces, at);
                // A piece ends where the next begins.
                if !std::mem::take(&mut is_begun) {
                    points.push(piece.from);
                }
                if let Some(&Arc { centre, ends: [begin, end] }) = arcs.get(piece.arc as usize) {
                    let corner = if follows && is_followed { self.corner(begin, end) } else { None };
                    if let Some(corner) = corner {
                        points.pop();
                        points.push(along(centre, corner, self.radius));
                        is_begun = true;
                    } else {
                        let mut push = |normal| points.push(along(centre, normal, self.radius));
                        arc(begin, end, least, -self.side, &mut push);
                    }
                }
                follows = is_followed;
                at = piece.next as usize;
            }
            if is_begun {
                // The last corner replaces the first point.
                points.swap_remove(0);
            }
            if points.len() > 2 {
                rings.push(rounded(self.origin, &points));
            }
        }
        rings
    }

    /// Whether a piece goes on to the next without a cut.
    fn is_followed(pieces: &[Piece], at: usize) -> bool {
        let (piece, next) = (&pieces[at], &pieces[pieces[at].next as usize]);
        piece.is_whole[1] && next.is_whole[0] && next.place == piece.after
    }

    /// Where the lines on both sides of a whole arc meet, in radii from its centre, if that is hardly outside the circle. One point then
    /// takes the place of two, and an offset of an offset does not have ever more points.
    fn corner(&self, begin: Vector, end: Vector) -> Option<Vector> {
        let squared = (1.0 + dot(begin, end)) / 2.0;
        let is_flat = self.radius * self.radius <= (self.radius + self.error) * (self.radius + self.error) * squared;
        is_flat.then(|| [0, 1].map(|axis| (begin[axis] + end[axis]) / (2.0 * squared)))
    }
}

/// Finds the piece behind each. `None` if one has none.
fn link(pieces: &mut [Piece]) -> Option<()> {
    // Those that begin where their line or arc does are behind the one before, if that is whole at its end.
    let places = pieces.iter().map(|piece| piece.place as usize + 1).max().unwrap_or(0);
    let mut first_at = vec![NONE; places];
    for (number, piece) in pieces.iter().enumerate() {
        if piece.is_whole[0] {
            first_at[piece.place as usize] = number as u32;
        }
    }
    let mut is_taken = vec![false; pieces.len()];
    for number in 0..pieces.len() {
        let piece = &pieces[number];
        let next = first_at.get(piece.after as usize).copied().unwrap_or(NONE);
        if piece.is_whole[1] && next != NONE && squared(piece.to, pieces[next as usize].from) <= TOUCH_NM * TOUCH_NM {
            is_taken[next as usize] = true;
            pieces[number].next = next;
        }
    }
    let mut starts: Vec<u32> = (0..pieces.len() as u32).filter(|number| !is_taken[*number as usize]).collect();
    starts.sort_unstable_by(|a, b| {
        let x = |number: u32| pieces[number as usize].from[0];
        x(*a).total_cmp(&x(*b)).then(a.cmp(b))
    });
    for number in 0..pieces.len() {
        if pieces[number].next != NONE {
            continue;
        }
        let to = pieces[number].to;
        let begin = starts.partition_point(|start| pieces[*start as usize].from[0] < to[0] - TOUCH_NM);
        let near = starts[begin..].iter().take_while(|start| pieces[**start as usize].from[0] <= to[0] + TOUCH_NM);
        let free = near.filter(|start| !is_taken[**start as usize]);
        let distances = free.map(|start| (squared(pieces[*start as usize].from, to), *start));
        let (nearest, next) = distances.min_by(|a, b| a.0.total_cmp(&b.0))?;
        if nearest > TOUCH_NM * TOUCH_NM {
            return None;
        }
        is_taken[next as usize] = true;
        pieces[number].next = next;
    }
    Some(())
}

/// Square of the distance, square nanometres.
fn squared(a: Vector, b: Vector) -> f64 {
    let away = minus(a, b);
    dot(away, away)
}

/// Puts holes into the rings around them. `None` if a hole lies in no ring.
fn nest(rings: Vec<Contour>) -> Option<Vec<Vec<Contour>>> {
    let least = 2 * LEAST_AREA_NM2 as i64;
    let mut shapes: Vec<Vec<Contour>> = Vec::new();
    let mut sizes = Vec::new();
    let mut holes = Vec::new();
    for ring in rings {
        let doubled = doubled_area_nm2(&ring);
        if doubled > least {
            shapes.push(vec![ring]);
            sizes.push(doubled);
        } else if doubled < -least {
            holes.push(ring);
        }
    }
    for hole in holes {
        let around = (0..shapes.len()).filter(|number| is_inside(&shapes[*number][0], hole[0]));
        let smallest = around.min_by_key(|number| sizes[*number])?;
        shapes[smallest].push(hole);
    }
    Some(shapes)
}

/// Whether a ring goes around a point.
fn is_inside(ring: &[Point], point: Point) -> bool {
    let crossings = ring_edges(ring).filter(|[a, b]| {
        (a.y <= point.y) != (b.y <= point.y) && (doubled_triangle_nm2(point, *a, *b) > 0) == (b.y > a.y)
    });
    crossings.count() % 2 == 1
}
