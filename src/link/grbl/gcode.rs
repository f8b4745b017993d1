//! Lines of G-code: short, because a controller has little room for them, and each complete, so that a byte that was lost does not
//! change the lines behind it. `tests/grbl/main.rs` prints with it.

use layerd_wire::encoding::{LaserParameters, Vector};

/// Brings a controller that was reset to the modes and offsets that all lines here need: millimetres, absolute positions, G54 alone,
/// and the laser off.
pub(super) const PREAMBLE: [&str; 3] = ["G17G21G40G49G54G90G94", "G92.1", DARK];
/// Asks for the modes, and those that a layer needs.
pub(super) const MODES: &str = "$G";
pub(super) const MARKING_MODES: [&str; 5] = ["G54", "G21", "G90", "G94", "M4"];
/// Is answered when everything before it is done: a pause waits for all motion.
pub(super) const SYNC: &str = "G4P0.01";
/// The laser is on only while the beam moves, with power in proportion to its speed. `S` comes with the marks.
pub(super) const LASER: &str = "M4S0";
/// Asks for offsets.
pub(super) const OFFSETS: &str = "$#";
/// The plate goes to its zero.
pub(super) const PLATE_HOME: &str = "G0Z-0";
/// The laser off, in two words: if one is lost or changed on the line, the other one holds.
pub(super) const DARK: &str = "M5S0";

/// Length of the mark by which a point is melted, micrometres: less than any beam. The laser is off while the beam stands still.
const POINT_UM: i32 = 40;

/// Converts power to `S`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Power {
    /// The `S` of the greatest power.
    pub(super) max_s: f64,
    pub(super) max_power_mw: u32,
}

impl Power {
    /// Rounded to a thousandth of the greatest power or finer; never above it.
    fn s(self, power_mw: u32) -> String {
        let decimals = if self.max_s >= 1000.0 {
            0
        } else if self.max_s >= 100.0 {
            1
        } else {
            3
        };
        let s = (f64::from(power_mw) / f64::from(self.max_power_mw) * self.max_s).min(self.max_s);
        let scale = 10_f64.powi(decimals);
        ((s * scale).floor() / scale).to_string()
    }
}

/// A position in millimetres.
pub(super) fn mm(um: i32) -> String {
    (f64::from(um) / 1000.0).to_string()
}

/// A jump, with the laser off.
pub(super) fn jump(to_um: [i32; 2]) -> String {
    format!("G0X{}Y{}", mm(to_um[0]), mm(to_um[1]))
}

/// A mark.
pub(super) fn mark(to_um: [i32; 2], laser: &LaserParameters, power: Power) -> String {
    format!("G1X{}Y{}F{}S{}", mm(to_um[0]), mm(to_um[1]), feed(laser.mark_speed_um_s), power.s(laser.power_mw))
}

/// The plate's place is named so that it must go to 0 to move by `way_um`. A move that names its target could lose its point or its sign
/// on the line, and drive the part into the recoater. This can be read back before anything moves.
pub(super) fn name_plate(way_um: i32) -> String {
    format!("G92Z{}", mm(-way_um))
}

/// The plate goes to the 0 that [`name_plate`] has set, with the laser off. No byte of it can be lost so that it goes elsewhere; if the
/// digit is changed, it goes deeper, and its position shows that.
pub(super) fn plate_to_zero(speed_um_s: u32) -> String {
    format!("M5G1Z-0S0F{}", feed(speed_um_s))
}

/// Millimetres a minute.
fn feed(speed_um_s: u32) -> String {
    // At least 1: a feed of 0 is refused.
    (f64::from(speed_um_s) * 0.06).round().max(1.0).to_string()
}

/// The mark by which a vector is melted: itself, or a short mark in the place of a point, which takes the point's time.
pub(super) fn marked(
    vector: &Vector,
    laser: LaserParameters,
    field_um: [u32; 2],
) -> ([i32; 2], [i32; 2], LaserParameters) {
    if vector.from_um != vector.to_um {
        return (vector.from_um, vector.to_um, laser);
    }
    // The field is never so small that both ends are cut off.
    let [x, y] = vector.from_um;
    let right = i32::try_from(field_um[0]).unwrap_or(i32::MAX);
    let (from, to) = ((x - POINT_UM / 2).max(0), (x + POINT_UM / 2).min(right));
    let speed_um_s = u64::from(to.abs_diff(from)) * 1_000_000 / u64::from(laser.point_time_us.max(1));
    let mark_speed_um_s = u32::try_from(speed_um_s).unwrap_or(u32::MAX).max(1);
    ([from, y], [to, y], LaserParameters { mark_speed_um_s, ..laser })
}

#[cfg(test)]
mod tests {
    use super::*;
    use layerd_wire::encoding::MarkClass;

    const POWER: Power = Power { max_s: 1000.0, max_power_mw: 5_000 };

    #[test]
    fn lines_are_short_and_complete() {
        let laser = LaserParameters { power_mw: 2_500, mark_speed_um_s: 100_000, ..LaserParameters::default() };
        assert_eq!(mark([12_345, 500], &laser, POWER), "G1X12.345Y0.5F6000S500");
        assert_eq!(jump([100_000, 0]), "G0X100Y0");
        assert_eq!(name_plate(-30), "G92Z0.03");
        assert_eq!(plate_to_zero(2_000), "M5G1Z-0S0F120");
        assert!(PREAMBLE.iter().all(|line| line.len() < 79));
    }

    #[test]
    fn power_is_in_proportion_to_the_greatest_s_and_never_above_it() {
        let s = |max_s, power_mw| Power { max_s, max_power_mw: 4_999 }.s(power_mw);
        assert_eq!(s(1000.0, 4_999), "1000");
        assert_eq!(s(255.0, 2_500), "127.5");
        assert_eq!(s(1.0, 2_500), "0.5");
        assert_eq!(s(1000.0, 5_200), "1000");
    }

    #[test]
    fn a_point_is_a_short_mark_that_takes_its_time() {
        let vector = Vector { number: 3, class: MarkClass::Point, from_um: [10, 70], to_um: [10, 70] };
        let laser = LaserParameters { point_time_us: 1_000, mark_speed_um_s: 7, ..LaserParameters::default() };
        let (from, to, laser) = marked(&vector, laser, [1000, 1000]);
        assert_eq!((from, to, laser.mark_speed_um_s), ([0, 70], [30, 70], 30_000));
    }
}
