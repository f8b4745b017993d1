//! A layer on its way into a slot: announced, received in pieces, decoded as it arrives, checked. Part of
//! [`DeviceCore`].

use layerd_wire::encoding::{Decoder, PictureEncoding};

use super::DeviceCore;
use crate::device::encoding::depth_of;
use crate::layer::Bitmap;
use crate::link::message::{Encoding, ExposureId, MachineCapabilities, Refusal, Reply};

/// The layer being received.
#[derive(Debug)]
pub(super) struct Upload {
    pub(super) number: u32,
    slot: usize,
    id: ExposureId,
    encoding: PictureEncoding,
    remaining_bytes: usize,
    crc32: u32,
    decoder: Decoder,
}

impl DeviceCore {
    pub(super) fn layer_begin(
        &mut self,
        number: u32,
        slot: u8,
        id: ExposureId,
        (encoding, encoded_bytes, crc32): (Encoding, u32, u32),
    ) -> Result<(), Refusal> {
        // The host began another layer, so the unfinished one will never be complete.
        if let Some(upload) = self.upload.take() {
            self.refuse_layer(&upload);
        }
        self.check_ready()?;
        let slot = usize::from(slot);
        if slot >= self.slots.len() {
            return Err(Refusal::NoSuchLayer);
        }
        if self.vat.exposes_slot(slot) {
            return Err(Refusal::SlotBusy);
        }
        // A vat exposes pictures alone, whatever its configuration says that it decodes.
        let offered = self.capabilities.encodings.contains(&encoding);
        let encoding = encoding.picture().filter(|_| offered).ok_or(Refusal::BadEncoding)?;
        if encoded_bytes == 0 {
            return Err(Refusal::BadLayer);
        }
        self.slots[slot] = None;
        let MachineCapabilities::Vat(vat) = &self.capabilities.machine;
        let decoder = Decoder::new(encoding, vat.width_px, vat.height_px);
        let remaining_bytes = encoded_bytes as usize;
        self.upload = Some(Upload { number, slot, id, encoding, remaining_bytes, crc32, decoder });
        Ok(())
    }

    pub(super) fn layer_data(&mut self, bytes: &[u8]) {
        let Some(mut upload) = self.upload.take() else {
            self.statistics.stray_bytes += bytes.len() as u64;
            return;
        };
        self.statistics.layer_bytes += bytes.len() as u64;
        let taken = upload.remaining_bytes.checked_sub(bytes.len()).filter(|_| upload.decoder.push(bytes).is_ok());
        match taken {
            None => self.refuse_layer(&upload),
            Some(0) => self.layer_complete(upload),
            Some(remaining_bytes) => self.upload = Some(Upload { remaining_bytes, ..upload }),
        }
    }

    fn layer_complete(&mut self, upload: Upload) {
        let Upload { number, slot, id, encoding, crc32, decoder, .. } = upload;
        let decoded = decoder.finish().ok().filter(|(_, found)| *found == crc32);
        match decoded.and_then(|(rows, _)| self.picture(encoding, rows)) {
            Some(picture) => {
                self.slots[slot] = Some((id, picture));
                self.statistics.uploads += 1;
                self.reply(Some(number), Reply::Done);
            }
            None => self.refused(number, Some(id), "bad layer", Refusal::BadLayer),
        }
    }

    /// Raw rows of this machine's size as a picture.
    fn picture(&self, encoding: PictureEncoding, rows: Vec<u8>) -> Option<Bitmap> {
        let MachineCapabilities::Vat(vat) = &self.capabilities.machine;
        Bitmap::from_rows(vat.width_px, vat.height_px, depth_of(encoding), rows)
    }

    fn refuse_layer(&mut self, upload: &Upload) {
        self.refused(upload.number, Some(upload.id), "bad layer", Refusal::BadLayer);
    }
}
