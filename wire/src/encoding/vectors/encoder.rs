//! Writes a layer of vectors; see [`vectors`](super) for an example.

use alloc::vec::Vec;

use super::error::VectorEncodeError;
use super::frame::HatchFrame;
use super::layer_crc::{LayerSum, Summing};
use super::symbol::{Field, SymbolWriter, zigzag};
use super::track::{FRAMES, MAX_RUN, Track, command, kind};
use super::{LaserParameters, MAX_VECTORS, MarkClass, VectorEncoding};

/// A hatch: part of a line of a [`HatchFrame`], marked from one end to the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HatchLine {
    /// Number of the line.
    pub line: i32,
    /// Where the mark begins, micrometres along the line from the frame's origin.
    pub from_um: i32,
    /// Where it ends; differs from `from_um`.
    pub to_um: i32,
}

/// Writes the vectors of one layer in the order in which they are marked. After an error the bytes are of no use.
#[derive(Debug)]
pub struct VectorEncoder<'a> {
    symbols: SymbolWriter<'a>,
    track: Track,
    field_um: [u32; 2],
    has_parameters: [bool; MarkClass::ALL.len()],
    sum: Summing,
    /// Slot of the next frame.
    next_slot: usize,
}

impl<'a> VectorEncoder<'a> {
    /// Begins a layer. `bytes` is cleared and keeps its memory. `table` has the laser parameters of each class that is used, in the
    /// order of the classes' numbers. The device's field has the sides `field_um`; more than [`MAX_FIELD_UM`](super::MAX_FIELD_UM)
    /// counts as that.
    ///
    /// # Errors
    /// [`VectorEncodeError::BadTable`].
    pub fn new(
        encoding: VectorEncoding,
        field_um: [u32; 2],
        table: &[(MarkClass, LaserParameters)],
        bytes: &'a mut Vec<u8>,
    ) -> Result<Self, VectorEncodeError> {
        if !table.is_sorted_by(|one, next| one.0 < next.0) {
            return Err(VectorEncodeError::BadTable);
        }
        let mut symbols = SymbolWriter::new(encoding, bytes);
        let (mut has_parameters, mut sum) = ([false; MarkClass::ALL.len()], Summing::default());
        // At most one entry a class.
        symbols.put(Field::Table, table.len() as u32);
        for (class, laser) in table {
            has_parameters[*class as usize] = true;
            sum.add_parameters(*class, laser);
            symbols.put(Field::Table, *class as u32);
            for (place, number) in laser.numbers().into_iter().enumerate() {
                let is_signed = place == LaserParameters::FOCUS;
                symbols.put(Field::Table, if is_signed { zigzag(number.cast_signed()) } else { number });
            }
        }
        Ok(Self { symbols, track: Track::new(field_um), field_um, has_parameters, sum, next_slot: 0 })
    }

    /// Writes connected vectors: from each point to the next. A single point is a point. No point is nothing.
    ///
    /// # Errors
    /// [`VectorEncodeError`].
    pub fn path(&mut self, class: MarkClass, points_um: &[[i32; 2]]) -> Result<(), VectorEncodeError> {
        let &[first, .., last] = points_um else { return self.points(class, points_um) };
        let steps = points_um.len() - 1;
        if first == last && (2..=MAX_RUN).contains(&steps) {
            self.begin(class, kind::RING, steps)?;
            self.steps(class, &points_um[..steps])?;
            return self.mark(class, first);
        }
        for from in (0..steps).step_by(MAX_RUN) {
            let end = steps.min(from + MAX_RUN);
            self.begin(class, kind::PATH, end - from)?;
            self.steps(class, &points_um[from..=end])?;
        }
        Ok(())
    }

    /// Writes points, each marked for the class's point time.
    ///
    /// # Errors
    /// [`VectorEncodeError`].
    pub fn points(&mut self, class: MarkClass, points_um: &[[i32; 2]]) -> Result<(), VectorEncodeError> {
        for run in points_um.chunks(MAX_RUN) {
            self.begin(class, kind::POINTS, run.len())?;
            for point_um in run {
                self.jump(*point_um)?;
                self.mark(class, *point_um)?;
            }
        }
        Ok(())
    }

    /// Writes hatches, with a jump to each.
    ///
    /// # Errors
    /// [`VectorEncodeError`].
    pub fn hatches(
        &mut self,
        class: MarkClass,
        frame: &HatchFrame,
        mut lines: impl ExactSizeIterator<Item = HatchLine>,
    ) -> Result<(), VectorEncodeError> {
        while lines.len() > 0 {
            self.frame(frame)?;
            let count = lines.len().min(MAX_RUN);
            self.begin(class, kind::HATCHES, count)?;
            for hatch in lines.by_ref().take(count) {
                let code = self.track.hatch_code(hatch).ok_or(VectorEncodeError::BadHatch)?;
                self.symbols.put(Field::Low, code.low);
                if let Some(turn) = code.turn {
                    self.symbols.put(Field::Turn, turn);
                }
                self.symbols.put(Field::High, code.high);
                let from_um = self.track.hatch(code).map_err(|_| self.hatch_outside(frame, hatch))?;
                self.count(class, from_um)?;
            }
        }
        Ok(())
    }

    /// Number of bytes so far; up to four more hold what was written last.
    pub fn written_bytes(&self) -> usize {
        self.symbols.written_bytes()
    }

    /// Ends the layer. Returns what a device computes of the vectors, too.
    pub fn finish(mut self) -> LayerSum {
        self.symbols.put(Field::Head { after: self.track.after }, command::END);
        self.symbols.finish();
        self.sum.finish()
    }

    /// Begins a run.
    fn begin(&mut self, class: MarkClass, kind: u8, count: usize) -> Result<(), VectorEncodeError> {
        if !self.has_parameters[class as usize] {
            return Err(VectorEncodeError::NoParameters(class));
        }
        let head = (count as u32) << 5 | u32::from(kind) << 3 | class as u32;
        self.symbols.put(Field::Head { after: self.track.after }, head);
        self.track.after = kind;
        Ok(())
    }

    fn jump(&mut self, point_um: [i32; 2]) -> Result<(), VectorEncodeError> {
        self.check(point_um)?;
        for (axis, number) in [0, 1].into_iter().zip(self.track.jump_to(point_um)) {
            self.symbols.put(Field::Jump { axis }, number);
        }
        self.track.begin_path(point_um).map_err(|_| self.outside(point_um))
    }

    /// Writes the first point and the steps to all others.
    fn steps(&mut self, class: MarkClass, points_um: &[[i32; 2]]) -> Result<(), VectorEncodeError> {
        let Some((first, others)) = points_um.split_first() else { return Ok(()) };
        self.jump(*first)?;
        for point_um in others {
            self.check(*point_um)?;
            let [x, y] = self.track.step_to(*point_um);
            self.symbols.put(self.track.step_field(None), x);
            self.symbols.put(self.track.step_field(Some(x)), y);
            let from_um = self.track.at_um;
            self.track.step([x, y]).map_err(|_| self.outside(*point_um))?;
            self.count(class, from_um)?;
        }
        Ok(())
    }

    /// The laser marks from where it is to a point that needs no bytes.
    fn mark(&mut self, class: MarkClass, to_um: [i32; 2]) -> Result<(), VectorEncodeError> {
        let from_um = core::mem::replace(&mut self.track.at_um, to_um);
        self.count(class, from_um)
    }

    /// Counts the vector that ends where the laser is.
    fn count(&mut self, class: MarkClass, from_um: [i32; 2]) -> Result<(), VectorEncodeError> {
        if self.sum.vectors() == MAX_VECTORS {
            return Err(VectorEncodeError::TooManyVectors);
        }
        self.sum.add(class, from_um, self.track.at_um);
        Ok(())
    }

    /// Makes a frame the present one.
    fn frame(&mut self, frame: &HatchFrame) -> Result<(), VectorEncodeError> {
        let is_same = |slot: &Option<super::track::Slot>| slot.as_ref().is_some_and(|slot| slot.frame == *frame);
        if is_same(&self.track.slots[self.track.slot]) {
            return Ok(());
        }
        let known = self.track.slots.iter().position(is_same);
        let slot = known.unwrap_or(self.next_slot);
        let head = if known.is_some() { command::SELECT } else { command::DEFINE };
        self.symbols.put(Field::Head { after: self.track.after }, head);
        self.track.after = kind::COMMAND;
        self.symbols.put(Field::Table, slot as u32);
        if known.is_some() {
            return self.track.select(slot).map_err(|_| VectorEncodeError::BadFrame);
        }
        for number in frame.origin_um.into_iter().chain(frame.along) {
            self.symbols.put(Field::Table, zigzag(number));
        }
        self.symbols.put(Field::Table, frame.spacing_nm);
        self.next_slot = (slot + 1) % FRAMES;
        self.track.define(slot, *frame).map_err(|_| VectorEncodeError::BadFrame)
    }

    fn check(&self, point_um: [i32; 2]) -> Result<(), VectorEncodeError> {
        if self.track.is_inside(point_um) { Ok(()) } else { Err(self.outside(point_um)) }
    }

    fn outside(&self, point_um: [i32; 2]) -> VectorEncodeError {
        VectorEncodeError::OutsideField { point_um, field_um: self.field_um }
    }

    /// The end of a hatch that lies outside the field.
    fn hatch_outside(&self, frame: &HatchFrame, hatch: HatchLine) -> VectorEncodeError {
        let HatchLine { line, from_um, to_um } = hatch;
        let Some(across_nm) = frame.across_nm(line) else { return VectorEncodeError::BadHatch };
        let ends = [from_um, to_um].map(|along_um| frame.point_across_um(across_nm, along_um));
        let outside = ends.into_iter().find(|end_um| !self.track.is_inside(*end_um));
        outside.map_or(VectorEncodeError::BadHatch, |end_um| self.outside(end_um))
    }
}
