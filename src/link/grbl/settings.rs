//! What a grbl controller is: its settings, checked against the machine that is configured. `tests/grbl/main.rs` prints with it.

use std::collections::BTreeMap;

use crate::link::message::{Capabilities, Encoding, MachineCapabilities, PowderCapabilities};

/// The machine that a grbl controller drives, as it is configured.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrblMachine {
    /// Size of the field, x and y, micrometres.
    pub field_um: [u32; 2],
    /// Greatest power of the laser, milliwatts: that of the greatest `S`.
    pub max_power_mw: u32,
    /// Least and greatest layer height, micrometres.
    pub layer_height_um: [u32; 2],
    /// Deepest plate position, micrometres below the working plane.
    pub max_position_um: i32,
    /// Greatest speed of the axes x and y, micrometres a second.
    pub max_speed_um_s: u32,
    /// Acceleration of the axes x and y, micrometres a second squared.
    pub acceleration_um_s2: u32,
    /// Lines of G-code that spread powder.
    pub recoat_gcode: Vec<String>,
}

/// Size of the buffer of all layers in the host's memory, bytes. Larger layers stream.
const BUFFER_BYTES: u32 = 128 << 10;
/// Longest marking of a layer, milliseconds: 12 hours. A filled layer of 200 mm × 200 mm takes less than two at 100 mm/s.
const MAX_MARK_MS: u32 = 12 * 3_600_000;
/// The longest line that is sent has so many bytes. A smaller receive buffer would never take it.
pub(super) const MAX_LINE_BYTES: usize = 79;
/// Most bytes that wait in the controller. More of them would not be faster, and after a lost line it would be less clear what was done.
const MAX_USABLE_BYTES: usize = 1023;
/// Blocks of grbl 1.1's planner: the fewest that there are.
const MIN_PLANNER_BLOCKS: usize = 15;
/// Most blocks that a planner is believed to have.
const MAX_PLANNER_BLOCKS: usize = 1000;
/// The tolerance of speed and acceleration: a controller rounds them to three decimals.
const TOLERANCE: f64 = 0.01;

/// Why a controller cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GrblMisfit {
    /// It is older than grbl 1.1.
    #[error("the controller says that it is `{0}`; layerd needs grbl 1.1 or grblHAL: update its firmware")]
    Version(String),
    /// It does not tell a setting.
    #[error("the controller does not tell its setting ${0} ({1}): is it grbl 1.1 or grblHAL, with a laser?")]
    Missing(u16, &'static str),
    /// A setting has a value with which it cannot be used.
    #[error("the controller has ${setting}={found} ({name}), but {wanted}: send ${setting}={value} to it")]
    Setting {
        /// Number of the setting.
        setting: u16,
        /// What it is.
        name: &'static str,
        /// Its value.
        found: String,
        /// What is needed.
        wanted: &'static str,
        /// The value that it must have.
        value: &'static str,
    },
    /// A setting is not what the machine file says.
    #[error(
        "the controller has ${setting}={found} ({name}), which is {is}, but the machine file says {key} = {configured}: correct one \
         of them"
    )]
    Differs {
        /// Number of the setting.
        setting: u16,
        /// What it is.
        name: &'static str,
        /// Its value.
        found: String,
        /// The same in the unit of the machine file.
        is: String,
        /// The key of the machine file.
        key: &'static str,
        /// The value of the machine file.
        configured: String,
    },
    /// It can take too little at once.
    #[error(
        "the controller says in $I that it takes {0} bytes at once; lines need {MAX_LINE_BYTES}: use another controller"
    )]
    Buffer(u32),
    /// It does not say how much it can take at once.
    #[error("the controller does not tell its buffers ($I): is it grbl 1.1 or grblHAL?")]
    NoOptions,
    /// Its coordinate system is not known.
    #[error("the controller does not tell the offset of G54 ($#): is it grbl 1.1 or grblHAL?")]
    NoOffset,
    /// It reports positions in a coordinate system of which it does not tell the offsets.
    #[error("the controller does not tell its machine's position: send $10=1 to it (grblHAL: $10=511)")]
    NoPosition,
}

/// What a controller told about itself.
#[derive(Clone, Debug, Default)]
pub(super) struct Told {
    pub(super) name: String,
    /// Blocks of its planner, and bytes of its receive buffer.
    pub(super) options: Option<(u32, u32)>,
    pub(super) offset_um: Option<[i32; 3]>,
    settings: BTreeMap<u16, f64>,
}

/// A controller that fits its machine.
#[derive(Clone, Debug)]
pub(super) struct Controller {
    pub(super) name: String,
    /// Most bytes that may be unanswered.
    pub(super) usable_bytes: usize,
    pub(super) planner_blocks: usize,
    /// The `S` of the greatest power.
    pub(super) max_s: f64,
    /// Whether it finds its position with switches.
    pub(super) homes: bool,
    /// Offset of G54, micrometres.
    pub(super) offset_um: [i32; 3],
    /// How far a reported position may lie beside the truth, micrometres.
    pub(super) tolerance_um: f64,
    /// The same of the plate.
    pub(super) plate_tolerance_um: u32,
    /// Greatest speed of the plate, micrometres a second.
    pub(super) max_plate_speed_um_s: f64,
}

impl Told {
    /// Nothing yet, of a controller with this name.
    pub(super) fn of(name: String) -> Self {
        Self { name, ..Self::default() }
    }

    /// Notes a line of `$$`. Settings beyond those of grbl 1.1 are not used.
    pub(super) fn note(&mut self, setting: u16, value: f64) {
        if setting < 200 {
            self.settings.insert(setting, value);
        }
    }

    fn get(&self, setting: u16, name: &'static str) -> Result<f64, GrblMisfit> {
        self.settings.get(&setting).copied().ok_or(GrblMisfit::Missing(setting, name))
    }

    /// The controller, if the machine can be driven with it.
    ///
    /// # Errors
    /// [`GrblMisfit`] names the first thing that does not fit, and what to do.
    pub(super) fn check(&self, machine: &GrblMachine) -> Result<Controller, GrblMisfit> {
        let is_known = self.name.contains("1.1") || self.name.to_lowercase().contains("hal");
        if !is_known {
            return Err(GrblMisfit::Version(self.name.clone()));
        }
        self.must_be(32, "laser mode", 1.0, "layerd marks with M4, which needs it", "1")?;
        self.must_be(13, "reports in inches", 0.0, "layerd reads millimetres", "0")?;
        self.must_be(31, "least S", 0.0, "the laser must be able to go dark", "0")?;
        let max_s = self.get(30, "greatest S")?;
        if !(1.0..=1e6).contains(&max_s) {
            let (found, wanted) = (max_s.to_string(), "power is set in steps of it");
            return Err(GrblMisfit::Setting { setting: 30, name: "greatest S", found, wanted, value: "1000" });
        }
        let homing = self.settings.get(&22).copied().unwrap_or(0.0) as u32;
        if self.name.to_lowercase().contains("hal") && homing & 5 == 1 {
            let wanted = "it would not say after a start that it does not know its position";
            let found = homing.to_string();
            return Err(GrblMisfit::Setting { setting: 22, name: "homing, not required", found, wanted, value: "5" });
        }
        self.check_axes(machine)?;
        let (blocks, bytes) = self.options.ok_or(GrblMisfit::NoOptions)?;
        // Of a ring buffer one byte stays free.
        let usable_bytes = (bytes.saturating_sub(1) as usize).min(MAX_USABLE_BYTES);
        if usable_bytes < MAX_LINE_BYTES {
            return Err(GrblMisfit::Buffer(bytes));
        }
        let steps_mm = self.get(100, "steps/mm of x")?.min(self.get(101, "steps/mm of y")?).max(1.0);
        Ok(Controller {
            name: self.name.clone(),
            usable_bytes,
            // If a byte was lost and the number is too small, moves would count as done too early.
            planner_blocks: (blocks as usize).clamp(MIN_PLANNER_BLOCKS, MAX_PLANNER_BLOCKS),
            max_s,
            homes: homing & 1 == 1,
            offset_um: self.offset_um.ok_or(GrblMisfit::NoOffset)?,
            // A step at each end and one in between; positions and coordinates are rounded, too.
            tolerance_um: (3000.0 / steps_mm).max(10.0),
            // One and a half steps, and a rounded position.
            plate_tolerance_um: (1500.0 / self.get(102, "steps/mm of z")?.max(1.0)).ceil() as u32 + 1,
            max_plate_speed_um_s: self.get(112, "greatest speed of z")? * 1000.0 / 60.0,
        })
    }

    fn must_be(
        &self,
        setting: u16,
        name: &'static str,
        value: f64,
        wanted: &'static str,
        text: &'static str,
    ) -> Result<(), GrblMisfit> {
        let found = self.get(setting, name)?;
        if found == value {
            return Ok(());
        }
        Err(GrblMisfit::Setting { setting, name, found: found.to_string(), wanted, value: text })
    }

    /// Speeds and accelerations decide how long a layer takes, and travels what fits.
    fn check_axes(&self, machine: &GrblMachine) -> Result<(), GrblMisfit> {
        for (axis, (speed, acceleration, travel)) in [(110, 120, 130), (111, 121, 131)].into_iter().enumerate() {
            let name = ["greatest speed of x, mm/min", "greatest speed of y, mm/min"][axis];
            let found = self.get(speed, name)?;
            differs(speed, name, found, found / 60.0, "axes.max_speed_mm_s", f64::from(machine.max_speed_um_s))?;
            let name = ["acceleration of x, mm/s²", "acceleration of y, mm/s²"][axis];
            let found = self.get(acceleration, name)?;
            let configured = f64::from(machine.acceleration_um_s2);
            differs(acceleration, name, found, found, "axes.acceleration_mm_s2", configured)?;
            let name = ["travel of x, mm", "travel of y, mm"][axis];
            too_short(travel, name, self.get(travel, name)?, "field_um", f64::from(machine.field_um[axis]))?;
        }
        let name = "travel of z, mm";
        too_short(132, name, self.get(132, name)?, "build_height_um", f64::from(machine.max_position_um))
    }
}

/// Compares a value in millimetres with a configured one in micrometres.
fn differs(
    setting: u16,
    name: &'static str,
    found: f64,
    found_mm: f64,
    key: &'static str,
    configured_um: f64,
) -> Result<(), GrblMisfit> {
    let configured_mm = configured_um / 1000.0;
    if (found_mm - configured_mm).abs() <= TOLERANCE * configured_mm {
        return Ok(());
    }
    let is = format!("{key} = {}", rounded(found_mm));
    Err(GrblMisfit::Differs { setting, name, found: found.to_string(), is, key, configured: rounded(configured_mm) })
}

fn too_short(
    setting: u16,
    name: &'static str,
    found_mm: f64,
    key: &'static str,
    configured_um: f64,
) -> Result<(), GrblMisfit> {
    if found_mm * 1000.0 >= configured_um {
        return Ok(());
    }
    let (is, configured) = (format!("{} µm", rounded(found_mm * 1000.0)), rounded(configured_um));
    Err(GrblMisfit::Differs { setting, name, found: found_mm.to_string(), is, key, configured })
}

/// At most three decimals.
fn rounded(value: f64) -> String {
    ((value * 1000.0).round() / 1000.0).to_string()
}

/// The capabilities of the machine that a controller drives. The host plays the part of a powder machine's firmware, so most of them are
/// its own.
pub(super) fn capabilities(machine: &GrblMachine, name: &str) -> Capabilities {
    Capabilities {
        name: name.into(),
        layer_slots: 2,
        window_bytes: 64 << 10,
        largest_frame_bytes: 4096,
        encodings: vec![Encoding::Vectors],
        max_exposure_ms: MAX_MARK_MS,
        machine: MachineCapabilities::Powder(PowderCapabilities {
            field_um: machine.field_um,
            max_power_mw: machine.max_power_mw,
            layer_height_um: machine.layer_height_um,
            max_position_um: machine.max_position_um,
            buffer_bytes: BUFFER_BYTES,
        }),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::link::grbl) fn machine() -> GrblMachine {
        GrblMachine {
            field_um: [100_000, 100_000],
            max_power_mw: 5_000,
            layer_height_um: [50, 200],
            max_position_um: 50_000,
            max_speed_um_s: 200_000,
            acceleration_um_s2: 2_000_000,
            recoat_gcode: vec!["M8".into(), "G4P1".into(), "M9".into()],
        }
    }

    fn told(changes: &[(u16, f64)]) -> Told {
        let settings =
            [(13, 0.0), (22, 1.0), (30, 1000.0), (31, 0.0), (32, 1.0), (100, 250.0), (101, 250.0), (102, 250.0)];
        let axes = [(110, 12_000.0), (111, 12_000.0), (112, 600.0), (120, 2000.0), (121, 2000.0)];
        let travel = [(130, 200.0), (131, 200.0), (132, 200.0)];
        let mut told = Told { name: "Grbl 1.1h".into(), options: Some((15, 128)), ..Told::default() };
        told.offset_um = Some([0; 3]);
        for (setting, value) in settings.iter().chain(&axes).chain(&travel).chain(changes) {
            told.note(*setting, *value);
        }
        told
    }

    #[test]
    fn a_controller_that_fits() {
        let controller = told(&[]).check(&machine()).unwrap();
        assert_eq!((controller.usable_bytes, controller.planner_blocks, controller.homes), (127, 15, true));
        assert_eq!(controller.tolerance_um, 12.0);
    }

    #[test]
    fn what_does_not_fit_is_told_with_the_setting_and_a_remedy() {
        let cases = [
            ((32, 0.0), ["$32=0", "laser mode", "$32=1"]),
            ((13, 1.0), ["$13=1", "inches", "$13=0"]),
            ((31, 5.0), ["$31=5", "dark", "$31=0"]),
            ((30, 0.0), ["$30=0", "greatest S", "$30=1000"]),
            ((110, 500.0), ["$110=500", "axes.max_speed_mm_s = 8.333", "axes.max_speed_mm_s = 200"]),
            ((121, 10.0), ["$121=10", "axes.acceleration_mm_s2 = 10", "axes.acceleration_mm_s2 = 2000"]),
            ((130, 80.0), ["$130=80", "80000 µm", "field_um = 100000"]),
        ];
        for (change, words) in cases {
            let text = told(&[change]).check(&machine()).unwrap_err().to_string();
            for word in words {
                assert!(text.contains(word), "`{word}` is not in: {text}");
            }
        }
        let unhomed = Told { name: "GrblHAL 1.1f".into(), ..told(&[(22, 1.0)]) };
        assert!(unhomed.check(&machine()).unwrap_err().to_string().contains("$22=5"));
        let old = Told { name: "Grbl 0.9j".into(), ..told(&[]) };
        assert!(matches!(old.check(&machine()), Err(GrblMisfit::Version(_))));
        let small = Told { options: Some((15, 64)), ..told(&[]) };
        assert_eq!(small.check(&machine()).unwrap_err(), GrblMisfit::Buffer(64));
        let mute = Told { name: "Grbl 1.1h".into(), ..Told::default() };
        assert!(matches!(mute.check(&machine()), Err(GrblMisfit::Missing(32, _))));
    }
}
