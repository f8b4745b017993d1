//! What encoder and decoder know of the vectors so far, and how numbers of the bytes follow from it. [`encoder`](super::encoder) and
//! [`decoder`](super::decoder) use it.

use super::error::VectorError;
use super::frame::{HatchFrame, MAX_DISTANCE_UM};
use super::symbol::{Field, from_zigzag, zigzag};
use super::{HatchLine, MAX_FIELD_UM};

/// Kinds of runs, as the head of a run has them.
pub(super) mod kind {
    /// Connected vectors.
    pub(in super::super) const PATH: u8 = 0;
    /// Connected vectors, the last of which ends where the first begins.
    pub(in super::super) const RING: u8 = 1;
    /// Single points.
    pub(in super::super) const POINTS: u8 = 2;
    /// Hatches.
    pub(in super::super) const HATCHES: u8 = 3;
    /// A head without vectors: a frame, or the end.
    pub(in super::super) const COMMAND: u8 = 4;
}

/// Heads without vectors.
pub(super) mod command {
    /// The layer ends.
    pub(in super::super) const END: u32 = 0;
    /// A frame follows.
    pub(in super::super) const DEFINE: u32 = 1;
    /// The number of a known frame follows.
    pub(in super::super) const SELECT: u32 = 2;
}

/// Most vectors of a run: a head takes at most three bytes as a varint, and 16 coded.
pub(super) const MAX_RUN: usize = (1 << 14) - 1;

/// Frames that a decoder remembers, 32 bytes each. A layer has a handful: one for each class and island angle. An encoder with more
/// overwrites the oldest.
pub(super) const FRAMES: usize = 16;

/// A frame, and the last hatch in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot {
    pub(super) frame: HatchFrame,
    line: i32,
    low_um: i32,
    high_um: i32,
}

/// A hatch as numbers of the bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct HatchCode {
    /// Twice the change of the low end, plus 1 if there is a turn.
    pub(super) low: u32,
    /// Twice the change of the line, plus 1 if the direction differs from the hatch before.
    pub(super) turn: Option<u32>,
    /// Change of the high end.
    pub(super) high: u32,
}

/// The state of a layer.
#[derive(Clone, Debug)]
pub(super) struct Track {
    field_um: [u32; 2],
    /// Where the laser is.
    pub(super) at_um: [i32; 2],
    /// The last vector of the path.
    delta_um: [i32; 2],
    /// Its turn against the one before: 1 to the left, −1 to the right.
    bend: i32,
    pub(super) slots: [Option<Slot>; FRAMES],
    /// Number of the present slot.
    pub(super) slot: usize,
    /// Change of the line, and of the direction, that the next hatch is expected to have.
    step: i32,
    flip: bool,
    /// Whether the last hatch ran against its line.
    is_reversed: bool,
    /// Kind of the run before.
    pub(super) after: u8,
}

impl Track {
    pub(super) fn new(field_um: [u32; 2]) -> Self {
        Self {
            field_um: field_um.map(|side_um| side_um.min(MAX_FIELD_UM)),
            at_um: [0; 2],
            delta_um: [0; 2],
            bend: 0,
            slots: [None; FRAMES],
            slot: 0,
            step: 1,
            flip: true,
            is_reversed: false,
            after: kind::COMMAND,
        }
    }

    pub(super) fn is_inside(&self, point_um: [i32; 2]) -> bool {
        let within = |(at_um, side_um): (i32, u32)| u32::try_from(at_um).is_ok_and(|at_um| at_um <= side_um);
        point_um.into_iter().zip(self.field_um).all(within)
    }

    /// The laser goes to a point.
    pub(super) fn go(&mut self, point_um: [i32; 2]) -> Result<(), VectorError> {
        if !self.is_inside(point_um) {
            return Err(VectorError::OutsideField);
        }
        self.at_um = point_um;
        Ok(())
    }

    /// The laser jumps to the start of a path.
    pub(super) fn begin_path(&mut self, point_um: [i32; 2]) -> Result<(), VectorError> {
        (self.delta_um, self.bend) = ([0; 2], 0);
        self.go(point_um)
    }

    /// Numbers of a jump to a point.
    pub(super) fn jump_to(&self, point_um: [i32; 2]) -> [u32; 2] {
        [0, 1].map(|axis| zigzag(point_um[axis] - self.at_um[axis]))
    }

    /// The point of [`jump_to`](Self::jump_to).
    pub(super) fn jump_end(&self, numbers: [u32; 2]) -> Result<[i32; 2], VectorError> {
        let [x, y] = [0, 1].map(|axis| self.at_um[axis].checked_add(from_zigzag(numbers[axis])));
        x.zip(y).map(|(x, y)| [x, y]).ok_or(VectorError::OutsideField)
    }

    /// Numbers of a path's next point: how its vector differs from the one before.
    pub(super) fn step_to(&self, point_um: [i32; 2]) -> [u32; 2] {
        [0, 1].map(|axis| zigzag(point_um[axis] - self.at_um[axis] - self.delta_um[axis]))
    }

    /// What the number of a step's x or, with the number of x, of its y is.
    pub(super) fn step_field(&self, x: Option<u32>) -> Field {
        let [dx, dy] = self.delta_um;
        let sign = three(dx) * 9 + three(dy) * 3 + three(self.bend);
        match x.map(from_zigzag) {
            None => Field::Step { axis: 0, size: five(dx) * 5 + five(dy), sign },
            Some(x) => Field::Step { axis: 1, size: five(dy) * 5 + five(x), sign: 27 + sign * 3 + three(x) },
        }
    }

    /// The laser marks to the point of [`step_to`](Self::step_to).
    pub(super) fn step(&mut self, numbers: [u32; 2]) -> Result<(), VectorError> {
        let [x0, y0] = self.delta_um;
        let change = |axis: usize| self.delta_um[axis].checked_add(from_zigzag(numbers[axis]));
        let (Some(x), Some(y)) = (change(0), change(1)) else { return Err(VectorError::OutsideField) };
        let sum = |axis: usize, by_um: i32| self.at_um[axis].checked_add(by_um).ok_or(VectorError::OutsideField);
        let to_um = [sum(0, x)?, sum(1, y)?];
        self.go(to_um)?;
        // Within a field, no product has more than 43 bits.
        let cross = i64::from(x0) * i64::from(y) - i64::from(y0) * i64::from(x);
        (self.delta_um, self.bend) = ([x, y], cross.signum() as i32);
        Ok(())
    }

    /// A frame takes a slot and is the present one.
    pub(super) fn define(&mut self, slot: usize, frame: HatchFrame) -> Result<(), VectorError> {
        let place = self.slots.get_mut(slot).ok_or(VectorError::BadFrame)?;
        if !frame.is_usable() {
            return Err(VectorError::BadFrame);
        }
        *place = Some(Slot { frame, line: 0, low_um: 0, high_um: 0 });
        self.slot = slot;
        Ok(())
    }

    /// The frame of a slot is the present one.
    pub(super) fn select(&mut self, slot: usize) -> Result<(), VectorError> {
        if self.slots.get(slot).is_none_or(Option::is_none) {
            return Err(VectorError::BadFrame);
        }
        self.slot = slot;
        Ok(())
    }

    /// Numbers of a hatch in the present frame; `None` if it has no length or is too far from the frame's origin.
    pub(super) fn hatch_code(&self, hatch: HatchLine) -> Option<HatchCode> {
        let slot = self.slots[self.slot].as_ref()?;
        let HatchLine { line, from_um, to_um } = hatch;
        let (low_um, high_um) = (from_um.min(to_um), from_um.max(to_um));
        slot.ends(line, low_um, high_um)?;
        let is_reversed = from_um > to_um;
        let (step, flip) = (line - slot.line, is_reversed != self.is_reversed);
        // Lines of a usable frame have numbers of 23 bits.
        let turn = (step != self.step || flip != self.flip).then_some(zigzag(step) << 1 | u32::from(flip));
        let low = zigzag(low_um - slot.low_um) << 1 | u32::from(turn.is_some());
        Some(HatchCode { low, turn, high: zigzag(high_um - slot.high_um) })
    }

    /// The hatch of [`hatch_code`](Self::hatch_code): the laser jumps to its begin, which is returned, and marks to its end.
    pub(super) fn hatch(&mut self, code: HatchCode) -> Result<[i32; 2], VectorError> {
        let slot = self.slots[self.slot].as_mut().ok_or(VectorError::BadFrame)?;
        let (step, flip) = match code.turn {
            Some(turn) => (from_zigzag(turn >> 1), turn & 1 == 1),
            None => (self.step, self.flip),
        };
        let moved = |from: i32, by: u32| from.checked_add(from_zigzag(by)).ok_or(VectorError::OutsideField);
        let line = slot.line.checked_add(step).ok_or(VectorError::OutsideField)?;
        let (low_um, high_um) = (moved(slot.low_um, code.low >> 1)?, moved(slot.high_um, code.high)?);
        let ends = slot.ends(line, low_um, high_um).ok_or(VectorError::OutsideField)?;
        (slot.line, slot.low_um, slot.high_um) = (line, low_um, high_um);
        self.is_reversed ^= flip;
        // Between two lines side by side, what comes next is mostly the same. A step further is the way to another place.
        if step.abs() == 1 {
            (self.step, self.flip) = (step, flip);
        }
        let [from_um, to_um] = if self.is_reversed { [ends[1], ends[0]] } else { ends };
        self.go(from_um)?;
        self.go(to_um)?;
        Ok(from_um)
    }
}

impl Slot {
    /// The ends of a hatch; `None` if it has no length or is too far from the frame's origin.
    fn ends(&self, line: i32, low_um: i32, high_um: i32) -> Option<[[i32; 2]; 2]> {
        let near = -MAX_DISTANCE_UM..=MAX_DISTANCE_UM;
        let across_nm = self.frame.across_nm(line)?;
        let is_good = near.contains(&low_um) && near.contains(&high_um) && low_um < high_um;
        is_good.then(|| [low_um, high_um].map(|along_um| self.frame.point_across_um(across_nm, along_um)))
    }
}

/// 0 for 0, 1 for positive, 2 for negative numbers.
fn three(number: i32) -> u8 {
    u8::from(number != 0) + u8::from(number < 0)
}

/// Class of a number's size, 0 to 4.
fn five(number: i32) -> u8 {
    let size = number.unsigned_abs();
    u8::from(size > 0) + u8::from(size > 7) + u8::from(size > 31) + u8::from(size > 63)
}
