//! A layer while a grbl controller marks it: lines of G-code are made of its vectors, and its positions tell how far it is.
//! `tests/grbl/main.rs` prints with it.

use layerd_wire::encoding::{Vector, VectorDecoder};
use layerd_wire::powder::{LayerBuffer, StoredLayer, mark_us, usable};

use super::gcode::{self, Power};
use super::path::Path;
use super::sender::{Kind, Sender};
use super::settings::Controller;
use crate::link::message::ExposureId;

/// A layer that is being marked.
#[derive(Debug)]
pub(super) struct Marking {
    pub(super) id: ExposureId,
    pub(super) slot: usize,
    pub(super) from_vector: u32,
    /// Whether part of that vector may be marked.
    broken: Option<Broken>,
    /// When the act must end, apart from what the controller has already, microseconds.
    pub(super) deadline_us: u64,
    /// Why no more vectors are sent.
    pub(super) stopping: Option<&'static str>,
    /// `None` before the position of the beam is known, where the path starts.
    path: Option<Path>,
    /// `None` when all bytes of the layer were decoded.
    decoder: Option<VectorDecoder>,
    crc32: u32,
    field_um: [u32; 2],
    power: Power,
    /// Number of the layer's vectors, once all were decoded.
    vectors: Option<u32>,
    /// The beam stands at the end of all that the controller was sent.
    stands: bool,
    /// Since when everything that came is marked, and more must come, microseconds.
    starved_since_us: Option<u64>,
    starved_us: u64,
}

/// What making lines came to.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Made {
    /// There is more, or more must come.
    More,
    /// All lines are made, those that switch the laser off included.
    All,
    /// The layer was found to be bad, and why.
    Bad(String),
    /// The layer has fewer vectors than the one to begin with.
    NoSuchVector,
}

impl Marking {
    /// Of a layer in a slot, from a vector on, until `deadline_us`. Of that vector a part may be marked.
    pub(super) fn new(
        (slot, layer): (usize, &StoredLayer),
        (from_vector, broken): (u32, Option<Broken>),
        deadline_us: u64,
        field_um: [u32; 2],
        power: Power,
    ) -> Self {
        Self {
            id: layer.id,
            slot,
            from_vector,
            broken,
            deadline_us,
            stopping: None,
            path: None,
            decoder: Some(VectorDecoder::new(layer.encoding, field_um, layer.encoded_bytes)),
            crc32: layer.crc32,
            field_um,
            power,
            vectors: None,
            stands: false,
            starved_since_us: None,
            starved_us: 0,
        }
    }

    /// The beam stands here, and its path starts.
    pub(super) fn begin(&mut self, at_um: [i32; 2], controller: &Controller) {
        self.path = Some(Path::new(at_um, self.from_vector, controller.planner_blocks, controller.tolerance_um));
        self.stands = true;
    }

    /// Makes lines while there is room for them.
    pub(super) fn make(&mut self, buffer: &mut LayerBuffer, sender: &mut Sender, now_us: u64) -> Made {
        if self.path.is_none() {
            return Made::More;
        }
        while sender.has_room() {
            if self.stopping.is_some() {
                self.withdraw(sender.drop_waiting());
                return self.darken(sender, now_us);
            }
            let Some(decoder) = &mut self.decoder else { return self.darken(sender, now_us) };
            match buffer.decode(self.slot, decoder) {
                Err(error) => return Made::Bad(error.to_string()),
                Ok(Some(vector)) if vector.number < self.from_vector => {}
                Ok(Some(vector)) => {
                    self.starve(false, now_us);
                    if let Err(why) = self.add(&vector, sender) {
                        return Made::Bad(why);
                    }
                }
                Ok(None) if buffer.is_consumed(self.slot) => match self.finish() {
                    Made::All => {}
                    other => return other,
                },
                Ok(None) => {
                    self.starve(self.stands && sender.is_empty(), now_us);
                    return Made::More;
                }
            }
        }
        Made::More
    }

    /// Adds the last lines, which switch the laser off and are answered when all is done.
    fn darken(&mut self, sender: &mut Sender, now_us: u64) -> Made {
        self.starve(false, now_us);
        for line in [gcode::DARK, gcode::SYNC] {
            sender.push(line, Kind::Other);
        }
        Made::All
    }

    /// The end of the layer's bytes: checks them.
    fn finish(&mut self) -> Made {
        let Some(decoder) = self.decoder.take() else { return Made::All };
        match decoder.finish() {
            Err(error) => Made::Bad(error.to_string()),
            Ok(sum) if sum.crc32 != self.crc32 => Made::Bad("its vectors have another CRC than announced".into()),
            Ok(sum) if sum.vectors < self.from_vector => Made::NoSuchVector,
            Ok(sum) => {
                self.vectors = Some(sum.vectors);
                Made::All
            }
        }
    }

    /// Sends a vector.
    fn add(&mut self, vector: &Vector, sender: &mut Sender) -> Result<(), String> {
        let (Some(decoder), Some(path)) = (&self.decoder, &mut self.path) else { return Ok(()) };
        let laser = usable(decoder, vector, self.power.max_power_mw)
            .map_err(|error| format!("vector {}: {error}", vector.number))?;
        let (mut from_um, to_um, laser) = gcode::marked(vector, laser, self.field_um);
        if vector.number == self.from_vector {
            from_um = self.broken.and_then(|broken| broken.at_um).unwrap_or(from_um);
        }
        if path.end_um() != from_um {
            path.jump(from_um);
            sender.push(gcode::jump(from_um), Kind::Beam);
        }
        self.stands = false;
        path.mark(to_um, vector.number, mark_us(vector, &laser));
        sender.push(gcode::mark(to_um, &laser, self.power), Kind::Beam);
        Ok(())
    }

    /// Notes whether everything that came is marked, and more must come.
    fn starve(&mut self, is_starved: bool, now_us: u64) {
        match (is_starved, self.starved_since_us) {
            (true, None) => self.starved_since_us = Some(now_us),
            (false, Some(since_us)) => {
                self.starved_us += now_us.saturating_sub(since_us);
                self.starved_since_us = None;
            }
            _ => {}
        }
    }

    /// Whether the laser waits for bytes.
    pub(super) fn is_starved(&self) -> bool {
        self.starved_since_us.is_some()
    }

    /// The controller has taken a move.
    pub(super) fn answered(&mut self) {
        self.path.iter_mut().for_each(Path::answered);
    }

    /// The controller has refused a line. What came behind it, it may have carried out from another place.
    pub(super) fn refused(&mut self) {
        self.path.iter_mut().for_each(Path::refused);
    }

    /// So many lines that waited were not sent.
    pub(super) fn withdraw(&mut self, count: usize) {
        self.path.iter_mut().for_each(|path| path.withdraw(count));
    }

    /// The beam was seen here, while it moves. Returns whether that can be.
    pub(super) fn seen(&mut self, at_um: [i32; 2]) -> bool {
        self.path.as_mut().is_none_or(|path| path.seen(at_um))
    }

    /// The controller says whether it is at rest, and where the beam is. It says that it is at rest in the moment between reading a line
    /// and moving, too, so the place counts.
    pub(super) fn rests(&mut self, is_idle: bool, at_um: [i32; 2]) {
        self.stands = is_idle && self.path.as_ref().is_some_and(|path| path.is_at_end(at_um));
    }

    /// Where the path ends that was sent.
    pub(super) fn end_um(&self) -> Option<[i32; 2]> {
        self.path.as_ref().map(Path::end_um)
    }

    /// The beam is at the end of its path.
    pub(super) fn complete(&mut self) {
        self.path.iter_mut().for_each(Path::complete);
    }

    /// The first vector that is not known to be marked.
    pub(super) fn next_vector(&self) -> u32 {
        self.path.as_ref().map_or(self.from_vector, Path::next_vector)
    }

    /// Number of the layer's vectors if all were decoded.
    pub(super) fn vectors(&self) -> Option<u32> {
        self.vectors
    }

    /// How long the laser was on for the vectors that are known to be marked, milliseconds. Computed: a grbl controller does not tell.
    pub(super) fn laser_ms(&self) -> u32 {
        self.path.as_ref().map_or(0, |path| rounded_ms(path.laser_us()))
    }

    pub(super) fn starved_ms(&self) -> u32 {
        rounded_ms(self.starved_us)
    }

    /// What is known of a marking that ended early, with the beam at rest here.
    pub(super) fn cut(&self, at_um: [i32; 2], is_cut: bool) -> Cut {
        let rest = self.path.as_ref().map(|path| path.rest(at_um, is_cut));
        let next_vector = rest.map_or(self.from_vector, |rest| rest.next_vector);
        // If not even the first vector went on, the part of it that was marked before stays.
        let before = self.broken.filter(|_| next_vector == self.from_vector);
        let broken = match rest {
            Some(rest) if rest.is_broken => Some(Broken { at_um: rest.broken_um }),
            _ => before,
        };
        let laser_ms = rest.map_or(0, |rest| rounded_ms(rest.laser_us));
        self.cut_at(next_vector, broken, laser_ms)
    }

    /// What is known of it if the position tells nothing.
    pub(super) fn cut_somewhere(&self) -> Cut {
        self.cut_at(self.next_vector(), Some(Broken { at_um: None }), self.laser_ms())
    }

    fn cut_at(&self, next_vector: u32, broken: Option<Broken>, laser_ms: u32) -> Cut {
        let is_whole = self.vectors == Some(next_vector) && broken.is_none();
        Cut { id: self.id, is_whole, next_vector, broken, laser_ms }
    }
}

/// How far a layer is marked whose marking ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Cut {
    pub(super) id: ExposureId,
    /// Whether all of its vectors are marked.
    pub(super) is_whole: bool,
    /// The first vector that is not marked whole.
    pub(super) next_vector: u32,
    /// Whether part of that vector may be marked.
    pub(super) broken: Option<Broken>,
    /// How long the laser was on for whole vectors, milliseconds.
    pub(super) laser_ms: u32,
}

/// A vector of which a part may be marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Broken {
    /// Where the laser went off, if that is known. It goes on there if the operator has the vector repeated.
    pub(super) at_um: Option<[i32; 2]>,
}

/// Saturates, though no act takes so long.
fn rounded_ms(us: u64) -> u32 {
    u32::try_from((us + 500) / 1000).unwrap_or(u32::MAX)
}
