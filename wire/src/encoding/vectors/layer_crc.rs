//! What both ends compute of a layer's vectors to compare them. [`encoder`](super::encoder) and [`decoder`](super::decoder) use it.

use super::{LaserParameters, MarkClass};

/// Number of vectors of a layer, and the CRC-32 of what they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayerSum {
    /// Number of vectors.
    pub vectors: u32,
    /// CRC-32 (IEEE) over the laser parameters, 33 bytes a class, then over the vectors, 17 bytes each; `docs/encodings.md` says which.
    pub crc32: u32,
}

/// The sum of the vectors so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Summing {
    vectors: u32,
    crc: crc32fast::Hasher,
}

impl Summing {
    pub(super) fn add_parameters(&mut self, class: MarkClass, laser: &LaserParameters) {
        self.crc.update(&[class as u8]);
        for number in laser.numbers() {
            self.crc.update(&number.to_le_bytes());
        }
    }

    /// Adds a vector. Returns its number, from 0.
    pub(super) fn add(&mut self, class: MarkClass, from_um: [i32; 2], to_um: [i32; 2]) -> u32 {
        let mut bytes = [class as u8; 17];
        let numbers = [from_um[0], from_um[1], to_um[0], to_um[1]];
        for (place, number) in bytes[1..].chunks_exact_mut(4).zip(numbers) {
            place.copy_from_slice(&number.to_le_bytes());
        }
        self.crc.update(&bytes);
        self.vectors += 1;
        self.vectors - 1
    }

    pub(super) fn vectors(&self) -> u32 {
        self.vectors
    }

    pub(super) fn finish(self) -> LayerSum {
        LayerSum { vectors: self.vectors, crc32: self.crc.finalize() }
    }
}

impl LaserParameters {
    /// Number of parameters.
    pub(super) const COUNT: usize = 8;

    /// The parameters in the order of the bytes, the bits of signed ones as they are.
    pub(super) fn numbers(&self) -> [u32; Self::COUNT] {
        let Self { power_mw, mark_speed_um_s, jump_speed_um_s, focus_um, .. } = *self;
        let Self { jump_delay_us, mark_delay_us, polygon_delay_us, point_time_us, .. } = *self;
        let focus = focus_um.cast_unsigned();
        [
            power_mw,
            mark_speed_um_s,
            jump_speed_um_s,
            focus,
            jump_delay_us,
            mark_delay_us,
            polygon_delay_us,
            point_time_us,
        ]
    }

    /// What [`numbers`](Self::numbers) gave.
    pub(super) fn from_numbers(numbers: [u32; Self::COUNT]) -> Self {
        let [power_mw, mark_speed_um_s, jump_speed_um_s, focus, rest @ ..] = numbers;
        let [jump_delay_us, mark_delay_us, polygon_delay_us, point_time_us] = rest;
        let focus_um = focus.cast_signed();
        Self {
            power_mw,
            mark_speed_um_s,
            jump_speed_um_s,
            focus_um,
            jump_delay_us,
            mark_delay_us,
            polygon_delay_us,
            point_time_us,
        }
    }

    /// Place of the only signed parameter.
    pub(super) const FOCUS: usize = 3;
}
