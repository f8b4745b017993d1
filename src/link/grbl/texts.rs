//! What numbers of errors and alarms mean, and what to do. `tests/grbl/main.rs` shows some.

/// Error number of a grblHAL controller that must be homed before it moves.
pub(super) const HOMING_REQUIRED: u16 = 46;

/// Why the controller refused a line.
pub(super) fn error_text(number: u16) -> String {
    let meaning = match number {
        1..=3 | 23..=26 | 33 | 37 => {
            "a line arrived damaged: check cable and `baud`, and use flow_control = \"rts_cts\" if the controller has it"
        }
        5 => "homing is off: set $22=1 if the machine has limit switches",
        8 => "it was not idle",
        9 => "it is locked by an alarm: look at the machine, then resume",
        10 => "soft limits need homing: set $22=1, or $20=0",
        11 | 14 => "a line was too long: a line end was lost. Check cable and `baud`",
        15 | 39 => "a target lies outside the travel of an axis: check field_um, $130 to $132 and the offset of G54",
        20 => "it does not know a word of the line: check recoat_gcode, and that the firmware is grbl 1.1 or grblHAL",
        22 => "the feed rate was missing: a byte was lost. Check the cable",
        HOMING_REQUIRED => "it must be homed, which would raise the plate: take the part out, and start it again",
        _ => "see the firmware's list of errors",
    };
    format!("the controller refused a line with error:{number}: {meaning}")
}

/// Why the controller has locked itself.
pub(super) fn alarm_text(number: u16) -> String {
    let meaning = match number {
        1 => "a limit switch was hit, and the position is lost: look at the axes",
        2 => "a target lies outside the travel of an axis: check field_um, $130 to $132 and the offset of G54",
        3 => "it was reset while it moved, and may have lost its position",
        6..=9 => "homing failed: look at the limit switches and $23 to $27",
        10 => "its emergency stop is pressed: release it",
        11 => "it must be homed",
        _ => "see the firmware's list of alarms",
    };
    format!("the controller reports ALARM:{number}: {meaning}")
}

/// Whether the controller no longer knows where its axes are.
pub(super) fn loses_position(alarm: u16) -> bool {
    // 2: a target was refused. 3: a reset while it moved; whether the plate moved then is known.
    !matches!(alarm, 2 | 3)
}
