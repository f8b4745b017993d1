//! What kind of controller the model is, how it is set, and what goes wrong with it.

use std::collections::BTreeMap;

/// Axes of every position in the model; the fourth is A.
pub const AXES: usize = 4;

/// The two firmwares, which differ in buffers, answers and what they do after an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Firmware {
    /// gnea/grbl 1.1.
    Grbl11,
    /// grblHAL.
    GrblHal,
}

/// Something that goes wrong. It counts from when it is given: at the start, or later by `GrblModel::inject`. `after_moves` counts lines
/// with a motion (G0 or G1) that were accepted; the line after them is the first that suffers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Every line is answered by noise.
    Garbage { after_moves: usize },
    /// The reset button is pressed: as 0x18.
    Reset { after_moves: usize },
    /// Power goes and comes back: the position is lost, what moved stands still.
    PowerLoss { after_moves: usize },
    /// No line is taken any more. Motion goes on; `?` and 0x18 still work, and 0x18 ends the fault.
    Stall { after_moves: usize },
    /// Nothing is answered any more, not even 0x18. Motion goes on to the end of what was planned.
    Silence { after_moves: usize },
    /// The port vanishes. Motion goes on. After `back_after_ms` of real time it is there again, if ever.
    Disconnect { after_moves: usize, back_after_ms: Option<u64> },
    /// One line is refused with this error although it is right.
    Refuse { after_moves: usize, error: u8 },
    /// One `ok` is lost on its way to the host.
    LoseOk { after_moves: usize },
    /// The n-th byte that the host sends is lost on the line, counted from 1.
    LoseByte { nth: usize },
    /// Bits of the n-th byte that the host sends are flipped on the line, counted from 1.
    FlipByte { nth: usize, mask: u8 },
}

impl Fault {
    /// How many motions it waits for; `None` if it counts bytes.
    pub(super) fn after_moves(&self) -> Option<usize> {
        match self {
            Self::Garbage { after_moves }
            | Self::Reset { after_moves }
            | Self::PowerLoss { after_moves }
            | Self::Stall { after_moves }
            | Self::Silence { after_moves }
            | Self::Disconnect { after_moves, .. }
            | Self::Refuse { after_moves, .. }
            | Self::LoseOk { after_moves } => Some(*after_moves),
            Self::LoseByte { .. } | Self::FlipByte { .. } => None,
        }
    }
}

/// How a model is set. The values of `new` are those of a laser machine that is ready: laser mode, `$30=1000`, no homing.
#[derive(Clone, Debug)]
pub struct Options {
    pub firmware: Firmware,
    /// How much faster than the real clock the machine's clock runs. All times in `Facts` are the machine's.
    pub speed_up: f64,
    /// The line's speed in baud, on the machine's clock.
    pub baud: u32,
    /// Bytes that the receive buffer holds. Those beyond are lost.
    pub receive_bytes: usize,
    /// Motions that the planner holds.
    pub planner_blocks: usize,
    /// Axes that the machine has: 3 (X, Y, Z) or 4 (and A).
    pub axes: usize,
    /// Settings by their `$` number.
    pub settings: BTreeMap<u16, f64>,
    /// The offset of G54, which `$#` shows as well.
    pub work_offset_mm: [f64; AXES],
    /// Reports come at most this often; `?` in between is not answered. 0 answers as fast as a real one.
    pub status_every_ms: u64,
    pub faults: Vec<Fault>,
}

impl Options {
    /// A laser machine that is ready to print.
    pub fn new(firmware: Firmware) -> Self {
        let mut settings = BTreeMap::new();
        for (number, value) in [
            (0, 10.0),
            (1, 25.0),
            (2, 0.0),
            (3, 0.0),
            (4, 0.0),
            (5, 0.0),
            (6, 0.0),
            (10, if firmware == Firmware::Grbl11 { 1.0 } else { 511.0 }),
            (11, 0.01),
            (12, 0.002),
            (13, 0.0),
            (20, 0.0),
            (21, 0.0),
            (22, 0.0),
            (23, 0.0),
            (24, 25.0),
            (25, 500.0),
            (26, 250.0),
            (27, 1.0),
            (30, 1000.0),
            (31, 0.0),
            (32, 1.0),
        ] {
            settings.insert(number, value);
        }
        for axis in 0..AXES as u16 {
            let is_plate = axis >= 2;
            settings.insert(100 + axis, 250.0);
            settings.insert(110 + axis, if is_plate { 600.0 } else { 6000.0 });
            settings.insert(120 + axis, if is_plate { 50.0 } else { 500.0 });
            settings.insert(130 + axis, 200.0);
        }
        let (receive_bytes, planner_blocks) = match firmware {
            Firmware::Grbl11 => (127, 15),
            Firmware::GrblHal => (1023, 35),
        };
        Self {
            firmware,
            speed_up: 1.0,
            baud: 115_200,
            receive_bytes,
            planner_blocks,
            axes: 3,
            settings,
            work_offset_mm: [0.0; AXES],
            status_every_ms: 0,
            faults: Vec::new(),
        }
    }

    /// With a setting changed.
    pub fn setting(mut self, number: u16, value: f64) -> Self {
        self.settings.insert(number, value);
        self
    }

    /// With a fault.
    pub fn fault(mut self, fault: Fault) -> Self {
        self.faults.push(fault);
        self
    }

    /// With homing that is required at power on: the machine starts in Alarm.
    pub fn homing_required(self) -> Self {
        let value = if self.firmware == Firmware::Grbl11 { 1.0 } else { 5.0 };
        self.setting(22, value)
    }
}
