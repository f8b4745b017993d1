//! Texts: banner, `$` answers and status reports, as each firmware words them.

use std::fmt::Write as _;

use super::gcode::{Modes, Spindle};
use super::options::{AXES, Firmware, Options};

/// The line with which the firmware says that it starts.
pub(super) fn banner(firmware: Firmware) -> &'static str {
    match firmware {
        Firmware::Grbl11 => "\r\nGrbl 1.1h ['$' for help]\r\n",
        Firmware::GrblHal => "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n",
    }
}

/// The answer to `$I`. grblHAL tells one byte more than its buffer holds; 1.1 may too.
pub(super) fn build_info(options: &Options) -> String {
    let (blocks, bytes) = (options.planner_blocks, options.receive_bytes + 1);
    let axes = options.axes;
    match options.firmware {
        Firmware::Grbl11 => format!("[VER:1.1h.20190830:]\r\n[OPT:V,{blocks},{bytes}]\r\n"),
        Firmware::GrblHal => format!(
            "[VER:1.1f.20260817:]\r\n[OPT:VNML+,{blocks},{bytes},{axes},0]\r\n[AXS:{axes}:{}]\r\n\
             [NEWOPT:ENUMS,RT+,TC,SED]\r\n[FIRMWARE:grblHAL]\r\n[SIGNALS:D]\r\n[NVS STORAGE:*EEPROM]\r\n\
             [DRIVER:Simulator]\r\n[DRIVER VERSION:260324]\r\n",
            &"XYZA"[..axes]
        ),
    }
}

/// Whether the machine has this setting.
pub(super) fn has_setting(options: &Options, number: u16) -> bool {
    let is_of_missing_axis = (100..140).contains(&number) && usize::from(number % 10) >= options.axes;
    options.settings.contains_key(&number) && !is_of_missing_axis
}

/// The answer to `$$`.
pub(super) fn settings(options: &Options) -> String {
    let mut text = String::new();
    for (number, value) in &options.settings {
        if !has_setting(options, *number) {
            continue;
        }
        let digits = match (options.firmware, number) {
            (Firmware::Grbl11, 11 | 12 | 24 | 25 | 27 | 100..=199) => 3,
            (Firmware::GrblHal, 100..=109) => 5,
            (Firmware::GrblHal, 11 | 12 | 27 | 30 | 31 | 110..=199) => 3,
            (Firmware::GrblHal, 0 | 24 | 25) => 1,
            _ => 0,
        };
        let _ = write!(text, "${number}={value:.digits$}\r\n");
    }
    text
}

/// The answer to `$G`.
pub(super) fn parser_state(modes: &Modes, firmware: Firmware) -> String {
    let is_hal = firmware == Firmware::GrblHal;
    format!(
        "[GC:G{} G{} G17 G{} G{} G94 {}M{} M{} T{} F{} S{}{}]\r\n",
        u8::from(modes.is_feed),
        54 + modes.system,
        if modes.is_inches { 20 } else { 21 },
        if modes.is_incremental { 91 } else { 90 },
        if is_hal { "G40 G49 G98 G50 " } else { "" },
        match modes.spindle {
            Spindle::Constant => 3,
            Spindle::Dynamic => 4,
            Spindle::Off => 5,
        },
        if modes.is_coolant { 8 } else { 9 },
        modes.tool,
        (modes.feed_mm_per_min / modes.mm_per_unit()).round(),
        modes.s.round(),
        if is_hal { "." } else { "" },
    )
}

/// Coordinates as every answer writes them.
pub(super) fn coordinates(point: &[f64; AXES], axes: usize) -> String {
    // Without this a tiny negative number reads `-0.000`.
    let tidy = point[..axes].iter().map(|value| if value.abs() < 5e-4 { 0.0 } else { *value });
    tidy.map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(",")
}

/// The answer to `$#`.
pub(super) fn offsets(systems: &[[f64; AXES]; 6], g92: &[f64; AXES], options: &Options) -> String {
    let axes = options.axes;
    let none = coordinates(&[0.0; AXES], axes);
    let mut text = String::new();
    for (at, system) in systems.iter().enumerate() {
        let _ = write!(text, "[G{}:{}]\r\n", 54 + at, coordinates(system, axes));
    }
    if options.firmware == Firmware::GrblHal {
        for name in ["G59.1", "G59.2", "G59.3"] {
            let _ = write!(text, "[{name}:{none}]\r\n");
        }
    }
    let _ = write!(text, "[G28:{none}]\r\n[G30:{none}]\r\n[G92:{}]\r\n", coordinates(g92, axes));
    match options.firmware {
        Firmware::Grbl11 => text.push_str("[TLO:0.000]\r\n"),
        Firmware::GrblHal => {
            let _ = write!(text, "[TLO:{none}]\r\n");
        }
    }
    let _ = write!(text, "[PRB:{none}:0]\r\n");
    text
}

/// What a status report is made of.
pub(super) struct Status<'a> {
    pub(super) state: &'a str,
    pub(super) position: [f64; AXES],
    pub(super) offset: [f64; AXES],
    pub(super) free_blocks: usize,
    pub(super) free_bytes: usize,
    pub(super) speed_mm_per_min: f64,
    pub(super) s: f64,
    pub(super) spindle: Spindle,
    pub(super) is_coolant: bool,
    pub(super) is_homed: bool,
}

/// Fields of a report that come only now and then, and in how many reports each is due.
#[derive(Debug)]
pub(super) struct Rare {
    offset_in: u8,
    overrides_in: u8,
    /// The accessories at the last report that told them.
    accessories: String,
    homed: Option<bool>,
}

impl Rare {
    /// 1.1 tells the offset first, grblHAL the overrides.
    pub(super) fn new(firmware: Firmware) -> Self {
        let offset_in = u8::from(firmware == Firmware::GrblHal);
        Self { offset_in, overrides_in: 0, accessories: String::new(), homed: None }
    }

    /// The offset changed: it is told at once.
    pub(super) fn offset_changed(&mut self) {
        self.offset_in = 0;
    }

    /// A status report with the fields that are due.
    pub(super) fn report(&mut self, status: &Status<'_>, options: &Options) -> String {
        let mask = options.settings.get(&10).map_or(1, |mask| *mask as u32);
        let is_hal = options.firmware == Firmware::GrblHal;
        let axes = options.axes;
        let is_machine = mask & 1 != 0;
        let shown = match is_machine {
            true => status.position,
            false => std::array::from_fn(|axis| status.position[axis] - status.offset[axis]),
        };
        let name = if is_machine { "MPos" } else { "WPos" };
        let mut text = format!("<{}|{name}:{}", status.state, coordinates(&shown, axes));
        if mask & 2 != 0 {
            let _ = write!(text, "|Bf:{},{}", status.free_blocks, status.free_bytes);
        }
        // On grblHAL these fields are bits of `$10` too.
        if !is_hal || mask & 16 != 0 {
            let _ = write!(text, "|FS:{:.0},{:.0}", status.speed_mm_per_min, status.s);
        }
        let is_busy = status.state == "Run";
        let has_overrides = !is_hal || mask & 64 != 0;
        let has_offset = !is_hal || mask & 32 != 0;
        if has_offset && self.offset_in == 0 {
            let _ = write!(text, "|WCO:{}", coordinates(&status.offset, axes));
            self.offset_in = if is_busy { 30 } else { 10 };
            self.overrides_in = self.overrides_in.max(1);
        } else if has_overrides && self.overrides_in == 0 {
            text.push_str("|Ov:100,100,100");
            self.overrides_in = if is_busy { 20 } else { 10 };
            self.accessories(&mut text, status);
        }
        self.offset_in = self.offset_in.saturating_sub(1);
        self.overrides_in = self.overrides_in.saturating_sub(1);
        if is_hal && mask & 256 != 0 && self.homed != Some(status.is_homed) {
            self.homed = Some(status.is_homed);
            let _ = write!(text, "|H:{}|TLR:0", u8::from(status.is_homed));
        }
        text.push_str(">\r\n");
        text
    }

    fn accessories(&mut self, text: &mut String, status: &Status<'_>) {
        let mut letters = String::new();
        match status.spindle {
            Spindle::Constant => letters.push('S'),
            Spindle::Dynamic => letters.push('C'),
            Spindle::Off => {}
        }
        if status.is_coolant {
            letters.push('F');
        }
        if !letters.is_empty() || !self.accessories.is_empty() {
            let _ = write!(text, "|A:{letters}");
        }
        self.accessories = letters;
    }
}
