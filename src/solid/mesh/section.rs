//! Where a plane cuts a triangle. `rows` crosses the segments.

/// A triangle: its corners counter-clockwise, seen from outside. Any unit of length.
pub(crate) type Facet = [[f64; 3]; 3];

/// A plane of constant z, and the grid of pixels on it, in the unit of the facets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SectionPlane {
    /// Height.
    pub(crate) z: f64,
    /// Centre of the first pixel.
    pub(crate) origin: [f64; 2],
    /// From one pixel centre to the next along a row, and along a column. Negative if mirrored.
    pub(crate) step: [f64; 2],
}

/// A directed line in a plane, in pixels: column and row, counted from the centre of the first pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    pub(crate) from: [f64; 2],
    pub(crate) to: [f64; 2],
}

impl SectionPlane {
    /// Where the plane cuts a facet; `None` if all corners lie on one side. A corner in the plane counts as above it.
    ///
    /// The solid lies to the left of the segment, where columns run to the right and rows up; to the right if just one of both is mirrored.
    #[inline]
    pub(crate) fn cut(&self, facet: &Facet) -> Option<Segment> {
        let [a, b, c] = facet;
        let is_above = |corner: &[f64; 3]| corner[2] >= self.z;
        let above = [is_above(a), is_above(b), is_above(c)];
        // The corner that is alone on its side of the plane, and the others in order.
        let (alone, is_peak, [after, before]) = match above {
            [true, true, true] | [false, false, false] => return None,
            [is_peak, second, third] if second == third => (a, is_peak, [b, c]),
            [first, is_peak, third] if first == third => (b, is_peak, [c, a]),
            [_, _, is_peak] => (c, is_peak, [a, b]),
        };
        Some(if is_peak {
            Segment { from: self.crossing(after, alone), to: self.crossing(before, alone) }
        } else {
            Segment { from: self.crossing(alone, before), to: self.crossing(alone, after) }
        })
    }

    /// Where the plane crosses an edge, from its end below the plane to the one above.
    fn crossing(&self, low: &[f64; 3], high: &[f64; 3]) -> [f64; 2] {
        // All edges that end in the plane at one corner meet there exactly, whatever rounding does.
        let [x, y] = if high[2] == self.z {
            [high[0], high[1]]
        } else {
            let share = (self.z - low[2]) / (high[2] - low[2]);
            [low[0] + share * (high[0] - low[0]), low[1] + share * (high[1] - low[1])]
        };
        [(x - self.origin[0]) / self.step[0], (y - self.origin[1]) / self.step[1]]
    }

    /// Whether the solid lies to the right of segments instead of the left.
    pub(crate) fn is_mirrored(&self) -> bool {
        (self.step[0] < 0.0) != (self.step[1] < 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANE: SectionPlane = SectionPlane { z: 1.0, origin: [0.0; 2], step: [1.0; 2] };

    #[test]
    fn the_solid_lies_to_the_left() {
        // Seen from outside, from large x, y runs to the right.
        let facet = [[5.0, 0.0, 0.0], [5.0, 2.0, 0.0], [5.0, 1.0, 2.0]];
        assert_eq!(PLANE.cut(&facet), Some(Segment { from: [5.0, 0.5], to: [5.0, 1.5] }));
        assert_eq!(PLANE.cut(&facet.map(|[x, y, z]| [x, y, z + 1.5])), None);
    }

    #[test]
    fn a_corner_in_the_plane_is_above_it() {
        let peak = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.3, 0.7, 1.0]];
        let Segment { from, to } = PLANE.cut(&peak).expect("it is cut at its corner");
        assert_eq!((from, to), ([0.3, 0.7], [0.3, 0.7]));
        assert_eq!(PLANE.cut(&peak.map(|[x, y, z]| [x, y, 2.0 - z])), None, "all of it is above");
    }
}
