//! How long a laser takes to mark a layer. `job/cycle/powder.rs` compares what a machine reports with it, and bounds its marking.

use super::axes_time::{self, AxesMotion};
use crate::layer::{LaserParameters, MarkClass, Vectors};

/// The times of a layer of scan vectors, computed from its vectors and the laser's parameters alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ScanTimes {
    /// Number of vectors.
    pub vectors: u32,
    /// How long the laser is on, milliseconds.
    pub laser_ms: u32,
    /// How long marking takes from the first jump to the last vector, milliseconds.
    pub mark_ms: u32,
}

impl ScanTimes {
    /// Those of `vectors`. `lasers` has the parameters of each class, in the order of the classes' numbers. Speeds of 0 count as 1 µm/s.
    /// The laser is on for marks, for the delays between connected vectors, and for points. The way from where the laser stands before
    /// the layer is not known and not counted. `axes` is for machines whose axes move the beam; other machines have a scanner.
    pub fn of(vectors: &Vectors, lasers: &[LaserParameters; MarkClass::ALL.len()], axes: Option<&AxesMotion>) -> Self {
        match axes {
            None => Self::of_scanner(vectors, lasers),
            Some(motion) => axes_time::times(vectors, lasers, motion),
        }
    }

    fn of_scanner(vectors: &Vectors, lasers: &[LaserParameters; MarkClass::ALL.len()]) -> Self {
        let (mut laser_us, mut dark_us) = (0.0, 0.0);
        let mut at: Option<([i32; 2], MarkClass)> = None;
        for mark in vectors.marks() {
            let laser = &lasers[mark.class as usize];
            match at {
                Some((at_um, _)) if at_um == mark.from_um => laser_us += f64::from(laser.polygon_delay_us),
                Some((at_um, class)) => {
                    dark_us += f64::from(lasers[class as usize].mark_delay_us);
                    dark_us += travel_us(at_um, mark.from_um, laser.jump_speed_um_s) + f64::from(laser.jump_delay_us);
                }
                None => dark_us += f64::from(laser.jump_delay_us),
            }
            laser_us += match mark.from_um == mark.to_um {
                true => f64::from(laser.point_time_us),
                false => travel_us(mark.from_um, mark.to_um, laser.mark_speed_um_s),
            };
            at = Some((mark.to_um, mark.class));
        }
        // `as` saturates: a layer has at most 2²⁷ vectors.
        let ms = |us: f64| (us / 1000.0).round() as u32;
        Self { vectors: vectors.mark_count() as u32, laser_ms: ms(laser_us), mark_ms: ms(laser_us + dark_us) }
    }
}

fn travel_us(from_um: [i32; 2], to_um: [i32; 2], speed_um_s: u32) -> f64 {
    let [x, y] = [0, 1].map(|axis| f64::from(to_um[axis]) - f64::from(from_um[axis]));
    x.hypot(y) * 1e6 / f64::from(speed_um_s.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_jumps_delays_and_points_add_up() {
        let laser = LaserParameters {
            mark_speed_um_s: 1_000_000,
            jump_speed_um_s: 5_000_000,
            jump_delay_us: 3_000,
            mark_delay_us: 2_000,
            polygon_delay_us: 1_000,
            point_time_us: 7_000,
            ..LaserParameters::default()
        };
        let mut vectors = Vectors::default();
        // 10 mm and 20 mm, a corner between them; then 25 mm to a point.
        vectors.push_path(MarkClass::Contour, &[[0, 0], [10_000, 0], [10_000, 20_000]]);
        vectors.push_path(MarkClass::Point, &[[10_000, 45_000]]);
        let times = ScanTimes::of(&vectors, &[laser; MarkClass::ALL.len()], None);
        assert_eq!(times.laser_ms, 10 + 1 + 20 + 7);
        assert_eq!(times.mark_ms, times.laser_ms + 3 + 2 + 5 + 3);
        assert_eq!(times.vectors, 3);
        assert_eq!(ScanTimes::of(&Vectors::default(), &[laser; MarkClass::ALL.len()], None), ScanTimes::default());
    }
}
