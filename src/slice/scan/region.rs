//! A connected piece of a layer. `slice/scan` shows what becomes of it.

/// A closed ring of at least three points, micrometres in the field. The first point is not repeated.
pub type Ring = Vec<[f64; 2]>;

/// A connected piece of a layer, with its holes. Rings do not cross or touch each other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Region {
    /// The outer ring, counter-clockwise.
    pub outer: Ring,
    /// The rings of the holes, clockwise.
    pub holes: Vec<Ring>,
}

impl Region {
    /// All rings: the outer one, then the holes.
    pub fn rings(&self) -> impl Iterator<Item = &Ring> {
        std::iter::once(&self.outer).chain(&self.holes)
    }

    /// Area without the holes, µm².
    pub fn area_um2(&self) -> f64 {
        self.rings().map(|ring| signed_area_um2(ring)).sum()
    }
}

/// Area that a ring encloses, µm²: positive if it runs counter-clockwise. The shoelace formula, from the first point, so that little is
/// lost to rounding far from the origin.
pub(super) fn signed_area_um2(ring: &[[f64; 2]]) -> f64 {
    let Some((first, rest)) = ring.split_first() else { return 0.0 };
    let from_first = |point: &[f64; 2]| [point[0] - first[0], point[1] - first[1]];
    let doubled = rest.windows(2).map(|pair| {
        let [a, b] = [from_first(&pair[0]), from_first(&pair[1])];
        a[0] * b[1] - a[1] * b[0]
    });
    doubled.sum::<f64>() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_are_taken_away() {
        let square = |low: f64, high: f64| vec![[low, low], [high, low], [high, high], [low, high]];
        let mut hole = square(1e6 + 10.0, 1e6 + 20.0);
        hole.reverse();
        let region = Region { outer: square(1e6, 1e6 + 100.0), holes: vec![hole] };
        assert!((region.area_um2() - 9900.0).abs() < 1e-6);
    }
}
