//! A picture on its way into a slot: announced, received in pieces, decoded as it arrives, checked. Part of [`Vat`].

use layerd_wire::encoding::{Decoder, PictureEncoding};

use super::Vat;
use crate::device::encoding::depth_of;
use crate::device::sim::core::LayerBegin;
use crate::device::sim::core::board::Board;
use crate::layer::Bitmap;
use crate::link::message::{Encoding, ExposureId, Refusal, Reply};

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

impl Vat {
    /// A layer is announced.
    pub(in crate::device::sim::core) fn layer_begin(
        &mut self,
        board: &mut Board,
        number: u32,
        begin: LayerBegin,
    ) -> Result<(), Refusal> {
        // The host began another layer, so the unfinished one will never be complete.
        if let Some(upload) = self.upload.take() {
            refuse_layer(board, &upload);
        }
        let busy_slot = self.exposure.as_ref().map(|exposure| exposure.slot);
        let encoding = board.check_layer(&begin, busy_slot, Encoding::picture)?;
        let LayerBegin { slot, id, encoded_bytes, decoded_crc32: crc32, .. } = begin;
        let slot = usize::from(slot);
        self.slots[slot] = None;
        let decoder = Decoder::new(encoding, self.capabilities.width_px, self.capabilities.height_px);
        let remaining_bytes = encoded_bytes as usize;
        self.upload = Some(Upload { number, slot, id, encoding, remaining_bytes, crc32, decoder });
        Ok(())
    }

    /// The next bytes of the layer on its way.
    pub(in crate::device::sim::core) fn layer_data(&mut self, board: &mut Board, bytes: &[u8]) {
        let Some(mut upload) = self.upload.take() else {
            board.statistics.stray_bytes += bytes.len() as u64;
            return;
        };
        board.statistics.layer_bytes += bytes.len() as u64;
        let taken = upload.remaining_bytes.checked_sub(bytes.len()).filter(|_| upload.decoder.push(bytes).is_ok());
        match taken {
            None => refuse_layer(board, &upload),
            Some(0) => self.layer_complete(board, upload),
            Some(remaining_bytes) => self.upload = Some(Upload { remaining_bytes, ..upload }),
        }
    }

    fn layer_complete(&mut self, board: &mut Board, upload: Upload) {
        let Upload { number, slot, id, encoding, crc32, decoder, .. } = upload;
        let decoded = decoder.finish().ok().filter(|(_, found)| *found == crc32);
        match decoded.and_then(|(rows, _)| self.picture(encoding, rows)) {
            Some(picture) => {
                self.slots[slot] = Some((id, picture));
                board.statistics.uploads += 1;
                board.reply(Some(number), Reply::Done);
            }
            None => board.refused(number, Some(id), "bad layer", Refusal::BadLayer),
        }
    }

    /// Raw rows of this machine's size as a picture.
    fn picture(&self, encoding: PictureEncoding, rows: Vec<u8>) -> Option<Bitmap> {
        Bitmap::from_rows(self.capabilities.width_px, self.capabilities.height_px, depth_of(encoding), rows)
    }
}

fn refuse_layer(board: &mut Board, upload: &Upload) {
    board.refused(upload.number, Some(upload.id), "bad layer", Refusal::BadLayer);
}
