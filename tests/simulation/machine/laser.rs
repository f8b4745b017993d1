//! How a laser machine lies, beside what any [`Machine`] does: about the room in its buffer, and about vectors.

use std::collections::VecDeque;

use layerd::link::message::{
    DeviceMessage, DeviceState, ExposureId, PowderReply, PowderRequest, Reply, Report, Request,
};

use super::character::Lie;
use super::{Machine, Stray};

/// Layers whose checksums a machine remembers. It has two slots.
const MAX_SENT: usize = 4;

/// Vectors and laser time of a layer, as a machine would report them. Only a machine that answers before a layer is marked needs to know.
#[derive(Clone, Copy, Debug)]
pub struct KnownLayer {
    /// What tells it from others: its checksum.
    pub crc32: u32,
    /// How many vectors it has.
    pub vectors: u32,
    /// How long the laser is on for it.
    pub laser_ms: u32,
}

/// What a machine knows of layers before it has marked them.
#[derive(Debug, Default)]
pub(super) struct Known {
    layers: Vec<KnownLayer>,
    /// Checksums of the layers that were announced, the newest last.
    sent: VecDeque<(ExposureId, u32)>,
}

impl Known {
    /// A request reached the machine.
    pub(super) fn hear(&mut self, request: &Request) {
        if let Request::LayerBegin { id, decoded_crc32, .. } = *request {
            if self.sent.len() >= MAX_SENT {
                self.sent.pop_front();
            }
            self.sent.push_back((id, decoded_crc32));
        }
    }

    fn marked(&self, id: ExposureId) -> Option<PowderReply> {
        let (_, crc32) = self.sent.iter().rfind(|(sent, _)| *sent == id)?;
        let KnownLayer { vectors, laser_ms, .. } = *self.layers.iter().find(|layer| layer.crc32 == *crc32)?;
        Some(PowderReply::Marked { id, vectors, laser_ms, starved_ms: 0 })
    }
}

impl Machine {
    /// The machine knows these layers before it marks them, so that it can lie well.
    #[must_use]
    pub fn knowing(mut self, layers: Vec<KnownLayer>) -> Self {
        self.known.layers = layers;
        self
    }

    /// What the machine answers to a request that it has not carried out yet.
    pub(super) fn early_reply(&self, request: PowderRequest) -> Option<PowderReply> {
        match request {
            PowderRequest::Home => Some(PowderReply::Moved { position_um: 0 }),
            PowderRequest::Move { position_um, .. } => Some(PowderReply::Moved { position_um }),
            PowderRequest::Recoat => Some(PowderReply::Recoated),
            PowderRequest::Mark { id, .. } => self.known.marked(id),
        }
    }

    /// How much room there is, as it is told.
    pub(super) fn report_room(&mut self, taken_bytes: u32, now_us: u64) {
        let lie = self.liar.due(|lie| matches!(lie, Lie::WrongRoom { .. }));
        self.note_lie(lie, now_us);
        let offset = match lie {
            Some(Lie::WrongRoom { offset }) => offset,
            _ => 0,
        };
        let taken_bytes = taken_bytes.wrapping_add_signed(offset);
        self.say_now(DeviceMessage::Report(Report::Room { taken_bytes }));
    }

    /// Marks a layer once more, before it answers.
    pub(super) fn mark_again(&mut self, number: u32, mut reply: Reply, now_us: u64) {
        let Reply::Powder(PowderReply::Marked { laser_ms, .. }) = &mut reply else { return };
        let until_us = now_us + u64::from(*laser_ms) * 1000;
        *laser_ms *= 2;
        self.stray = Some(Stray { until_us, is_known: true });
        self.facts.lamp_on(None, 0, now_us);
        self.say_later(until_us, DeviceMessage::Reply { number, reply });
    }

    /// What a laser machine tells of its state.
    pub(super) fn told_powder(&mut self, state: &mut DeviceState, now_us: u64) {
        let Some(powder) = &mut state.powder else { return };
        let (was_cut, was_recoated) = (state.cut_short.is_some(), powder.recoated);
        let names = was_cut || state.last_exposed.is_some();
        let lie = self.liar.due(|lie| match lie {
            Lie::WrongNextVector { .. } => was_cut,
            Lie::ForgetsPowder => was_recoated,
            Lie::OtherJob => names,
            _ => false,
        });
        match lie {
            Some(Lie::WrongNextVector { offset }) => {
                powder.next_vector = powder.next_vector.saturating_add_signed(offset);
            }
            Some(Lie::ForgetsPowder) => powder.recoated = false,
            Some(Lie::OtherJob) => {
                let other = |id: ExposureId| ExposureId { job: id.job ^ 1, ..id };
                state.last_exposed = state.last_exposed.map(other);
                state.cut_short = state.cut_short.map(|(id, lit_ms)| (other(id), lit_ms));
            }
            _ => {}
        }
        self.note_lie(lie, now_us);
    }
}
