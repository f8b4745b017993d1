//! Lines of G-code: words, modal state, and what a line asks for. Errors are the firmware's numbers.

use super::options::{AXES, Firmware};

pub(super) const BAD_LETTER: u8 = 1;
pub(super) const BAD_NUMBER: u8 = 2;
const NEGATIVE: u8 = 4;
const UNSUPPORTED: u8 = 20;
const MODAL_GROUP: u8 = 21;
const NO_FEED: u8 = 22;
const NOT_WHOLE: u8 = 23;
const TWO_COMMANDS_WITH_AXES: u8 = 24;
const REPEATED_WORD: u8 = 25;
const NO_AXES: u8 = 26;
const MISSING_VALUE: u8 = 28;
const UNUSED_WORDS: u8 = 36;

/// Whether the spindle output, here the laser, is on and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Spindle {
    /// M3.
    Constant,
    /// M4.
    Dynamic,
    /// M5.
    Off,
}

/// What stays from line to line.
#[derive(Clone, Debug)]
pub(super) struct Modes {
    /// The motion is G1, otherwise G0.
    pub(super) is_feed: bool,
    pub(super) is_inches: bool,
    pub(super) is_incremental: bool,
    /// 0 is G54.
    pub(super) system: usize,
    pub(super) spindle: Spindle,
    /// M8.
    pub(super) is_coolant: bool,
    pub(super) feed_mm_per_min: f64,
    pub(super) s: f64,
    pub(super) tool: u32,
}

impl Modes {
    pub(super) fn new() -> Self {
        Self {
            is_feed: false,
            is_inches: false,
            is_incremental: false,
            system: 0,
            spindle: Spindle::Off,
            is_coolant: false,
            feed_mm_per_min: 0.0,
            s: 0.0,
            tool: 0,
        }
    }

    /// Millimetres in a unit of length.
    pub(super) fn mm_per_unit(&self) -> f64 {
        if self.is_inches { 25.4 } else { 1.0 }
    }
}

/// Axis words: what they are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axes {
    Nothing,
    Motion,
    /// G92.
    SetPosition,
}

/// What a line asks for, in the order in which it is done.
#[derive(Clone, Debug)]
pub(super) struct Request {
    pub(super) modes: Modes,
    /// The line has an S word.
    pub(super) has_s: bool,
    pub(super) dwell_s: Option<f64>,
    /// G92.1.
    pub(super) clears_g92: bool,
    /// G53.
    pub(super) is_machine: bool,
    pub(super) axes_are: Axes,
    /// In the line's units.
    pub(super) axes: [Option<f64>; AXES],
    /// M2 or M30.
    pub(super) is_end: bool,
}

/// The words of a line without blanks and comments, in capitals.
fn words(line: &str) -> Result<Vec<(char, f64)>, u8> {
    let mut words = Vec::new();
    let mut rest = line;
    while let Some(letter) = rest.chars().next() {
        if !letter.is_ascii_uppercase() {
            return Err(BAD_LETTER);
        }
        rest = &rest[1..];
        let sign = usize::from(rest.starts_with(['-', '+']));
        let mut has_point = false;
        let number = rest[sign..].find(|digit: char| {
            let is_point = digit == '.' && !has_point;
            has_point |= is_point;
            !digit.is_ascii_digit() && !is_point
        });
        let (number, after) = rest.split_at(number.map_or(rest.len(), |end| sign + end));
        words.push((letter, number.parse().map_err(|_| BAD_NUMBER)?));
        rest = after;
    }
    Ok(words)
}

/// Reads a line as a machine with these modes does. Modes change even if nothing moves; the caller takes them over if there is no error.
pub(super) fn read(line: &str, modes: &Modes, firmware: Firmware, machine_axes: usize) -> Result<Request, u8> {
    let mut reader = Reader {
        request: Request {
            modes: modes.clone(),
            has_s: false,
            dwell_s: None,
            clears_g92: false,
            is_machine: false,
            axes_are: Axes::Nothing,
            axes: [None; AXES],
            is_end: false,
        },
        p: None,
        is_dwell: false,
        has_motion: false,
        groups: Vec::new(),
    };
    let mut seen = Vec::new();
    for (letter, value) in words(line)? {
        if matches!(letter, 'G' | 'M') {
            reader.command(letter, value)?;
            continue;
        }
        if seen.contains(&letter) {
            return Err(REPEATED_WORD);
        }
        seen.push(letter);
        reader.word(letter, value, firmware, machine_axes)?;
    }
    reader.finish()
}

struct Reader {
    request: Request,
    p: Option<f64>,
    is_dwell: bool,
    has_motion: bool,
    groups: Vec<u8>,
}

impl Reader {
    /// One command of each modal group in a line.
    fn group(&mut self, group: u8) -> Result<(), u8> {
        if self.groups.contains(&group) {
            return Err(MODAL_GROUP);
        }
        self.groups.push(group);
        Ok(())
    }

    fn command(&mut self, letter: char, value: f64) -> Result<(), u8> {
        let tenths = (value * 10.0).round();
        if (value * 10.0 - tenths).abs() > 1e-6 || tenths < 0.0 {
            return Err(NOT_WHOLE);
        }
        let modes = &mut self.request.modes;
        match (letter, tenths as u32) {
            ('G', motion @ (0 | 10)) => {
                modes.is_feed = motion == 10;
                if self.has_motion || self.request.axes_are == Axes::SetPosition {
                    return Err(TWO_COMMANDS_WITH_AXES);
                }
                self.has_motion = true;
            }
            ('G', 40) => {
                self.is_dwell = true;
                self.group(0)?;
            }
            ('G', 530) => {
                self.request.is_machine = true;
                self.group(0)?;
            }
            ('G', 920) => {
                if self.has_motion {
                    return Err(TWO_COMMANDS_WITH_AXES);
                }
                self.request.axes_are = Axes::SetPosition;
                self.group(0)?;
            }
            ('G', 921) => {
                self.request.clears_g92 = true;
                self.group(0)?;
            }
            ('G', units @ (200 | 210)) => {
                modes.is_inches = units == 200;
                self.group(6)?;
            }
            ('G', distance @ (900 | 910)) => {
                modes.is_incremental = distance == 910;
                self.group(3)?;
            }
            ('G', system @ 540..=590) if system % 10 == 0 => {
                modes.system = (system / 10 - 54) as usize;
                self.group(12)?;
            }
            ('G', 170) => self.group(2)?,
            ('G', 940) => self.group(5)?,
            ('G', 400) => self.group(7)?,
            ('G', 490) => self.group(8)?,
            ('G', 610) => self.group(13)?,
            ('M', spindle @ (30 | 40 | 50)) => {
                modes.spindle = match spindle {
                    30 => Spindle::Constant,
                    40 => Spindle::Dynamic,
                    _ => Spindle::Off,
                };
                self.group(107)?;
            }
            ('M', coolant @ (80 | 90)) => {
                modes.is_coolant = coolant == 80;
                self.group(108)?;
            }
            ('M', 20 | 300) => {
                self.request.is_end = true;
                self.group(104)?;
            }
            _ => return Err(UNSUPPORTED),
        }
        Ok(())
    }

    fn word(&mut self, letter: char, value: f64, firmware: Firmware, machine_axes: usize) -> Result<(), u8> {
        let is_positive = matches!(letter, 'F' | 'S' | 'N' | 'T' | 'P');
        if is_positive && value < 0.0 {
            return Err(NEGATIVE);
        }
        let modes = &mut self.request.modes;
        match letter {
            'X' | 'Y' | 'Z' => self.request.axes[letter as usize - 'X' as usize] = Some(value),
            'A' if machine_axes == 4 => self.request.axes[3] = Some(value),
            'F' => modes.feed_mm_per_min = value * modes.mm_per_unit(),
            'S' => {
                modes.s = value;
                self.request.has_s = true;
            }
            'T' => modes.tool = value as u32,
            'P' => self.p = Some(value),
            'N' => {}
            // Letters that grblHAL knows, but not on this machine.
            'A' | 'B' | 'C' | 'U' | 'V' | 'W' if firmware == Firmware::GrblHal => return Err(UNUSED_WORDS),
            _ => return Err(UNSUPPORTED),
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Request, u8> {
        let has_axes = self.request.axes.iter().any(Option::is_some);
        if self.is_dwell {
            self.request.dwell_s = Some(self.p.take().ok_or(MISSING_VALUE)?);
        }
        if self.p.is_some() {
            return Err(UNUSED_WORDS);
        }
        match self.request.axes_are {
            Axes::SetPosition if !has_axes => return Err(NO_AXES),
            Axes::Nothing if has_axes => {
                if self.request.modes.is_feed && self.request.modes.feed_mm_per_min <= 0.0 {
                    return Err(NO_FEED);
                }
                self.request.axes_are = Axes::Motion;
            }
            _ => {}
        }
        Ok(self.request)
    }
}
