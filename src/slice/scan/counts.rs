//! What became of the regions of a layer. `fill` counts, `pipeline` and `layerctl check` tell.

/// What became of the regions of a layer. Nothing is left out that is not counted here.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScanCounts {
    /// Regions.
    pub regions: u64,
    /// Regions, or parts that a region falls into, without a mark.
    pub unmarked: u64,
    /// Thin parts marked along a centre line.
    pub centre_lines: u64,
    /// Thin parts marked with a point.
    pub points: u64,
    /// Parts that are too narrow for hatches and have contours only.
    pub contours_only: u64,
    /// Hatches that were too short and became part of a neighbour on the same line.
    pub merged_hatches: u64,
    /// Hatches that were too short and are left out.
    pub dropped_hatches: u64,
    /// Length of all jumps in the order in which the regions came, micrometres.
    pub unordered_jump_um: f64,
    /// Length of all jumps in the order in which the layer is marked, micrometres.
    pub jump_um: f64,
    /// Length of all vectors, micrometres.
    pub mark_um: f64,
}

impl std::ops::AddAssign for ScanCounts {
    fn add_assign(&mut self, other: Self) {
        self.regions += other.regions;
        self.unmarked += other.unmarked;
        self.centre_lines += other.centre_lines;
        self.points += other.points;
        self.contours_only += other.contours_only;
        self.merged_hatches += other.merged_hatches;
        self.dropped_hatches += other.dropped_hatches;
        self.unordered_jump_um += other.unordered_jump_um;
        self.jump_um += other.jump_um;
        self.mark_um += other.mark_um;
    }
}
