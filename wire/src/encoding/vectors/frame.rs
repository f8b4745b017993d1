//! The lines along which hatches lie. Encoder and decoder compute the same points of them, with whole numbers. [`track`](super::track) uses
//! them.

use super::MAX_FIELD_UM;

/// The lines along which hatches lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HatchFrame {
    /// A point of line 0, micrometres in the field; at most [`MAX_FIELD_UM`] from 0 along each axis.
    pub origin_um: [i32; 2],
    /// Unit vector along the lines, in units of 2⁻³⁰.
    pub along: [i32; 2],
    /// Distance from one line to the next, nanometres, at least 1000. Line 1 lies to the left of line 0.
    pub spacing_nm: u32,
}

/// Most distance from a frame's origin, along or across the lines, micrometres. From an origin in the field every point of the field
/// is nearer: a field's diagonal has at most 2.97 million.
pub(super) const MAX_DISTANCE_UM: i32 = 1 << 22;

/// Least distance between lines. Beams are some twenty times wider; and the number of a line in a field has at most 23 bits.
const MIN_SPACING_NM: u32 = 1000;

/// How much the square of the unit vector's length may differ from 2⁶⁰: rounding of both coordinates makes less than 2³¹.
const MAX_SQUARE_ERROR: u64 = 1 << 32;

impl HatchFrame {
    /// Whether every rule for frames holds.
    pub(super) fn is_usable(&self) -> bool {
        let near = |origin_um: i32| origin_um.unsigned_abs() <= MAX_FIELD_UM;
        // Each square is at most 2⁶².
        let [x, y] = self.along.map(|share| u64::from(share.unsigned_abs()));
        let is_unit = (x * x + y * y).abs_diff(1 << 60) <= MAX_SQUARE_ERROR;
        self.origin_um.into_iter().all(near) && is_unit && self.spacing_nm >= MIN_SPACING_NM
    }

    /// Distance of a line from line 0, nanometres; `None` if it is too far.
    pub(super) fn across_nm(&self, line: i32) -> Option<i64> {
        let across_nm = i64::from(line) * i64::from(self.spacing_nm);
        (across_nm.abs() <= i64::from(MAX_DISTANCE_UM) * 1000).then_some(across_nm)
    }

    /// The point at a distance along a line, rounded to whole micrometres. Both distances are
    /// limited to 4.2 m, which no line of a layer exceeds.
    pub fn point_um(&self, line: i32, along_um: i32) -> [i32; 2] {
        let most_nm = i64::from(MAX_DISTANCE_UM) * 1000;
        let across_nm = (i64::from(line) * i64::from(self.spacing_nm)).clamp(-most_nm, most_nm);
        self.point_across_um(across_nm, along_um.clamp(-MAX_DISTANCE_UM, MAX_DISTANCE_UM))
    }

    /// The same for a line that is given by its distance from line 0. Both distances are within [`MAX_DISTANCE_UM`].
    pub(super) fn point_across_um(&self, across_nm: i64, along_um: i32) -> [i32; 2] {
        let along_nm = i64::from(along_um) * 1000;
        // A share has at most 2³⁰ + 4, a distance 2²² × 1000, so both products and a half are below 2⁶³.
        let part = |along: i32, across: i32| {
            let scaled = i64::from(along) * along_nm + i64::from(across) * across_nm;
            ((scaled + (500 << 30)) >> 30).div_euclid(1000) as i32
        };
        let ([x, y], [ux, uy]) = (self.origin_um, self.along);
        [x + part(ux, -uy), y + part(uy, ux)]
    }
}
