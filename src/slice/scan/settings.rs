//! How regions are filled. `pipeline` makes it from a recipe. `slice/scan` uses it.

/// How the regions of a layer are marked. All lengths are micrometres.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanSettings {
    /// Width of the melted track; greater than 0.
    pub beam_diameter_um: f64,
    /// Most that a contour may leave the border when points are left out; 0 keeps all points.
    pub simplify_tolerance_um: f64,
    /// Number of contours; 0 leaves the filling to the hatches.
    pub contour_count: u32,
    /// Distance from the border to the centre line of the outermost contour: the beam compensation. Half a beam makes a part of the
    /// right size.
    pub contour_offset_um: f64,
    /// Distance from one contour to the next; greater than 0.
    pub contour_spacing_um: f64,
    /// Where the region is narrower than this, a centre line or a point is marked instead of contours.
    pub thin_below_um: f64,
    /// Where it is narrower than this, it gets contours and no hatches.
    pub contour_only_below_um: f64,
    /// Shorter centre lines become points.
    pub point_below_um: f64,
    /// Shorter hatches are merged with a neighbour on the same line, or left out and counted.
    pub shortest_mark_um: f64,
    /// The filling; `None` leaves it out.
    pub hatch: Option<HatchSettings>,
    /// The filling where nothing lies above; `None` for the same as elsewhere.
    pub up_skin: Option<HatchSettings>,
    /// The filling where nothing lies below; `None` for the same as elsewhere.
    pub down_skin: Option<HatchSettings>,
}

/// How an area is filled with hatches. All lengths are micrometres.
#[derive(Clone, Debug, PartialEq)]
pub struct HatchSettings {
    /// In which pieces and directions.
    pub strategy: HatchStrategy,
    /// Distance from one line to the next; greater than 0.
    pub spacing_um: f64,
    /// Angle of the lines of layer 0 to the x axis, counter-clockwise, degrees.
    pub angle_deg: f64,
    /// By how much each layer's lines are turned against those of the layer below, degrees.
    pub rotation_deg: f64,
    /// Distance from the centre line of the innermost contour (or from the border, if there is none) to the ends of hatches.
    pub end_offset_um: f64,
}

/// In which pieces and directions an area is hatched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HatchStrategy {
    /// Each line against the direction of the one before.
    Zigzag,
    /// All lines in the same direction.
    Unidirectional,
    /// Zigzag in stripes along the lines' normal.
    Stripes {
        /// Width of a stripe: the longest hatch.
        width_um: f64,
        /// By how much neighbouring stripes overlap.
        overlap_um: f64,
    },
    /// Zigzag in squares whose lines are turned by a right angle from one to the next.
    Chessboard {
        /// Side of a square.
        island_um: f64,
        /// By how much neighbouring squares overlap.
        overlap_um: f64,
    },
}
