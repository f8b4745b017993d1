//! Characters become lines, and lines are answered: `$` commands here, G-code in `blocks.rs`.

use super::acts::RESET_TO_BANNER_US;
use super::blocks::{Doing, Step};
use super::gcode;
use super::machine::Machine;
use super::system;
use super::trouble::Sudden;

const NOT_IDLE: u8 = 8;
const LOCKED: u8 = 9;
const TOO_LONG: u8 = 11;
const HOMING_REQUIRED: u8 = 46;

impl Machine {
    /// One character of a line.
    pub(super) fn character(&mut self, byte: u8) {
        if byte == b'\n' || byte == b'\r' {
            let is_second = self.is_hal() && self.line.is_empty() && self.ended_by != 0 && self.ended_by != byte;
            if is_second {
                self.ended_by = 0;
                return;
            }
            self.ended_by = byte;
            let text = std::mem::take(&mut self.line);
            self.comment = None;
            if std::mem::take(&mut self.is_too_long) {
                self.answer(&text, TOO_LONG);
            } else {
                self.take_line(&text);
            }
            return;
        }
        match byte {
            // A comment after a semicolon goes on to the end of the line.
            b')' if self.comment != Some(b';') => self.comment = None,
            _ if self.comment.is_some() => {}
            b'(' | b';' => self.comment = Some(byte),
            0..=b' ' | b'/' => {}
            _ => {
                let largest = if self.is_hal() { 255 } else { 79 };
                if self.line.len() >= largest {
                    self.is_too_long = true;
                } else {
                    self.line.push(char::from(byte.to_ascii_uppercase()));
                }
            }
        }
    }

    pub(super) fn take_line(&mut self, text: &str) {
        if let Some(sudden) = self.trouble.sudden() {
            match sudden {
                Sudden::Reset => return self.reset(),
                Sudden::PowerLoss => return self.lose_power(),
                Sudden::Refuse(error) => return self.answer(text, error),
            }
        }
        if let Some(command) = text.strip_prefix('$') {
            if let Some(error) = self.command(command) {
                self.answer(text, error);
            }
            return;
        }
        let is_hal = self.is_hal();
        if text.is_empty() || (is_hal && text == "%") {
            return self.answer(text, 0);
        }
        if self.alarm.is_some() {
            return self.answer(text, LOCKED);
        }
        if is_hal && self.sticky_error != 0 {
            return self.answer(text, self.sticky_error);
        }
        match gcode::read(text, &self.modes, self.options.firmware, self.options.axes) {
            Err(error) => self.answer(text, error),
            Ok(request) => self.request(text, &request),
        }
    }

    /// Answers a line at once.
    pub(super) fn answer(&mut self, text: &str, error: u8) {
        self.note_line(text, error);
        self.sticky_error = error;
        if error == 0 {
            if !self.trouble.loses_ok() {
                self.say("ok\r\n");
            }
        } else {
            self.say(&format!("error:{error}\r\n"));
        }
    }

    /// Does a `$` line. Its error, or nothing if it is answered later.
    pub(super) fn command(&mut self, command: &str) -> Option<u8> {
        let is_idle = self.is_idle();
        let is_quiet = is_idle || self.alarm.is_some();
        let busy = Some(NOT_IDLE);
        let text = match command {
            "" => "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n".to_owned(),
            "G" => system::parser_state(&self.modes, self.options.firmware),
            "#" => system::offsets(&self.systems, &self.g92, &self.options),
            "I" | "$" | "N" if !is_quiet => return busy,
            "I" => system::build_info(&self.options),
            "$" => system::settings(&self.options),
            "N" => "$N0=\r\n$N1=\r\n".to_owned(),
            "X" => return Some(self.unlock()),
            "H" => return self.home(is_quiet),
            "C" => return Some(self.check(is_idle)),
            _ => return Some(self.set(command, is_quiet)),
        };
        self.say(&text);
        Some(0)
    }

    pub(super) fn unlock(&mut self) -> u8 {
        if self.alarm.is_none() {
            return 0;
        }
        if self.needs_homing {
            return HOMING_REQUIRED;
        }
        self.alarm = None;
        self.say("[MSG:Caution: Unlocked]\r\n");
        0
    }

    pub(super) fn home(&mut self, is_quiet: bool) -> Option<u8> {
        if self.number(22) as u32 & 1 == 0 {
            return Some(5);
        }
        if !is_quiet {
            return Some(NOT_IDLE);
        }
        self.note_line("$H", 0);
        self.sticky_error = 0;
        self.doing = Some(Doing { steps: [Step::Home].into(), is_move: false });
        None
    }

    pub(super) fn check(&mut self, is_idle: bool) -> u8 {
        if self.is_checking {
            self.say("[MSG:Disabled]\r\n");
            self.begin_start(RESET_TO_BANNER_US);
            return 0;
        }
        if !is_idle {
            return NOT_IDLE;
        }
        self.is_checking = true;
        self.say("[MSG:Enabled]\r\n");
        0
    }

    pub(super) fn set(&mut self, command: &str, is_quiet: bool) -> u8 {
        let Some((number, value)) = command.split_once('=') else { return 3 };
        if !is_quiet {
            return NOT_IDLE;
        }
        let unknown = if self.is_hal() { 53 } else { 3 };
        let Ok(number) = number.parse::<u16>() else { return 3 };
        if !system::has_setting(&self.options, number) {
            return unknown;
        }
        let Ok(value) = value.parse::<f64>() else { return gcode::BAD_NUMBER };
        if value < 0.0 {
            return 4;
        }
        if number == 20 && value != 0.0 && self.number(22) == 0.0 {
            return 10;
        }
        self.options.settings.insert(number, value);
        0
    }
}
