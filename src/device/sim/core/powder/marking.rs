//! A layer while it is marked: where the scanner is, whether the laser is on, and what comes next. Part of [`Powder`](super::Powder).
//!
//! Marking looks one vector ahead: whether the laser stays on after a vector depends on where the next one begins. A vector begins only
//! after it was decoded, so bytes that are late never interrupt one.

use layerd_wire::encoding::{LaserParameters, LayerSum, Vector, VectorDecoder};
use layerd_wire::powder::{LayerBuffer, StoredLayer, jump_us, mark_us, usable};

use super::melt::Melt;
use crate::link::message::ExposureId;

/// A layer that is being marked.
#[derive(Debug)]
pub(super) struct Marking {
    /// Number of the request, while its session lasts.
    pub(super) number: Option<u32>,
    pub(super) id: ExposureId,
    pub(super) slot: usize,
    pub(super) from_vector: u32,
    /// The first vector that is not marked whole.
    pub(super) next_vector: u32,
    pub(super) most_ms: u32,
    /// The laser went off within `next_vector`.
    pub(super) broken: bool,
    /// Why the laser stops at the end of its vector.
    pub(super) stopping: Option<&'static str>,
    /// How long the laser was on, and how long it waited for bytes, microseconds.
    laser_us: u64,
    starved_us: u64,
    /// When the act must end, apart from a vector that has begun.
    deadline_us: u64,
    phase: Phase,
    since_us: u64,
    /// Where the laser points, micrometres in the field.
    at_um: [i32; 2],
    /// `None` when all bytes of the layer were decoded.
    decoder: Option<VectorDecoder>,
    crc32: u32,
    max_power_mw: u32,
    ahead: Ahead,
    /// The vector that just ended, until it is [taken](Self::take_ended).
    ended: Option<MarkedVector>,
}

/// A vector that the laser was on, to its end or not. Only a device that [tells them](crate::device::sim::DeviceCore::telling_vectors) gives them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MarkedVector {
    /// The layer.
    pub id: ExposureId,
    /// The vector.
    pub vector: Vector,
    /// What laser and scanner did.
    pub laser: LaserParameters,
    /// When the laser went on for it, microseconds of the device's clock.
    pub began_us: u64,
    /// When it ended, or the laser went off within it, microseconds of the device's clock.
    pub ended_us: u64,
    /// Whether it was marked to its end.
    pub is_whole: bool,
}

/// What the laser does.
#[derive(Clone, Copy, Debug)]
enum Phase {
    /// Off, until bytes come.
    Starved,
    /// Off, on the way to the next vector, which begins at this time.
    Jumping(u64, Vector, LaserParameters),
    /// On, between two connected vectors. The next one begins at this time.
    Turning(u64, Vector, LaserParameters),
    /// On, marking a vector, which ends at this time.
    Lit(u64, Vector, LaserParameters),
}

/// What follows the vector that is being marked.
#[derive(Clone, Debug)]
enum Ahead {
    /// Its bytes have not come.
    Unknown,
    Vector(Vector, LaserParameters),
    /// The layer is over, and all was right.
    End(LayerSum),
    /// Bytes that are no vector, or vectors with another CRC than announced.
    Bad(String),
}

/// How a marking ends.
#[derive(Debug)]
pub(super) enum End {
    /// All vectors are marked; so many are in the layer.
    Whole(u32),
    /// It ended early, and why.
    Cut(&'static str),
    /// The layer was found to be bad while it came, and why.
    Bad(String),
    /// The layer has fewer vectors than the one to begin with.
    NoSuchVector,
}

impl Marking {
    /// Marking begins now, with the scanner at `at_um`. `layer` is in `slot`.
    pub(super) fn new(
        (number, slot, layer): (u32, usize, &StoredLayer),
        (from_vector, most_ms): (u32, u32),
        field_um: [u32; 2],
        max_power_mw: u32,
        at_um: [i32; 2],
        now_us: u64,
    ) -> Self {
        Self {
            number: Some(number),
            id: layer.id,
            slot,
            from_vector,
            next_vector: from_vector,
            most_ms,
            broken: false,
            stopping: None,
            laser_us: 0,
            starved_us: 0,
            deadline_us: now_us + u64::from(most_ms) * 1000,
            phase: Phase::Starved,
            since_us: now_us,
            at_um,
            decoder: Some(VectorDecoder::new(layer.encoding, field_um, layer.encoded_bytes)),
            crc32: layer.crc32,
            max_power_mw,
            ahead: Ahead::Unknown,
            ended: None,
        }
    }

    /// The vector that ended in the last step, or was interrupted.
    pub(super) fn take_ended(&mut self) -> Option<MarkedVector> {
        self.ended.take()
    }

    fn note_ended(&mut self, vector: Vector, laser: LaserParameters, ended_us: u64, is_whole: bool) {
        self.ended = Some(MarkedVector { id: self.id, vector, laser, began_us: self.since_us, ended_us, is_whole });
    }

    /// When [`step`](Self::step) is due.
    pub(super) fn due_us(&self) -> u64 {
        match self.phase {
            Phase::Starved => self.deadline_us,
            // A vector that has begun ends.
            Phase::Lit(until_us, ..) => until_us,
            Phase::Jumping(until_us, ..) | Phase::Turning(until_us, ..) => until_us.min(self.deadline_us),
        }
    }

    /// Whether the laser is commanded on, or between two vectors.
    pub(super) fn light_on(&self) -> bool {
        !matches!(self.phase, Phase::Starved)
    }

    /// Whether a vector is being marked.
    pub(super) fn is_in_vector(&self) -> bool {
        matches!(self.phase, Phase::Lit(..))
    }

    pub(super) fn laser_ms(&self) -> u32 {
        rounded_ms(self.laser_us)
    }

    pub(super) fn starved_ms(&self) -> u32 {
        rounded_ms(self.starved_us)
    }

    /// Where the laser points, micrometres in the field.
    pub(super) fn at_um(&self) -> [i32; 2] {
        self.at_um
    }

    /// Decodes the vector behind the present one, if its bytes are there; vectors before the first are passed over.
    fn look_ahead(&mut self, buffer: &mut LayerBuffer) {
        while let (Ahead::Unknown, Some(decoder)) = (&self.ahead, &mut self.decoder) {
            self.ahead = match buffer.decode(self.slot, decoder) {
                Err(error) => Ahead::Bad(error.to_string()),
                Ok(Some(vector)) if vector.number < self.from_vector => continue,
                Ok(Some(vector)) => match usable(decoder, &vector, self.max_power_mw) {
                    Ok(laser) => Ahead::Vector(vector, laser),
                    Err(error) => Ahead::Bad(format!("vector {}: {error}", vector.number)),
                },
                Ok(None) if buffer.is_consumed(self.slot) => self.end_of_layer(),
                Ok(None) => return,
            };
        }
    }

    fn end_of_layer(&mut self) -> Ahead {
        match self.decoder.take().map(VectorDecoder::finish) {
            Some(Ok(sum)) if sum.crc32 == self.crc32 => Ahead::End(sum),
            Some(Err(error)) => Ahead::Bad(error.to_string()),
            _ => Ahead::Bad("its vectors have another CRC than announced".into()),
        }
    }

    /// Goes on if the laser waits for bytes, and they are there.
    pub(super) fn resume(&mut self, buffer: &mut LayerBuffer, now_us: u64) -> Option<End> {
        self.look_ahead(buffer);
        if matches!(self.phase, Phase::Starved) && !matches!(self.ahead, Ahead::Unknown) {
            self.end_phase(now_us);
            return self.go_on(None, now_us);
        }
        None
    }

    /// What is due happens, at its own time.
    pub(super) fn step(&mut self, buffer: &mut LayerBuffer, melt: Option<&mut Melt>) -> Option<End> {
        let now_us = self.due_us();
        if let Phase::Lit(_, vector, laser) = self.phase {
            self.note_ended(vector, laser, now_us, true);
        }
        self.end_phase(now_us);
        let is_late = now_us >= self.deadline_us;
        match self.phase {
            Phase::Starved => Some(End::Cut("most_ms")),
            Phase::Jumping(..) | Phase::Turning(..) if is_late => Some(End::Cut("most_ms")),
            Phase::Jumping(_, vector, laser) | Phase::Turning(_, vector, laser) => {
                self.at_um = vector.from_um;
                self.phase = Phase::Lit(now_us + mark_us(&vector, &laser), vector, laser);
                self.look_ahead(buffer);
                None
            }
            Phase::Lit(_, vector, laser) => {
                if let Some(melt) = melt {
                    melt.sweep(vector.from_um.map(f64::from), vector.to_um.map(f64::from));
                }
                self.at_um = vector.to_um;
                self.next_vector = vector.number + 1;
                let stopping = self.stopping.or(is_late.then_some("most_ms"));
                match stopping {
                    Some(reason) if !matches!(self.ahead, Ahead::End(_)) => Some(End::Cut(reason)),
                    _ => self.go_on(Some(&laser), now_us),
                }
            }
        }
    }

    /// Begins what follows a vector, or the first vector of the act. `before` are the parameters of the vector that just ended.
    fn go_on(&mut self, before: Option<&LaserParameters>, now_us: u64) -> Option<End> {
        let (vector, laser) = match std::mem::replace(&mut self.ahead, Ahead::Unknown) {
            Ahead::Unknown => {
                self.phase = Phase::Starved;
                return None;
            }
            Ahead::End(sum) if sum.vectors < self.from_vector => return Some(End::NoSuchVector),
            Ahead::End(sum) => return Some(End::Whole(sum.vectors)),
            Ahead::Bad(why) => return Some(End::Bad(why)),
            Ahead::Vector(vector, laser) => (vector, laser),
        };
        let is_connected = vector.from_um == self.at_um;
        self.phase = match before {
            Some(before) if is_connected => Phase::Turning(now_us + u64::from(before.polygon_delay_us), vector, laser),
            None if is_connected => Phase::Jumping(now_us, vector, laser),
            _ => {
                let mark_delay_us = before.map_or(0, |before| before.mark_delay_us);
                let delays_us = u64::from(mark_delay_us) + u64::from(laser.jump_delay_us);
                let way_us = jump_us(self.at_um, vector.from_um, &laser);
                Phase::Jumping(now_us + delays_us + way_us, vector, laser)
            }
        };
        None
    }

    /// Stops everything now, also inside of a vector.
    pub(super) fn interrupt(&mut self, melt: Option<&mut Melt>, now_us: u64) {
        if let Phase::Lit(until_us, vector, laser) = self.phase {
            self.broken = true;
            self.note_ended(vector, laser, now_us, false);
            let whole_us = until_us.saturating_sub(self.since_us).max(1) as f64;
            let share = (now_us.saturating_sub(self.since_us) as f64 / whole_us).min(1.0);
            let [from_um, to_um] = [vector.from_um, vector.to_um].map(|point| point.map(f64::from));
            let at_um = [0, 1].map(|axis| from_um[axis] + share * (to_um[axis] - from_um[axis]));
            self.at_um = at_um.map(|um| um.round() as i32);
            if let Some(melt) = melt {
                melt.sweep(from_um, at_um);
            }
        }
        self.end_phase(now_us);
    }

    /// Counts the time of the present phase, which ends now.
    fn end_phase(&mut self, now_us: u64) {
        let spent_us = now_us.saturating_sub(self.since_us);
        match self.phase {
            Phase::Starved => self.starved_us += spent_us,
            Phase::Jumping(..) => {}
            Phase::Turning(..) | Phase::Lit(..) => self.laser_us += spent_us,
        }
        self.since_us = now_us;
    }
}

/// Saturates, though no act takes so long.
fn rounded_ms(us: u64) -> u32 {
    u32::try_from((us + 500) / 1000).unwrap_or(u32::MAX)
}
