//! The buffer that all layers of a powder machine share: their bytes as they came, and the count by which the host knows how much room
//! there is. `docs/protocol.md`, "The buffer", has the rules.

use alloc::collections::VecDeque;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::scan::usable;
use crate::encoding::{Vector, VectorDecoder, VectorEncoding, VectorError};
use crate::message::{ExposureId, PowderCapabilities};

/// Least growth of the count that is reported while the buffer still holds the layer, bytes: a report of less room would cost more of
/// the line than the room is worth. It is at most a quarter of a buffer, which has at least 1024 bytes.
const MIN_REPORT_BYTES: u32 = 256;

/// The layers in the slots, complete or not.
#[derive(Debug)]
pub struct LayerBuffer {
    capabilities: PowderCapabilities,
    slots: Vec<Option<StoredLayer>>,
    /// The slot of the layer whose bytes come.
    receiving: Option<usize>,
    // The counts wrap, as they do on the line. They begin at 0 with each session, when the buffer is empty.
    /// Bytes of layer data that came.
    received: u32,
    /// Of these, the bytes that left the buffer.
    taken: u32,
    /// What the host knows of `taken`.
    reported: u32,
    /// Whether to report any growth: a layer has left the buffer, or one begins.
    owes_report: bool,
}

/// A layer that a [`LayerBegin`](crate::message::Request::LayerBegin) announces.
#[derive(Clone, Copy, Debug)]
pub struct AnnouncedLayer {
    /// Number of the request.
    pub number: u32,
    /// The layer's name.
    pub id: ExposureId,
    /// How it is encoded.
    pub encoding: VectorEncoding,
    /// Number of its bytes.
    pub encoded_bytes: u32,
    /// CRC-32 of its vectors.
    pub crc32: u32,
}

/// A layer in a slot.
#[derive(Debug)]
pub struct StoredLayer {
    /// Number of its request.
    pub number: u32,
    /// Its name.
    pub id: ExposureId,
    /// How it is encoded.
    pub encoding: VectorEncoding,
    /// Number of its bytes.
    pub encoded_bytes: u32,
    /// CRC-32 of its vectors, as announced.
    pub crc32: u32,
    /// Number of its vectors; `None` before all of them came.
    pub vectors: Option<u32>,
    /// Whether it may be marked: it was answered with Done.
    pub is_ready: bool,
    /// Bytes that have not come yet.
    missing_bytes: u32,
    bytes: VecDeque<u8>,
    /// Decodes the bytes as they come, until the layer may be marked; it keeps no vectors.
    check: Option<VectorDecoder>,
}

/// What bytes of layer data made of their layer.
#[derive(Debug)]
pub enum Arrival {
    /// It has more bytes.
    More,
    /// It may be marked now: its request, of this number, is to be answered.
    Ready(u32),
    /// It is bad, and why. It must be dropped.
    Bad(String),
}

impl LayerBuffer {
    /// An empty buffer of a machine with so many slots.
    pub fn new(capabilities: PowderCapabilities, slots: usize) -> Self {
        let slots = core::iter::repeat_with(|| None).take(slots).collect();
        Self { capabilities, slots, receiving: None, received: 0, taken: 0, reported: 0, owes_report: false }
    }

    /// The layers that may be marked.
    pub fn slot_ids(&self) -> Vec<Option<ExposureId>> {
        self.slots.iter().map(|slot| slot.as_ref().filter(|layer| layer.is_ready).map(|layer| layer.id)).collect()
    }

    /// A layer that may be marked, and its slot.
    pub fn ready_layer(&self, id: ExposureId) -> Option<(usize, &StoredLayer)> {
        let is_meant = |layer: &&StoredLayer| layer.is_ready && layer.id == id;
        self.slots.iter().enumerate().find_map(|(slot, layer)| Some((slot, layer.as_ref().filter(is_meant)?)))
    }

    /// The layer in a slot.
    pub fn layer(&self, slot: usize) -> Option<&StoredLayer> {
        self.slots.get(slot)?.as_ref()
    }

    /// The slot of the layer whose bytes come.
    pub fn receiving(&self) -> Option<usize> {
        self.receiving
    }

    /// Puts a layer that is announced into its slot, which exists.
    pub fn begin(&mut self, slot: u8, layer: AnnouncedLayer) {
        let AnnouncedLayer { number, id, encoding, encoded_bytes, crc32 } = layer;
        let slot = usize::from(slot);
        self.drop_layer(slot);
        let check = Some(VectorDecoder::new(encoding, self.capabilities.field_um, encoded_bytes));
        let (bytes, missing_bytes) = (VecDeque::new(), encoded_bytes);
        let Some(place) = self.slots.get_mut(slot) else { return };
        *place = Some(StoredLayer {
            number,
            id,
            encoding,
            encoded_bytes,
            crc32,
            vectors: None,
            is_ready: false,
            missing_bytes,
            bytes,
            check,
        });
        self.receiving = Some(slot);
        // The host may need the last byte of room for this layer.
        self.owes_report = true;
    }

    /// Takes bytes from the line. Returns what they made of the layer in a slot; `None` if they belong to no layer.
    pub fn push(&mut self, bytes: &[u8]) -> Option<(usize, Arrival)> {
        // No frame has so many bytes.
        let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        self.received = self.received.wrapping_add(count);
        let size_bytes = self.capabilities.buffer_bytes;
        let has_room = self.received.wrapping_sub(self.reported) <= size_bytes;
        let layer = self.receiving.and_then(|slot| Some((slot, self.slots.get_mut(slot)?.as_mut()?)));
        let Some((slot, layer)) = layer else {
            self.taken = self.taken.wrapping_add(count);
            return None;
        };
        let Some(missing_bytes) = layer.missing_bytes.checked_sub(count).filter(|_| has_room) else {
            self.taken = self.taken.wrapping_add(count);
            let why = if has_room { "more bytes than announced" } else { "more bytes than there was room for" };
            return Some((slot, Arrival::Bad(why.into())));
        };
        layer.missing_bytes = missing_bytes;
        layer.bytes.extend(bytes);
        if missing_bytes == 0 {
            self.receiving = None;
        }
        let arrival = match layer.check(bytes, &self.capabilities) {
            Err(why) => Arrival::Bad(why),
            Ok(true) => Arrival::Ready(layer.number),
            Ok(false) => Arrival::More,
        };
        Some((slot, arrival))
    }

    /// Gives bytes of a layer to the decoder that marks it. `None`: it needs bytes that have not come, or the layer is over.
    ///
    /// # Errors
    /// [`VectorError`] if the bytes are no vectors.
    pub fn decode(&mut self, slot: usize, decoder: &mut VectorDecoder) -> Result<Option<Vector>, VectorError> {
        let Some(layer) = self.slots.get_mut(slot).and_then(Option::as_mut) else { return Ok(None) };
        loop {
            let (piece, _) = layer.bytes.as_slices();
            let (mut rest, given) = (piece, piece.len());
            let found = decoder.next(&mut rest);
            let used = given - rest.len();
            layer.bytes.drain(..used);
            self.taken = self.taken.wrapping_add(used as u32);
            // The decoder has taken this piece. The bytes may go on at the start of the ring.
            if !matches!(found, Ok(None)) || used == 0 {
                return found;
            }
        }
    }

    /// Whether all bytes of a layer were given to the decoder that marks it.
    pub fn is_consumed(&self, slot: usize) -> bool {
        self.layer(slot).is_some_and(|layer| layer.missing_bytes == 0 && layer.bytes.is_empty())
    }

    /// Empties a slot. Bytes that still come for its layer belong to none.
    pub fn drop_layer(&mut self, slot: usize) {
        if self.receiving == Some(slot) {
            self.receiving = None;
        }
        if let Some(layer) = self.slots.get_mut(slot).and_then(Option::take) {
            self.taken = self.taken.wrapping_add(layer.bytes.len() as u32);
            self.owes_report = true;
        }
    }

    /// Empties all slots.
    pub fn drop_layers(&mut self) {
        for slot in 0..self.slots.len() {
            self.drop_layer(slot);
        }
    }

    /// A session begins: the buffer is empty, and the counts begin at 0.
    pub fn restart(&mut self) {
        self.drop_layers();
        (self.received, self.taken, self.reported, self.owes_report) = (0, 0, 0, false);
    }

    /// The count of bytes that left the buffer, if it is to be reported now.
    pub fn report(&mut self) -> Option<u32> {
        let owes_report = core::mem::take(&mut self.owes_report);
        let step_bytes = (self.capabilities.buffer_bytes / 8).max(MIN_REPORT_BYTES);
        let grown = self.taken.wrapping_sub(self.reported);
        if grown < step_bytes && (grown == 0 || !owes_report) {
            return None;
        }
        self.reported = self.taken;
        Some(self.taken)
    }
}

impl StoredLayer {
    /// Checks bytes that came. Returns whether the layer may be marked from now on.
    fn check(&mut self, mut bytes: &[u8], capabilities: &PowderCapabilities) -> Result<bool, String> {
        let Some(check) = &mut self.check else { return Ok(false) };
        while let Some(vector) = check.next(&mut bytes).map_err(|error| error.to_string())? {
            usable(check, &vector, capabilities.max_power_mw)
                .map_err(|error| format!("vector {}: {error}", vector.number))?;
        }
        let size_bytes = capabilities.buffer_bytes;
        let has_head_start = self.bytes.len() as u64 * 4 >= u64::from(size_bytes) * 3;
        if self.missing_bytes > 0 && !(self.encoded_bytes > size_bytes && has_head_start) {
            return Ok(false);
        }
        if let Some(check) = self.check.take()
            && self.missing_bytes == 0
        {
            let sum = check.finish().map_err(|error| error.to_string())?;
            if sum.crc32 != self.crc32 {
                return Err("its vectors have another CRC than announced".into());
            }
            self.vectors = Some(sum.vectors);
        }
        self.is_ready = true;
        Ok(true)
    }
}
