//! What only a vat machine does: it exposes whole pictures. Part of [`DeviceCore`](super::DeviceCore).

mod change;
mod upload;

use super::CoreAction;
use super::board::{Board, of_layer};
use crate::device::sim::log::ActRecord;
use crate::layer::Bitmap;
use crate::link::message::{ExposureId, Refusal, Reply, VatCapabilities, VatReply, VatRequest, VatsState};
use change::Change;
use upload::Upload;

/// Light and layers.
#[derive(Debug)]
pub(super) struct Vat {
    capabilities: VatCapabilities,
    slots: Vec<Option<(ExposureId, Bitmap)>>,
    upload: Option<Upload>,
    exposure: Option<Exposure>,
    /// The vat in place.
    in_place: Option<u8>,
    change: Option<Change>,
}

#[derive(Debug)]
struct Exposure {
    /// Number of the request, while its session lasts.
    number: Option<u32>,
    slot: usize,
    id: ExposureId,
    began_us: u64,
    duration_ms: u32,
}

impl Exposure {
    fn ends_us(&self) -> u64 {
        self.began_us + u64::from(self.duration_ms) * 1000
    }
}

/// The name of a request in the log, and its exposure.
pub(super) fn named(request: VatRequest) -> (&'static str, Option<ExposureId>) {
    match request {
        VatRequest::Expose { id, .. } => ("expose", Some(id)),
        VatRequest::Home => ("home", None),
        VatRequest::Move { .. } => ("move", None),
        VatRequest::Change { .. } => ("change", None),
    }
}

impl Vat {
    /// Dark and empty, with the first vat in place.
    pub(super) fn new(capabilities: VatCapabilities, slots: usize) -> Self {
        Self { capabilities, slots: vec![None; slots], upload: None, exposure: None, in_place: Some(1), change: None }
    }

    /// When an exposure or a change under way ends.
    pub(super) fn next_timeout_us(&self) -> Option<u64> {
        self.exposure.as_ref().map(Exposure::ends_us).or(self.change.as_ref().map(|change| change.ends_us))
    }

    /// Whether an exposure or a change is under way.
    pub(super) fn is_acting(&self) -> bool {
        self.exposure.is_some() || self.change.is_some()
    }

    /// What it reports of its vats, if it has several.
    pub(super) fn vats_state(&self) -> Option<VatsState> {
        (self.capabilities.vats.count > 1).then_some(VatsState { in_place: self.in_place })
    }

    /// The exposure under way, and its commanded time in milliseconds.
    pub(super) fn exposure(&self) -> Option<(ExposureId, u32)> {
        self.exposure.as_ref().map(|exposure| (exposure.id, exposure.duration_ms))
    }

    /// The layer in each slot.
    pub(super) fn slot_ids(&self) -> Vec<Option<ExposureId>> {
        self.slots.iter().map(|slot| slot.as_ref().map(|(id, _)| *id)).collect()
    }

    /// Ends an exposure that is due by `now_us`, at its own time.
    pub(super) fn advance(&mut self, board: &mut Board, now_us: u64) {
        self.advance_change(board, now_us);
        if let Some(exposure) = self.exposure.take_if(|exposure| exposure.ends_us() <= now_us) {
            board.now_us = exposure.ends_us();
            self.end_exposure(board, &exposure);
        }
    }

    /// Begins an act. None is under way.
    pub(super) fn begin_act(&mut self, board: &mut Board, number: u32, request: VatRequest) -> Result<(), Refusal> {
        match request {
            VatRequest::Expose { id, duration_ms, light_pwm } => self.expose(board, number, id, duration_ms, light_pwm),
            VatRequest::Move { position_um, speed_um_s } => board.begin_move(number, position_um, speed_um_s),
            VatRequest::Change { vat, wash_ms, drain_ms } => self.change(board, number, vat, [wash_ms, drain_ms]),
            VatRequest::Home => {
                board.begin_homing(number);
                Ok(())
            }
        }
    }

    fn expose(
        &mut self,
        board: &mut Board,
        number: u32,
        id: ExposureId,
        duration_ms: u32,
        light_pwm: u8,
    ) -> Result<(), Refusal> {
        if duration_ms == 0 || light_pwm == 0 || duration_ms > board.capabilities.max_exposure_ms {
            return Err(Refusal::BadDuration);
        }
        if self.in_place.is_none() {
            return Err(Refusal::NoSuchVat);
        }
        if board.was_exposed(id) {
            return Err(Refusal::AlreadyExposed);
        }
        let held = |slot: &Option<(ExposureId, Bitmap)>| slot.as_ref().is_some_and(|(held, _)| *held == id);
        let slot = self.slots.iter().position(held).ok_or(Refusal::NoSuchLayer)?;
        self.exposure = Some(Exposure { number: Some(number), slot, id, began_us: board.now_us, duration_ms });
        board.record(ActRecord { vat: self.told_vat(), ..of_layer("light_on", id) });
        Ok(())
    }

    /// The vat in place, as the log has it: nothing if there is one vat.
    fn told_vat(&self) -> Option<u8> {
        self.in_place.filter(|_| self.capabilities.vats.count > 1)
    }

    /// An exposure that ran its whole time.
    fn end_exposure(&mut self, board: &mut Board, exposure: &Exposure) {
        let Exposure { number, slot, id, duration_ms, .. } = *exposure;
        board.last_exposed = Some(id);
        board.statistics.exposed += 1;
        board.record(of_layer("light_off", id));
        // The picture goes before its log line, so that a reader of the log finds the file.
        if let Some((_, picture)) = self.slots[slot].take() {
            board.actions.push_back(CoreAction::Picture(id, picture));
        }
        board.record(ActRecord { duration_ms: Some(duration_ms), vat: self.told_vat(), ..of_layer("exposed", id) });
        board.reply(number, Reply::Vat(VatReply::Exposed { id, duration_ms }));
    }

    /// The light goes off now, whatever is left of the exposure.
    pub(super) fn cut(&mut self, board: &mut Board, reason: &str) {
        let Some(exposure) = self.exposure.take() else { return };
        let lit_ms = ((board.now_us - exposure.began_us) / 1000) as u32;
        board.cut_short = Some((exposure.id, lit_ms));
        self.slots[exposure.slot] = None;
        board.statistics.cut_short += 1;
        let record = of_layer("light_off", exposure.id);
        board.record(ActRecord { duration_ms: Some(lit_ms), reason: Some(reason.into()), ..record });
        board.reply(exposure.number, Reply::Refused(Refusal::CutShort));
    }

    /// The request of an exposure under way is not answered any more.
    pub(super) fn forget_request(&mut self) {
        if let Some(exposure) = &mut self.exposure {
            exposure.number = None;
        }
        if let Some(change) = &mut self.change {
            change.number = None;
        }
    }

    /// The session has ended: a layer that is not complete is dropped.
    pub(super) fn end_session(&mut self) {
        self.upload = None;
    }

    /// The device restarts: no layer survives.
    pub(super) fn restart(&mut self) {
        self.upload = None;
        self.slots.fill(None);
    }

    /// Drops all layers; the one on its way is refused.
    pub(super) fn drop_layers(&mut self, board: &mut Board) {
        self.slots.fill(None);
        if let Some(upload) = self.upload.take() {
            board.reply(Some(upload.number), Reply::Refused(Refusal::NotReady));
        }
    }
}
