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
    /// Those of `vectors`: see [`ScanClock`].
    pub fn of(vectors: &Vectors, lasers: &[LaserParameters; MarkClass::ALL.len()], axes: Option<&AxesMotion>) -> Self {
        let mut clock = ScanClock::new(lasers, axes);
        clock.add(vectors);
        clock.times()
    }
}

/// Adds up the times of a layer whose vectors come in groups.
#[derive(Clone, Debug)]
pub struct ScanClock<'a> {
    lasers: &'a [LaserParameters; MarkClass::ALL.len()],
    axes: Option<&'a AxesMotion>,
    at: Option<([i32; 2], MarkClass)>,
    laser_us: f64,
    dark_us: f64,
    vectors: u64,
}

impl<'a> ScanClock<'a> {
    /// At the start of a layer. `lasers` has the parameters of each class, in the order of the classes' numbers. Speeds of 0 count as
    /// 1 µm/s. The way from where the laser stands before the layer is not known and not counted. `axes` is for machines whose axes move the
    /// beam; other machines have a scanner.
    pub fn new(lasers: &'a [LaserParameters; MarkClass::ALL.len()], axes: Option<&'a AxesMotion>) -> Self {
        Self { lasers, axes, at: None, laser_us: 0.0, dark_us: 0.0, vectors: 0 }
    }

    /// Adds vectors. The laser is on for marks, for the delays between connected vectors, and for points. Axes that move the beam rest between
    /// two groups.
    pub fn add(&mut self, vectors: &Vectors) {
        if let Some(motion) = self.axes {
            let from_um = self.at.map(|(at_um, _)| at_um);
            let (laser_us, mark_us) = axes_time::times_us(vectors, self.lasers, motion, from_um);
            self.laser_us += laser_us;
            self.dark_us += mark_us - laser_us;
            self.vectors += vectors.mark_count();
            self.at = vectors.marks().last().map(|mark| (mark.to_um, mark.class)).or(self.at);
            return;
        }
        for mark in vectors.marks() {
            let laser = &self.lasers[mark.class as usize];
            match self.at {
                Some((at_um, _)) if at_um == mark.from_um => self.laser_us += f64::from(laser.polygon_delay_us),
                Some((at_um, class)) => {
                    self.dark_us += f64::from(self.lasers[class as usize].mark_delay_us);
                    self.dark_us += travel_us(at_um, mark.from_um, laser.jump_speed_um_s);
                    self.dark_us += f64::from(laser.jump_delay_us);
                }
                None => self.dark_us += f64::from(laser.jump_delay_us),
            }
            self.laser_us += match mark.from_um == mark.to_um {
                true => f64::from(laser.point_time_us),
                false => travel_us(mark.from_um, mark.to_um, laser.mark_speed_um_s),
            };
            self.at = Some((mark.to_um, mark.class));
            self.vectors += 1;
        }
    }

    /// The times of what was added.
    pub fn times(&self) -> ScanTimes {
        // `as` saturates: a layer has at most 2²⁷ vectors.
        let ms = |us: f64| (us / 1000.0).round() as u32;
        let (laser_ms, mark_ms) = (ms(self.laser_us), ms(self.laser_us + self.dark_us));
        ScanTimes { vectors: self.vectors as u32, laser_ms, mark_ms }
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
        // In two groups it is the same.
        let (mut first, mut second) = (Vectors::default(), Vectors::default());
        first.push_path(MarkClass::Contour, &[[0, 0], [10_000, 0], [10_000, 20_000]]);
        second.push_path(MarkClass::Point, &[[10_000, 45_000]]);
        let lasers = [laser; MarkClass::ALL.len()];
        let mut clock = ScanClock::new(&lasers, None);
        clock.add(&first);
        clock.add(&second);
        assert_eq!(clock.times(), times);
        assert_eq!(ScanTimes::of(&Vectors::default(), &[laser; MarkClass::ALL.len()], None), ScanTimes::default());
    }
}
