//! Decodes a layer of vectors whose bytes arrive in pieces; see [`vectors`](super) for an example.

use super::error::VectorError;
use super::frame::HatchFrame;
use super::layer_crc::{LayerSum, Summing};
use super::symbol::{Field, SymbolReader, from_zigzag};
use super::track::{HatchCode, Track, command, kind};
use super::{LaserParameters, MAX_VECTORS, MarkClass, VectorEncoding};

/// One vector: a mark from one point to another, or a timed point if they are equal. Micrometres in the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Vector {
    /// Its number in the layer, from 0.
    pub number: u32,
    /// Its class.
    pub class: MarkClass,
    /// Where it begins. The laser jumps there unless the vector before ends there.
    pub from_um: [i32; 2],
    /// Where it ends.
    pub to_um: [i32; 2],
}

/// Turns the bytes of one layer, given in pieces, into vectors. Its memory does not grow with them.
#[derive(Debug)]
pub struct VectorDecoder {
    symbols: SymbolReader,
    /// Bytes of the layer that were not taken yet.
    bytes_left: u32,
    track: Track,
    table: [Option<LaserParameters>; MarkClass::ALL.len()],
    state: State,
    sum: Summing,
    failed: Option<VectorError>,
}

/// Numbers of a frame: slot, origin, direction, spacing.
const FRAME_NUMBERS: usize = 6;

/// What comes next.
#[derive(Clone, Copy, Debug)]
enum State {
    /// Number of classes.
    Classes,
    /// The next class of the table; so many are left.
    Class(u32),
    /// The next parameter of a class, after some.
    Parameter { class: MarkClass, numbers: [u32; LaserParameters::COUNT], done: usize, left: u32 },
    /// Head of a run.
    Head,
    /// Number of a known frame.
    Select,
    /// The next number of a frame, after some: slot, origin, direction, spacing.
    Frame { numbers: [u32; FRAME_NUMBERS], done: usize },
    /// Begin of a path, or a point; `x` is there or not.
    Begin { run: Run, x: Option<u32> },
    /// Next point of a path.
    Step { run: Run, x: Option<u32>, first_um: [i32; 2] },
    /// The vector that closes a ring. It needs no bytes.
    Close { class: MarkClass, first_um: [i32; 2] },
    /// Low end of a hatch.
    Low(Run),
    /// Turn of a hatch, after its low end.
    Turn(Run, u32),
    /// High end of a hatch, after low end and turn.
    High(Run, u32, Option<u32>),
    /// The layer is complete.
    End,
}

/// A run that is being read.
#[derive(Clone, Copy, Debug)]
struct Run {
    class: MarkClass,
    kind: u8,
    /// Points of a path after its first, points, or hatches that are still to come.
    left: u32,
}

impl VectorDecoder {
    /// A decoder for one layer of `encoded_bytes` bytes. The field is the device's own, never taken from the line; a side longer than
    /// [`MAX_FIELD_UM`](super::MAX_FIELD_UM) counts as that.
    pub fn new(encoding: VectorEncoding, field_um: [u32; 2], encoded_bytes: u32) -> Self {
        Self {
            symbols: SymbolReader::new(encoding),
            bytes_left: encoded_bytes,
            track: Track::new(field_um),
            table: [None; MarkClass::ALL.len()],
            state: State::Classes,
            sum: Summing::default(),
            failed: None,
        }
    }

    /// The laser parameters of a class; `None` if the layer has none or they have not arrived. They arrive before the first vector.
    pub fn parameters(&self, class: MarkClass) -> Option<&LaserParameters> {
        self.table[class as usize].as_ref()
    }

    /// The next vector. Takes bytes from the front of `bytes` as it needs them, and leaves the rest. `None`: it has taken all, and needs
    /// more of them, or the layer is complete.
    ///
    /// # Errors
    /// [`VectorError`]; every later call returns the same error.
    pub fn next(&mut self, bytes: &mut &[u8]) -> Result<Option<Vector>, VectorError> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        let result = self.advance(bytes);
        self.failed = result.err();
        result
    }

    /// Ends the layer, after [`next`](Self::next) returned `None`. Returns what the host's encoder computed, too.
    ///
    /// # Errors
    /// [`VectorError`].
    pub fn finish(self) -> Result<LayerSum, VectorError> {
        match self.failed {
            Some(error) => Err(error),
            None if !matches!(self.state, State::End) => Err(VectorError::TooFewBytes),
            None => self.symbols.check_end(self.bytes_left).map(|()| self.sum.finish()),
        }
    }

    fn advance(&mut self, bytes: &mut &[u8]) -> Result<Option<Vector>, VectorError> {
        // No layer has more bytes than a number of 32 bits.
        let given = u32::try_from(bytes.len()).ok();
        let more = given.and_then(|given| self.bytes_left.checked_sub(given)).ok_or(VectorError::TooManyBytes)?;
        // Every turn takes a number, which is at least a byte or a bit of one, or returns.
        loop {
            if let State::Close { class, first_um } = self.state {
                let from_um = core::mem::replace(&mut self.track.at_um, first_um);
                self.state = State::Head;
                return self.vector(class, from_um).map(Some);
            }
            if let State::End = self.state {
                return if bytes.is_empty() { Ok(None) } else { Err(VectorError::TooManyBytes) };
            }
            let number = self.symbols.take(self.field(), bytes, more)?;
            self.bytes_left = more + bytes.len() as u32;
            let Some(number) = number else { return Ok(None) };
            if let Some(vector) = self.accept(number)? {
                return Ok(Some(vector));
            }
        }
    }

    /// What the next number is.
    fn field(&self) -> Field {
        match self.state {
            State::Head => Field::Head { after: self.track.after },
            State::Begin { x, .. } => Field::Jump { axis: u8::from(x.is_some()) },
            State::Step { x, .. } => self.track.step_field(x),
            State::Low(_) => Field::Low,
            State::Turn(..) => Field::Turn,
            State::High(..) => Field::High,
            // The last two take no number.
            State::Classes | State::Class(_) | State::Parameter { .. } | State::Select | State::Frame { .. } => {
                Field::Table
            }
            State::Close { .. } | State::End => Field::Table,
        }
    }

    /// Takes the next number. Returns the vector that it completes.
    fn accept(&mut self, number: u32) -> Result<Option<Vector>, VectorError> {
        match self.state {
            State::Classes if number as usize > MarkClass::ALL.len() => return Err(VectorError::BadCode),
            State::Classes => self.state = self.table_left(number),
            State::Class(left) => {
                let class = MarkClass::from_number(number).ok_or(VectorError::BadCode)?;
                // Ascending: no class before has parameters at this number or above.
                if self.table[number as usize..].iter().any(Option::is_some) {
                    return Err(VectorError::BadCode);
                }
                self.state = State::Parameter { class, numbers: [0; LaserParameters::COUNT], done: 0, left };
            }
            State::Parameter { class, numbers, done, left } => self.parameter(class, numbers, done, left, number),
            State::Head => self.head(number)?,
            State::Select => {
                self.track.select(number as usize)?;
                self.state = State::Head;
            }
            State::Frame { numbers, done } => self.frame(numbers, done, number)?,
            State::Begin { run, x: None } => self.state = State::Begin { run, x: Some(number) },
            State::Begin { run, x: Some(x) } => return self.begin(run, [x, number]),
            State::Step { run, x: None, first_um } => self.state = State::Step { run, x: Some(number), first_um },
            State::Step { run, x: Some(x), first_um } => return self.step(run, [x, number], first_um).map(Some),
            State::Low(run) if number & 1 == 1 => self.state = State::Turn(run, number),
            State::Low(run) => self.state = State::High(run, number, None),
            State::Turn(run, low) => self.state = State::High(run, low, Some(number)),
            State::High(run, low, turn) => return self.hatch(run, HatchCode { low, turn, high: number }).map(Some),
            State::Close { .. } | State::End => {}
        }
        Ok(None)
    }

    fn table_left(&self, left: u32) -> State {
        if left > 0 { State::Class(left - 1) } else { State::Head }
    }

    fn parameter(
        &mut self,
        class: MarkClass,
        mut numbers: [u32; LaserParameters::COUNT],
        done: usize,
        left: u32,
        number: u32,
    ) {
        let is_signed = done == LaserParameters::FOCUS;
        numbers[done] = if is_signed { from_zigzag(number).cast_unsigned() } else { number };
        if done + 1 < LaserParameters::COUNT {
            self.state = State::Parameter { class, numbers, done: done + 1, left };
            return;
        }
        let laser = LaserParameters::from_numbers(numbers);
        self.sum.add_parameters(class, &laser);
        self.table[class as usize] = Some(laser);
        self.state = self.table_left(left);
    }

    fn head(&mut self, number: u32) -> Result<(), VectorError> {
        let (left, kind) = (number >> 5, (number >> 3 & 3) as u8);
        if left == 0 {
            self.track.after = kind::COMMAND;
            self.state = match number {
                command::END => State::End,
                command::DEFINE => State::Frame { numbers: [0; FRAME_NUMBERS], done: 0 },
                command::SELECT => State::Select,
                _ => return Err(VectorError::BadCode),
            };
            return Ok(());
        }
        let class = MarkClass::from_number(number & 7).ok_or(VectorError::BadCode)?;
        if self.parameters(class).is_none() {
            return Err(VectorError::NoParameters);
        }
        self.track.after = kind;
        let run = Run { class, kind, left };
        self.state = match kind {
            kind::HATCHES => State::Low(run),
            // A ring has its first point, and steps to the others.
            kind::RING if left < 2 => return Err(VectorError::BadCode),
            kind::RING => State::Begin { run: Run { left: left - 1, ..run }, x: None },
            _ => State::Begin { run, x: None },
        };
        Ok(())
    }

    fn frame(&mut self, mut numbers: [u32; FRAME_NUMBERS], done: usize, number: u32) -> Result<(), VectorError> {
        numbers[done] = number;
        if done + 1 < FRAME_NUMBERS {
            self.state = State::Frame { numbers, done: done + 1 };
            return Ok(());
        }
        let [slot, x, y, along_x, along_y, spacing_nm] = numbers;
        let (origin_um, along) = ([x, y].map(from_zigzag), [along_x, along_y].map(from_zigzag));
        self.state = State::Head;
        self.track.define(slot as usize, HatchFrame { origin_um, along, spacing_nm })
    }

    fn begin(&mut self, run: Run, numbers: [u32; 2]) -> Result<Option<Vector>, VectorError> {
        let first_um = self.track.jump_end(numbers)?;
        self.track.begin_path(first_um)?;
        if run.kind != kind::POINTS {
            self.state = State::Step { run, x: None, first_um };
            return Ok(None);
        }
        let run = Run { left: run.left - 1, ..run };
        self.state = if run.left > 0 { State::Begin { run, x: None } } else { State::Head };
        self.vector(run.class, first_um).map(Some)
    }

    fn step(&mut self, run: Run, numbers: [u32; 2], first_um: [i32; 2]) -> Result<Vector, VectorError> {
        let from_um = self.track.at_um;
        self.track.step(numbers)?;
        let run = Run { left: run.left - 1, ..run };
        self.state = match run.kind {
            _ if run.left > 0 => State::Step { run, x: None, first_um },
            kind::RING => State::Close { class: run.class, first_um },
            _ => State::Head,
        };
        self.vector(run.class, from_um)
    }

    fn hatch(&mut self, run: Run, code: HatchCode) -> Result<Vector, VectorError> {
        let from_um = self.track.hatch(code)?;
        let run = Run { left: run.left - 1, ..run };
        self.state = if run.left > 0 { State::Low(run) } else { State::Head };
        self.vector(run.class, from_um)
    }

    /// The vector that ends where the laser is.
    fn vector(&mut self, class: MarkClass, from_um: [i32; 2]) -> Result<Vector, VectorError> {
        if self.sum.vectors() == MAX_VECTORS {
            return Err(VectorError::TooManyVectors);
        }
        let to_um = self.track.at_um;
        let number = self.sum.add(class, from_um, to_um);
        Ok(Vector { number, class, from_um, to_um })
    }
}
