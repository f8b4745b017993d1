//! How the layers of a part become scan vectors on a machine: the defaults of a recipe follow from the beam. `placed.rs` and `layerctl
//! slice` use it.

use crate::config::{SlmMachine, SlmRecipe, Strategy};
use crate::device::AxesMotion;
use crate::layer::{LaserParameters, MarkClass};
use crate::slice::scan::{HatchSettings, HatchStrategy, ScanSettings};

/// Where a laser marks, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Where the laser marks.
    pub settings: ScanSettings,
    /// The laser's parameters of each class, in the order of the classes' numbers.
    pub lasers: [LaserParameters; MarkClass::ALL.len()],
    /// Size of the field, micrometres.
    pub field_um: [u32; 2],
    /// The axes that move the beam; `None` for a scanner.
    pub axes: Option<AxesMotion>,
}

impl Scan {
    /// That of a recipe on a machine.
    pub fn of(machine: &SlmMachine, recipe: &SlmRecipe) -> Self {
        Self {
            settings: scan_settings(machine, recipe),
            lasers: laser_parameters(recipe),
            field_um: machine.field_um.map(|um| um.round() as u32),
            axes: machine.axes.as_ref().map(|axes| AxesMotion {
                max_speed_um_s: axes.max_speed_mm_s * 1000.0,
                acceleration_um_s2: axes.acceleration_mm_s2 * 1000.0,
                baud: machine.link.baud,
            }),
        }
    }
}

/// The settings of a recipe on a machine.
fn scan_settings(machine: &SlmMachine, recipe: &SlmRecipe) -> ScanSettings {
    let beam_um = machine.beam_diameter_um;
    let strategy = match recipe.hatch_strategy {
        Strategy::Zigzag => HatchStrategy::Zigzag,
        Strategy::Unidirectional => HatchStrategy::Unidirectional,
        Strategy::Stripes => {
            HatchStrategy::Stripes { width_um: recipe.stripe_width_um, overlap_um: recipe.stripe_overlap_um }
        }
        Strategy::Chessboard => {
            HatchStrategy::Chessboard { island_um: recipe.island_um, overlap_um: recipe.island_overlap_um }
        }
    };
    let hatch = |spacing_um| HatchSettings {
        strategy,
        spacing_um,
        angle_deg: recipe.hatch_angle_deg,
        rotation_deg: recipe.hatch_rotation_deg,
        end_offset_um: recipe.hatch_end_offset_um,
    };
    ScanSettings {
        beam_diameter_um: beam_um,
        simplify_tolerance_um: recipe.simplify_tolerance_um,
        contour_count: recipe.contour_count,
        contour_offset_um: recipe.contour_offset_um.unwrap_or(beam_um / 2.0),
        contour_spacing_um: recipe.contour_spacing_um.unwrap_or(beam_um),
        thin_below_um: recipe.thin_below_um.unwrap_or(2.0 * beam_um),
        contour_only_below_um: recipe.contour_only_below_um.unwrap_or(4.0 * beam_um),
        point_below_um: recipe.point_below_um.unwrap_or(beam_um / 2.0),
        shortest_mark_um: recipe.shortest_mark_um,
        hatch: Some(hatch(recipe.hatch_spacing_um)),
        up_skin: recipe.up_skin.as_ref().map(|skin| hatch(recipe.skin_spacing_um(skin))),
        down_skin: recipe.down_skin.as_ref().map(|skin| hatch(recipe.skin_spacing_um(skin))),
    }
}

/// The laser's parameters of each class, in the order of the classes' numbers.
fn laser_parameters(recipe: &SlmRecipe) -> [LaserParameters; MarkClass::ALL.len()] {
    // The recipe's limits keep all values far within 32 bits.
    let thousandths = |value: f64| (value * 1000.0).round() as u32;
    MarkClass::ALL.map(|class| {
        let laser = recipe.laser(class);
        LaserParameters {
            power_mw: thousandths(laser.power_w),
            mark_speed_um_s: thousandths(laser.mark_speed_mm_s),
            jump_speed_um_s: thousandths(laser.jump_speed_mm_s),
            focus_um: laser.focus_um.round() as i32,
            jump_delay_us: laser.jump_delay_us,
            mark_delay_us: laser.mark_delay_us,
            polygon_delay_us: laser.polygon_delay_us,
            point_time_us: laser.point_time_us,
        }
    })
}
