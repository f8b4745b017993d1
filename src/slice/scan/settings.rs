//! How regions are filled. `pipeline` makes it from a recipe. `slice/scan` uses it.

use crate::layer::MarkClass;

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
    /// Where it is narrower than this, it gets no hatches; contours fill it to the middle, however many `contour_count` asks for.
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

/// A length of the settings that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {found}: it must be {range}")]
pub struct SettingsError {
    name: &'static str,
    found: f64,
    range: String,
}

/// Longest of the lengths that belong to a beam, micrometres. Beams are below 1 mm wide; larger lengths are mistakes.
const MAX_LENGTH_UM: f64 = 10_000.0;

/// Smallest spacing, micrometres: the unit of vectors. A smaller one asks for memory and time for lines that lie on each other.
const MIN_SPACING_UM: f64 = 1.0;

/// Most contours: more than fill the widest part at 1 µm spacing that any setting calls narrow.
const MAX_CONTOURS: f64 = 10_000.0;

impl ScanSettings {
    /// Whether the filling depends on the layers above and below.
    pub fn has_skins(&self) -> bool {
        self.up_skin.is_some() || self.down_skin.is_some()
    }

    /// The classes that vectors may have, in the order of their numbers.
    pub fn classes(&self) -> Vec<MarkClass> {
        let occurs = |class: &MarkClass| match class {
            MarkClass::Hatch => self.hatch.is_some(),
            MarkClass::UpSkin => self.up_skin.is_some(),
            MarkClass::DownSkin => self.down_skin.is_some(),
            MarkClass::Contour | MarkClass::Thin | MarkClass::Point => true,
        };
        MarkClass::ALL.into_iter().filter(occurs).collect()
    }

    /// Whether all lengths can be used.
    pub fn check(&self) -> Result<(), SettingsError> {
        within("beam_diameter_um", self.beam_diameter_um, MIN_SPACING_UM, MAX_LENGTH_UM)?;
        within("simplify_tolerance_um", self.simplify_tolerance_um, 0.0, MAX_LENGTH_UM)?;
        within("contour_count", f64::from(self.contour_count), 0.0, MAX_CONTOURS)?;
        within("contour_offset_um", self.contour_offset_um, 0.0, MAX_LENGTH_UM)?;
        within("contour_spacing_um", self.contour_spacing_um, MIN_SPACING_UM, MAX_LENGTH_UM)?;
        within("thin_below_um", self.thin_below_um, 0.0, MAX_LENGTH_UM)?;
        within("contour_only_below_um", self.contour_only_below_um, 0.0, MAX_LENGTH_UM)?;
        within("point_below_um", self.point_below_um, 0.0, MAX_LENGTH_UM)?;
        within("shortest_mark_um", self.shortest_mark_um, 0.0, MAX_LENGTH_UM)?;
        [&self.hatch, &self.up_skin, &self.down_skin].into_iter().flatten().try_for_each(HatchSettings::check)
    }
}

impl HatchSettings {
    fn check(&self) -> Result<(), SettingsError> {
        within("spacing_um", self.spacing_um, MIN_SPACING_UM, MAX_LENGTH_UM)?;
        within("angle_deg", self.angle_deg, -360.0, 360.0)?;
        within("rotation_deg", self.rotation_deg, -360.0, 360.0)?;
        within("end_offset_um", self.end_offset_um, 0.0, MAX_LENGTH_UM)?;
        match self.strategy {
            HatchStrategy::Zigzag | HatchStrategy::Unidirectional => Ok(()),
            HatchStrategy::Stripes { width_um, overlap_um } => cells("width_um", width_um, overlap_um, self.spacing_um),
            HatchStrategy::Chessboard { island_um, overlap_um } => {
                cells("island_um", island_um, overlap_um, self.spacing_um)
            }
        }
    }
}

/// Checks the size of stripes or squares, and that they overlap their neighbours alone.
fn cells(name: &'static str, size_um: f64, overlap_um: f64, spacing_um: f64) -> Result<(), SettingsError> {
    within(name, size_um, spacing_um, super::MAX_FIELD_UM)?;
    within("overlap_um", overlap_um, 0.0, size_um / 2.0)
}

fn within(name: &'static str, found: f64, low: f64, high: f64) -> Result<(), SettingsError> {
    // Not a number is in no range.
    if (low..=high).contains(&found) {
        return Ok(());
    }
    Err(SettingsError { name, found, range: format!("from {low} to {high}") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mistakes_are_told_with_name_value_and_range() {
        let hatch = HatchSettings {
            strategy: HatchStrategy::Stripes { width_um: 5000.0, overlap_um: 100.0 },
            spacing_um: 80.0,
            angle_deg: 57.0,
            rotation_deg: 67.0,
            end_offset_um: 40.0,
        };
        let good = ScanSettings {
            beam_diameter_um: 80.0,
            simplify_tolerance_um: 5.0,
            contour_count: 1,
            contour_offset_um: 40.0,
            contour_spacing_um: 80.0,
            thin_below_um: 160.0,
            contour_only_below_um: 320.0,
            point_below_um: 80.0,
            shortest_mark_um: 40.0,
            hatch: Some(hatch.clone()),
            up_skin: None,
            down_skin: None,
        };
        assert_eq!(good.check(), Ok(()));
        let told = |settings: ScanSettings| settings.check().expect_err("a mistake").to_string();
        let bad = ScanSettings { contour_spacing_um: 0.0, ..good.clone() };
        assert_eq!(told(bad), "contour_spacing_um is 0: it must be from 1 to 10000");
        let bad = ScanSettings { beam_diameter_um: f64::NAN, ..good.clone() };
        assert_eq!(told(bad), "beam_diameter_um is NaN: it must be from 1 to 10000");
        let strategy = HatchStrategy::Chessboard { island_um: 1000.0, overlap_um: 600.0 };
        let bad = ScanSettings { up_skin: Some(HatchSettings { strategy, ..hatch }), ..good };
        assert_eq!(told(bad), "overlap_um is 600: it must be from 0 to 500");
    }
}
