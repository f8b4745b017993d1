//! Layers on their way into the buffer, and out of it. Part of [`Powder`].

use layerd_wire::powder::{AnnouncedLayer, Arrival};

use super::Powder;
use crate::device::sim::core::LayerBegin;
use crate::device::sim::core::board::Board;
use crate::link::message::{DeviceMessage, Encoding, Refusal, Reply, Report};

impl Powder {
    /// A layer is announced.
    pub(in crate::device::sim::core) fn layer_begin(
        &mut self,
        board: &mut Board,
        number: u32,
        begin: LayerBegin,
    ) -> Result<(), Refusal> {
        // The host began another layer, so the unfinished one will never be complete.
        if let Some(slot) = self.buffer.receiving() {
            self.refuse_layer(board, slot, "not finished");
        }
        let busy_slot = self.marking.as_ref().map(|marking| marking.slot);
        let encoding = board.check_layer(&begin, busy_slot, Encoding::vectors)?;
        let LayerBegin { slot, id, encoded_bytes, decoded_crc32: crc32, .. } = begin;
        self.buffer.begin(slot, AnnouncedLayer { number, id, encoding, encoded_bytes, crc32 });
        Ok(())
    }

    /// Bytes of the layer that was begun last.
    pub(in crate::device::sim::core) fn layer_data(&mut self, board: &mut Board, bytes: &[u8]) {
        let Some((slot, arrival)) = self.buffer.push(bytes) else {
            board.statistics.stray_bytes += bytes.len() as u64;
            return;
        };
        board.statistics.layer_bytes += bytes.len() as u64;
        match arrival {
            Arrival::More => self.go_on(board, slot),
            Arrival::Ready(number) => {
                board.statistics.uploads += 1;
                board.reply(Some(number), Reply::Done);
            }
            Arrival::Bad(why) => self.refuse_layer(board, slot, &why),
        }
    }

    /// More bytes of a layer came: its marking may wait for them.
    fn go_on(&mut self, board: &mut Board, slot: usize) {
        let Some(marking) = self.marking.as_mut().filter(|marking| marking.slot == slot) else { return };
        if let Some(end) = marking.resume(&mut self.buffer, board.now_us) {
            self.end_marking(board, end);
        }
    }

    /// Drops a layer that cannot become whole. If it is being marked, the laser stops at the end of its vector.
    fn refuse_layer(&mut self, board: &mut Board, slot: usize, why: &str) {
        if let Some(layer) = self.buffer.layer(slot).filter(|layer| !layer.is_ready) {
            let (number, id) = (layer.number, layer.id);
            board.refused(number, Some(id), &format!("bad layer ({why})"), Refusal::BadLayer);
        }
        self.buffer.drop_layer(slot);
        if self.marking.as_ref().is_some_and(|marking| marking.slot == slot) {
            self.stop(board, "bad layer");
        }
    }

    /// Tells the host of room in the buffer, if there is enough of it.
    pub(in crate::device::sim::core) fn report_room(&mut self, board: &mut Board) {
        if let Some(taken_bytes) = self.buffer.report() {
            board.send(DeviceMessage::Report(Report::Room { taken_bytes }));
        }
    }

    /// The session has ended: the laser stops at the end of its vector, and the buffer is empty for the next session.
    pub(in crate::device::sim::core) fn end_session(&mut self, board: &mut Board, reason: &'static str) {
        self.stop(board, reason);
        self.buffer.restart();
    }

    /// All layers are dropped; the one on its way is refused.
    pub(in crate::device::sim::core) fn drop_layers(&mut self, board: &mut Board) {
        let receiving = self.buffer.receiving().and_then(|slot| self.buffer.layer(slot));
        if let Some(layer) = receiving.filter(|layer| !layer.is_ready) {
            board.reply(Some(layer.number), Reply::Refused(Refusal::NotReady));
        }
        self.buffer.drop_layers();
    }

    /// The device restarts: no layer survives, and nobody knows how the powder lies.
    pub(in crate::device::sim::core) fn restart(&mut self) {
        self.buffer.restart();
        self.recoated = false;
    }
}
