//! A recipe for SLM machines. `config/recipes/slm-demo.toml` explains its keys.

use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::config::{Axes, OutOfRange, SlmMachine, within};
use crate::layer::MarkClass;

/// Largest distance between hatches, micrometres: ten of the widest beams.
const MAX_SPACING_UM: f64 = 10_000.0;

/// A recipe for an SLM machine: where the laser marks, and how.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlmRecipe {
    /// For people.
    pub name: String,
    /// Read before, to know which keys there are.
    #[serde(rename = "kind")]
    _kind: IgnoredAny,
    /// Layer height, micrometres.
    pub layer_height_um: f64,

    /// Power, watts.
    pub laser_power_w: f64,
    /// Speed of marks, millimetres a second.
    pub mark_speed_mm_s: f64,
    /// Speed of jumps, millimetres a second.
    pub jump_speed_mm_s: f64,
    /// Height of the focus above the powder, micrometres.
    #[serde(default)]
    pub focus_um: f64,
    /// Wait after a jump, microseconds.
    #[serde(default)]
    pub jump_delay_us: u32,
    /// Wait after the last mark before a jump, microseconds.
    #[serde(default)]
    pub mark_delay_us: u32,
    /// Wait between two marks that follow each other, microseconds.
    #[serde(default)]
    pub polygon_delay_us: u32,
    /// How long the laser stands still on a point, microseconds.
    #[serde(default = "half_a_millisecond")]
    pub point_time_us: u32,

    /// Number of contours.
    #[serde(default = "one")]
    pub contour_count: u32,
    /// Distance from the part's border to the centre line of the outermost contour, micrometres. Half a beam by default.
    pub contour_offset_um: Option<f64>,
    /// Distance from one contour to the next, micrometres. A beam by default.
    pub contour_spacing_um: Option<f64>,
    /// Most that a contour may leave the part's border when points are left out, micrometres.
    #[serde(default = "five")]
    pub simplify_tolerance_um: f64,
    /// Narrower parts get a centre line or a point, micrometres. Two beams by default.
    pub thin_below_um: Option<f64>,
    /// Narrower parts get contours only, micrometres. Four beams by default.
    pub contour_only_below_um: Option<f64>,
    /// Shorter centre lines become points, micrometres. Half a beam by default.
    pub point_below_um: Option<f64>,
    /// Shorter hatches are merged or left out, micrometres.
    #[serde(default = "twenty")]
    pub shortest_mark_um: f64,

    /// In which pieces and directions areas are filled.
    pub hatch_strategy: Strategy,
    /// Distance from one hatch to the next, micrometres.
    pub hatch_spacing_um: f64,
    /// Angle of layer 0's hatches to the x axis, counter-clockwise, degrees.
    #[serde(default)]
    pub hatch_angle_deg: f64,
    /// By how much each layer's hatches are turned against the layer below, degrees.
    #[serde(default = "sixty_seven")]
    pub hatch_rotation_deg: f64,
    /// Distance from the centre line of the innermost contour to the ends of the hatches, micrometres. By default they end on it: with
    /// half a beam, narrow parts of a lattice keep 2 % more of their powder.
    #[serde(default)]
    pub hatch_end_offset_um: f64,
    /// Width of a stripe, micrometres.
    #[serde(default = "five_millimetres")]
    pub stripe_width_um: f64,
    /// By how much stripes overlap, micrometres.
    #[serde(default = "hundred")]
    pub stripe_overlap_um: f64,
    /// Side of a square of the chessboard, micrometres.
    #[serde(default = "five_millimetres")]
    pub island_um: f64,
    /// By how much squares overlap, micrometres.
    #[serde(default = "hundred")]
    pub island_overlap_um: f64,

    /// Speed of the plate, micrometres a second.
    #[serde(default = "plate_speed")]
    pub plate_speed_um_s: u32,
    /// Wait after the recoater has passed, milliseconds.
    #[serde(default)]
    pub wait_after_recoat_ms: u32,

    /// Of the contours alone.
    #[serde(default)]
    pub contour: ClassSettings,
    /// Of the hatches alone.
    #[serde(default)]
    pub hatch: ClassSettings,
    /// Of the areas with nothing above; if it is absent, they are filled like the others.
    pub up_skin: Option<ClassSettings>,
    /// Of the areas with nothing below; if it is absent, they are filled like the others.
    pub down_skin: Option<ClassSettings>,
    /// Of the centre lines alone.
    #[serde(default)]
    pub thin: ClassSettings,
    /// Of the points alone.
    #[serde(default)]
    pub point: ClassSettings,
}

/// In which pieces and directions an area is filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Strategy {
    /// Each line against the direction of the one before.
    Zigzag,
    /// All lines in the same direction.
    Unidirectional,
    /// Zigzag in stripes.
    Stripes,
    /// Zigzag in squares, turned by a right angle from one to the next.
    Chessboard,
}

/// What one class of vectors has of its own; the rest is as in the recipe.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassSettings {
    laser_power_w: Option<f64>,
    mark_speed_mm_s: Option<f64>,
    jump_speed_mm_s: Option<f64>,
    focus_um: Option<f64>,
    jump_delay_us: Option<u32>,
    mark_delay_us: Option<u32>,
    polygon_delay_us: Option<u32>,
    point_time_us: Option<u32>,
    /// Only of skins.
    hatch_spacing_um: Option<f64>,
}

/// The laser's parameters for one class of vectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaserSettings {
    /// Power, watts.
    pub power_w: f64,
    /// Speed of marks, millimetres a second.
    pub mark_speed_mm_s: f64,
    /// Speed of jumps, millimetres a second.
    pub jump_speed_mm_s: f64,
    /// Height of the focus above the powder, micrometres.
    pub focus_um: f64,
    /// Wait after a jump, microseconds.
    pub jump_delay_us: u32,
    /// Wait after the last mark before a jump, microseconds.
    pub mark_delay_us: u32,
    /// Wait between two marks that follow each other, microseconds.
    pub polygon_delay_us: u32,
    /// How long the laser stands still on a point, microseconds.
    pub point_time_us: u32,
}

fn one() -> u32 {
    1
}

fn five() -> f64 {
    5.0
}

fn twenty() -> f64 {
    20.0
}

fn sixty_seven() -> f64 {
    67.0
}

fn hundred() -> f64 {
    100.0
}

fn five_millimetres() -> f64 {
    5000.0
}

fn half_a_millisecond() -> u32 {
    500
}

fn plate_speed() -> u32 {
    2000
}

impl SlmRecipe {
    /// The laser's parameters for a class of vectors.
    pub fn laser(&self, class: MarkClass) -> LaserSettings {
        let none = ClassSettings::default();
        let own = match class {
            MarkClass::Contour => &self.contour,
            MarkClass::Hatch => &self.hatch,
            MarkClass::UpSkin => self.up_skin.as_ref().unwrap_or(&none),
            MarkClass::DownSkin => self.down_skin.as_ref().unwrap_or(&none),
            MarkClass::Thin => &self.thin,
            MarkClass::Point => &self.point,
        };
        LaserSettings {
            power_w: own.laser_power_w.unwrap_or(self.laser_power_w),
            mark_speed_mm_s: own.mark_speed_mm_s.unwrap_or(self.mark_speed_mm_s),
            jump_speed_mm_s: own.jump_speed_mm_s.unwrap_or(self.jump_speed_mm_s),
            focus_um: own.focus_um.unwrap_or(self.focus_um),
            jump_delay_us: own.jump_delay_us.unwrap_or(self.jump_delay_us),
            mark_delay_us: own.mark_delay_us.unwrap_or(self.mark_delay_us),
            polygon_delay_us: own.polygon_delay_us.unwrap_or(self.polygon_delay_us),
            point_time_us: own.point_time_us.unwrap_or(self.point_time_us),
        }
    }

    /// Distance between the hatches of a skin, micrometres.
    pub fn skin_spacing_um(&self, skin: &ClassSettings) -> f64 {
        skin.hatch_spacing_um.unwrap_or(self.hatch_spacing_um)
    }

    pub(super) fn check(&self) -> Vec<OutOfRange> {
        let optional =
            |key: &str, value: Option<f64>, low: f64, high: f64| value.and_then(|value| within(key, value, low, high));
        // What `slice/scan` fills with: lengths that belong to a beam are at most ten of the widest beams, and hatches end inside.
        // Moves are limited so that a typing error cannot take hours.
        [
            within("layer_height_um", self.layer_height_um, 1.0, 1000.0),
            within("contour_count", self.contour_count, 0, 100),
            optional("contour_offset_um", self.contour_offset_um, 0.0, 1000.0),
            optional("contour_spacing_um", self.contour_spacing_um, 1.0, 10_000.0),
            within("simplify_tolerance_um", self.simplify_tolerance_um, 0.0, 1000.0),
            optional("thin_below_um", self.thin_below_um, 0.0, 10_000.0),
            optional("contour_only_below_um", self.contour_only_below_um, 0.0, 10_000.0),
            optional("point_below_um", self.point_below_um, 0.0, 10_000.0),
            within("shortest_mark_um", self.shortest_mark_um, 0.0, 10_000.0),
            within("hatch_spacing_um", self.hatch_spacing_um, 1.0, MAX_SPACING_UM),
            within("hatch_angle_deg", self.hatch_angle_deg, -360.0, 360.0),
            within("hatch_rotation_deg", self.hatch_rotation_deg, -360.0, 360.0),
            within("hatch_end_offset_um", self.hatch_end_offset_um, 0.0, 10_000.0),
            within("stripe_width_um", self.stripe_width_um, self.least_cell_um(Strategy::Stripes), 1_000_000.0),
            within("stripe_overlap_um", self.stripe_overlap_um, 0.0, self.stripe_width_um / 2.0),
            within("island_um", self.island_um, self.least_cell_um(Strategy::Chessboard), 1_000_000.0),
            within("island_overlap_um", self.island_overlap_um, 0.0, self.island_um / 2.0),
            within("plate_speed_um_s", self.plate_speed_um_s, 10, 1_000_000),
            within("wait_after_recoat_ms", self.wait_after_recoat_ms, 0, 600_000),
        ]
        .into_iter()
        .flatten()
        .chain(self.of_all_classes().check(""))
        .chain(self.tables().into_iter().flat_map(|(table, class)| class.check(&format!("{table}."))))
        .chain(self.misplaced_spacings())
        .collect()
    }

    /// Least width of a stripe or square: a hatch must fit into it if the areas are filled with them.
    fn least_cell_um(&self, strategy: Strategy) -> f64 {
        const LEAST_UM: f64 = 100.0;
        if self.hatch_strategy != strategy {
            return LEAST_UM;
        }
        let skins = [&self.up_skin, &self.down_skin].into_iter().flatten().map(|skin| self.skin_spacing_um(skin));
        // A spacing beyond its own range is told alone.
        skins.chain([self.hatch_spacing_um]).fold(LEAST_UM, f64::max).min(MAX_SPACING_UM)
    }

    /// The laser's parameters that classes without their own have.
    fn of_all_classes(&self) -> ClassSettings {
        ClassSettings {
            laser_power_w: Some(self.laser_power_w),
            mark_speed_mm_s: Some(self.mark_speed_mm_s),
            jump_speed_mm_s: Some(self.jump_speed_mm_s),
            focus_um: Some(self.focus_um),
            jump_delay_us: Some(self.jump_delay_us),
            mark_delay_us: Some(self.mark_delay_us),
            polygon_delay_us: Some(self.polygon_delay_us),
            point_time_us: Some(self.point_time_us),
            hatch_spacing_um: None,
        }
    }

    /// The tables of classes that are there, with their names.
    fn tables(&self) -> Vec<(&'static str, &ClassSettings)> {
        let always = [("contour", &self.contour), ("hatch", &self.hatch), ("thin", &self.thin), ("point", &self.point)];
        let skins = [("up_skin", self.up_skin.as_ref()), ("down_skin", self.down_skin.as_ref())];
        let skins = skins.into_iter().filter_map(|(table, class)| Some((table, class?)));
        always.into_iter().chain(skins).collect()
    }

    /// Skins alone may have a spacing of their own.
    fn misplaced_spacings(&self) -> impl Iterator<Item = OutOfRange> {
        self.tables().into_iter().filter(|(table, _)| !table.ends_with("skin")).filter_map(|(table, class)| {
            let value = class.hatch_spacing_um?;
            let allowed = "nothing here: only up_skin and down_skin have a spacing of their own".into();
            Some(OutOfRange { key: format!("{table}.hatch_spacing_um"), value: value.to_string(), allowed })
        })
    }

    /// What of the recipe is beyond a machine's limits.
    pub(super) fn check_for(&self, machine: &SlmMachine) -> Vec<OutOfRange> {
        let [low_um, high_um] = machine.layer_height_range_um;
        let power = |class| {
            let power_w = self.laser(class).power_w;
            (power_w > machine.max_power_w).then_some(power_w)
        };
        let too_strong = MarkClass::ALL
            .into_iter()
            .filter_map(power)
            .fold(None, |most: Option<f64>, power_w| Some(most.map_or(power_w, |most| most.max(power_w))));
        let power = too_strong.map(|power_w| OutOfRange {
            key: "laser_power_w".into(),
            value: power_w.to_string(),
            allowed: format!("at most {} on machine `{}`", machine.max_power_w, machine.name),
        });
        let axes = machine.axes.iter().flat_map(|axes| self.check_for_axes(axes, &machine.name));
        within("layer_height_um", self.layer_height_um, low_um, high_um).into_iter().chain(power).chain(axes).collect()
    }

    /// What axes cannot do: marks faster than their greatest speed, and another focus.
    fn check_for_axes(&self, axes: &Axes, machine: &str) -> Vec<OutOfRange> {
        let lasers = MarkClass::ALL.map(|class| self.laser(class));
        let fastest_mm_s = lasers.iter().map(|laser| laser.mark_speed_mm_s).fold(0.0, f64::max);
        let is_too_fast = fastest_mm_s > axes.max_speed_mm_s;
        let speed = is_too_fast.then(|| OutOfRange {
            key: "mark_speed_mm_s".into(),
            value: fastest_mm_s.to_string(),
            allowed: format!("at most {} on machine `{machine}` (axes.max_speed_mm_s)", axes.max_speed_mm_s),
        });
        let focus_um = lasers.iter().map(|laser| laser.focus_um).find(|focus_um| *focus_um != 0.0);
        let focus = focus_um.map(|focus_um| OutOfRange {
            key: "focus_um".into(),
            value: focus_um.to_string(),
            allowed: format!("0 on machine `{machine}`: a grbl controller does not move the focus"),
        });
        speed.into_iter().chain(focus).collect()
    }
}

impl ClassSettings {
    /// What is out of range; `table` comes before each key.
    fn check(&self, table: &str) -> Vec<OutOfRange> {
        let number = |key: &str, value: Option<f64>, low: f64, high: f64| {
            value.and_then(|value| within(&format!("{table}{key}"), value, low, high))
        };
        let whole = |key: &str, value: Option<u32>, low: u32, high: u32| {
            value.and_then(|value| within(&format!("{table}{key}"), value, low, high))
        };
        // A laser that stands still for longer than a second melts a hole.
        [
            number("laser_power_w", self.laser_power_w, 0.1, 10_000.0),
            number("mark_speed_mm_s", self.mark_speed_mm_s, 1.0, 50_000.0),
            number("jump_speed_mm_s", self.jump_speed_mm_s, 1.0, 50_000.0),
            number("focus_um", self.focus_um, -100_000.0, 100_000.0),
            whole("jump_delay_us", self.jump_delay_us, 0, 1_000_000),
            whole("mark_delay_us", self.mark_delay_us, 0, 1_000_000),
            whole("polygon_delay_us", self.polygon_delay_us, 0, 1_000_000),
            whole("point_time_us", self.point_time_us, 1, 1_000_000),
            number("hatch_spacing_um", self.hatch_spacing_um, 1.0, MAX_SPACING_UM),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}
