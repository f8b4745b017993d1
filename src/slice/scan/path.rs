//! Lines and rings: edges, length, and fewer points. `pieces`, `thin` and `middle` use them.

/// How many points of a line one segment may replace, so that the work for a point is bounded.
const MAX_REPLACED: usize = 64;

/// The edges of a ring that does not repeat its first point: from each point to the next, and from the last to the first.
pub(super) fn ring_edges<T: Copy>(ring: &[T]) -> impl Iterator<Item = [T; 2]> + '_ {
    let next = ring.iter().cycle().skip(1);
    ring.iter().zip(next).map(|(a, b)| [*a, *b])
}

/// Distance from one point to another, micrometres.
pub(super) fn distance_um(a: [f64; 2], b: [f64; 2]) -> f64 {
    // Faster than `hypot`; no place is so far away that a square is out of range.
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    (x * x + y * y).sqrt()
}

/// Length of a line, micrometres.
pub(super) fn length_um(line: &[[f64; 2]]) -> f64 {
    line.windows(2).map(|pair| distance_um(pair[0], pair[1])).sum()
}

/// Leaves out points of a line that are at most `tolerance_um` away from the segments that remain. The ends stay; of a ring, which repeats
/// its first point, at least a triangle.
pub(super) fn simplify(line: &mut Vec<[f64; 2]>, tolerance_um: f64) {
    let is_ring = line.len() > 3 && line.first() == line.last();
    let least = if is_ring { 4 } else { 2 };
    let mut kept = 0;
    let mut at = 0;
    while at + 1 < line.len() {
        let begin = line[at];
        let farthest = (line.len() - 1).min(at + MAX_REPLACED);
        let fits =
            |end: &usize| line[at + 1..*end].iter().all(|point| off_um(*point, begin, line[*end]) <= tolerance_um);
        // A ring must not become a line there and back.
        let enough = |end: &usize| kept + 1 + line.len() - end >= least;
        let end = (at + 2..=farthest).take_while(fits).filter(enough).last().unwrap_or(at + 1);
        line[kept] = begin;
        kept += 1;
        at = end;
    }
    if let Some(last) = line.last().copied() {
        line[kept] = last;
        line.truncate(kept + 1);
    }
}

/// Distance from a point to a segment.
fn off_um(point: [f64; 2], begin: [f64; 2], end: [f64; 2]) -> f64 {
    let [x, y] = [end[0] - begin[0], end[1] - begin[1]];
    let [px, py] = [point[0] - begin[0], point[1] - begin[1]];
    let squared = x * x + y * y;
    let share = if squared > 0.0 { ((px * x + py * y) / squared).clamp(0.0, 1.0) } else { 0.0 };
    let [x, y] = [px - x * share, py - y * share];
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_line_are_left_out_and_corners_stay() {
        let mut line = vec![[0.0, 0.0], [10.0, 0.4], [20.0, 0.0], [20.0, 20.0], [20.3, 30.0], [20.0, 40.0]];
        simplify(&mut line, 0.5);
        assert_eq!(line, [[0.0, 0.0], [20.0, 0.0], [20.0, 40.0]]);
    }

    #[test]
    fn a_small_ring_stays_a_ring() {
        let ring = [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5], [0.0, 0.0]];
        let mut line = ring.to_vec();
        simplify(&mut line, 5.0);
        assert!(line.len() >= 4 && line.first() == line.last(), "{line:?}");
    }
}
