//! An SLM machine. `config/machines/sim-slm.toml` explains its keys.

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::{check_link, real_time, yes};
use crate::config::{OutOfRange, within};
use crate::layer::{Mirror, Raster};
use crate::link::grbl::GrblMachine;
use crate::link::{LinkSettings, Protocol};

/// An SLM machine: its line, field, beam and travel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlmMachine {
    /// For people.
    pub name: String,
    /// Read before, to know which keys there are.
    #[serde(rename = "kind")]
    _kind: IgnoredAny,
    /// Size of the field that the laser reaches, along x and y, micrometres.
    pub field_um: [f64; 2],
    /// Pitch of the grid on which layers are sampled for their contours, micrometres.
    #[serde(default = "thirty")]
    pub grid_um: f64,
    /// Largest part height, micrometres.
    pub build_height_um: f64,
    /// Width of the melted track, micrometres.
    pub beam_diameter_um: f64,
    /// Greatest power of the laser, watts.
    pub max_power_w: f64,
    /// Least and greatest layer height, micrometres: what plate and recoater can do.
    pub layer_height_range_um: [f64; 2],
    /// Time that the recoater takes for a layer, milliseconds.
    #[serde(default = "ten_seconds")]
    pub recoat_ms: u32,
    /// Whether the operator must confirm that plate and bed are ready (`layerctl resume`) before a queued job begins.
    #[serde(default = "yes")]
    pub confirm_plate: bool,
    /// How much faster than real time the device's clock runs, 1 to 1000. Only for simulated devices.
    #[serde(default = "real_time")]
    pub time_scale: f64,
    /// The axes that move the beam and the plate; only for a machine with a grbl controller.
    pub axes: Option<Axes>,
    /// The line.
    pub link: LinkSettings,
}

/// The axes of a machine with a grbl controller, which moves the beam itself. `config/machines/grbl-laser.toml` explains its keys.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axes {
    /// Greatest speed along x and y, millimetres a second: that of jumps.
    pub max_speed_mm_s: f64,
    /// Acceleration along x and y, millimetres a second squared.
    pub acceleration_mm_s2: f64,
    /// Lines of G-code that spread powder. By default they switch the coolant output on for as long as the recoater takes.
    pub recoat_gcode: Option<Vec<String>>,
}

/// Lowest rate of a line to a grbl controller, bits a second.
const MIN_GRBL_BAUD: u32 = 57_600;
/// Most lines that spread powder, so that they fit into a queue.
const MAX_RECOAT_LINES: usize = 8;
/// Longest of these lines, bytes: with its end, it is to be below 80.
const MAX_GCODE_BYTES: usize = 78;
/// Words that may spread powder: moves, pauses, absolute and relative positions; outputs. G28 and G30 would raise the plate.
const RECOAT_G: [f64; 5] = [0.0, 1.0, 4.0, 90.0, 91.0];
const RECOAT_M: [f64; 8] = [5.0, 7.0, 8.0, 9.0, 62.0, 63.0, 64.0, 65.0];

fn thirty() -> f64 {
    30.0
}

fn ten_seconds() -> u32 {
    10_000
}

impl SlmMachine {
    pub(super) fn check(&self) -> Vec<OutOfRange> {
        let [low_um, high_um] = self.layer_height_range_um;
        // Of 1 m: larger fields have several lasers. So many grid points as a picture may have pixels.
        let most_um = f64::from(Raster::MAX_PX) * self.grid_um;
        [
            within("field_um[0]", self.field_um[0], 1000.0, most_um.min(1e6)),
            within("field_um[1]", self.field_um[1], 1000.0, most_um.min(1e6)),
            within("grid_um", self.grid_um, 1.0, 1000.0),
            within("build_height_um", self.build_height_um, 1000.0, 2_000_000.0),
            within("beam_diameter_um", self.beam_diameter_um, 1.0, 1000.0),
            within("max_power_w", self.max_power_w, 0.1, 10_000.0),
            within("layer_height_range_um[0]", low_um, 1.0, 1000.0),
            within("layer_height_range_um[1]", high_um, low_um.clamp(1.0, 1000.0), 1000.0),
            within("recoat_ms", self.recoat_ms, 0, 600_000),
            within("time_scale", self.time_scale, 1.0, 1000.0),
        ]
        .into_iter()
        .flatten()
        .chain(check_link(&self.link))
        .chain(self.check_axes())
        .collect()
    }

    /// What is wrong with the axes: a grbl controller has them, and no other device.
    fn check_axes(&self) -> Vec<OutOfRange> {
        let is_grbl = self.link.protocol == Protocol::Grbl;
        let Some(axes) = self.axes.as_ref().filter(|_| is_grbl) else {
            let (value, allowed) = match (is_grbl, &self.axes) {
                (true, _) => {
                    ("missing", "a table with max_speed_mm_s and acceleration_mm_s2, as link.protocol is \"grbl\"")
                }
                (false, Some(_)) => ("a table", "nothing here, unless link.protocol is \"grbl\""),
                (false, None) => return Vec::new(),
            };
            return vec![OutOfRange { key: "axes".into(), value: value.into(), allowed: allowed.into() }];
        };
        let lines = axes.recoat_gcode.iter().flatten();
        let wrong = lines.filter_map(|line| recoat_fault(line).map(|allowed| (line, allowed)));
        let wrong = wrong.map(|(line, allowed)| OutOfRange {
            key: "axes.recoat_gcode".into(),
            value: format!("{line:?}"),
            allowed: allowed.into(),
        });
        let count = axes.recoat_gcode.as_ref().map_or(1, Vec::len);
        [
            within("axes.max_speed_mm_s", axes.max_speed_mm_s, 1.0, 10_000.0),
            within("axes.acceleration_mm_s2", axes.acceleration_mm_s2, 1.0, 1_000_000.0),
            within("number of lines of axes.recoat_gcode", count, 1, MAX_RECOAT_LINES),
            // A slower line delays an abort beyond 100 ms: it waits behind the bytes that were sent.
            within("link.baud", self.link.baud, MIN_GRBL_BAUD, 12_000_000),
        ]
        .into_iter()
        .flatten()
        .chain(wrong)
        .collect()
    }

    /// The machine as a grbl controller drives it; `None` if it has another controller.
    pub fn grbl(&self) -> Option<GrblMachine> {
        let axes = self.axes.as_ref()?;
        // The ranges keep all values far within 32 bits.
        let micrometres = |mm: f64| (mm * 1000.0).round() as u32;
        let pause = format!("G4P{}", f64::from(self.recoat_ms) / 1000.0);
        let recoat_gcode = axes.recoat_gcode.clone().unwrap_or_else(|| vec!["M8".into(), pause, "M9".into()]);
        Some(GrblMachine {
            field_um: self.field_um.map(|um| um.round() as u32),
            max_power_mw: micrometres(self.max_power_w),
            layer_height_um: [
                self.layer_height_range_um[0].floor() as u32,
                self.layer_height_range_um[1].ceil() as u32,
            ],
            max_position_um: self.build_height_um.round() as i32,
            max_speed_um_s: micrometres(axes.max_speed_mm_s),
            acceleration_um_s2: micrometres(axes.acceleration_mm_s2),
            recoat_gcode,
        })
    }

    /// The grid on which layers are sampled.
    pub fn raster(&self) -> Raster {
        let [width_px, height_px] = self.field_um.map(|um| (um / self.grid_um).ceil() as u32);
        Raster {
            width_px,
            height_px,
            pixel_um: [self.grid_um; 2],
            build_height_um: self.build_height_um,
            mirror: Mirror::default(),
        }
    }
}

/// What a line that spreads powder must be, if it is not. It must neither light the laser nor move the plate, which may carry a part.
fn recoat_fault(line: &str) -> Option<&'static str> {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, ' ' | '.' | '-');
    if line.is_empty() || line.len() > MAX_GCODE_BYTES || !line.chars().all(is_plain) {
        return Some("1 to 78 letters, digits, spaces, points and minus signs");
    }
    let text = line.to_ascii_uppercase().replace(' ', "");
    let mut rest = text.as_str();
    while let Some(letter) = rest.chars().next() {
        let after = &rest[1..];
        let end = after.find(|next: char| next.is_ascii_alphabetic()).unwrap_or(after.len());
        let value = after[..end].parse::<f64>();
        let is_allowed = match (letter, &value) {
            ('G', Ok(number)) => RECOAT_G.contains(number),
            ('M', Ok(number)) => RECOAT_M.contains(number),
            ('X' | 'Y' | 'A' | 'B' | 'C' | 'F' | 'P' | 'Q' | 'E', Ok(_)) => true,
            _ => false,
        };
        if !is_allowed {
            return Some(
                "words G0, G1, G4, G90, G91, M5, M7 to M9, M62 to M65, X, Y, A, B, C, F, P, Q and E, each with a number",
            );
        }
        rest = &after[end..];
    }
    None
}
