//! What only a powder machine does: it spreads powder, and marks layers of scan vectors with its laser. Part of
//! [`DeviceCore`](super::DeviceCore).
//!
//! All layers share one [`LayerBuffer`], which `upload` fills. `marking` follows scanner and laser through a layer; `melt` draws what was
//! melted. At an abort, a light-off, a fault and a reset the laser stops at once, otherwise at the end of the vector it is on.

mod marking;
mod melt;
mod upload;

pub use marking::MarkedVector;
pub use melt::MeltSettings;

use super::CoreAction;
use super::board::{Board, of_layer};
use crate::device::sim::log::ActRecord;
use crate::link::message::{
    ExposureId, Fault, PowderCapabilities, PowderReply, PowderRequest, PowderState, Refusal, Reply,
};
use layerd_wire::powder::LayerBuffer;
use marking::{End, Marking};
use melt::Melt;

/// How long the recoater takes, microseconds.
const RECOAT_US: u64 = 4_000_000;

/// Fault code of a layer that is found to be bad while it is marked.
const FAULT_BAD_LAYER: u16 = 2;

/// How long that fault lasts, microseconds: more than a second, because a host may ignore reports that come more often.
const FAULT_US: u64 = 2_000_000;

/// Recoater, laser and layers.
#[derive(Debug)]
pub(super) struct Powder {
    capabilities: PowderCapabilities,
    buffer: LayerBuffer,
    recoating: Option<Recoating>,
    marking: Option<Marking>,
    recoated: bool,
    /// The first vector not marked whole, of the layer that was cut short last. Kept across resets, like `broken`.
    next_vector: u32,
    /// The laser went off within that vector.
    broken: bool,
    /// Where the scanner points, micrometres in the field.
    scanner_um: [i32; 2],
    melt: Option<Melt>,
    tells_vectors: bool,
}

#[derive(Debug)]
struct Recoating {
    /// Number of the request, while its session lasts.
    number: Option<u32>,
    ends_us: u64,
    /// The plate was pushed meanwhile: nobody knows how the powder lies.
    is_disturbed: bool,
}

/// The name of a request in the log, and its exposure.
pub(super) fn named(request: PowderRequest) -> (&'static str, Option<ExposureId>) {
    match request {
        PowderRequest::Mark { id, .. } => ("mark", Some(id)),
        PowderRequest::Recoat => ("recoat", None),
        PowderRequest::Home => ("home", None),
        PowderRequest::Move { .. } => ("move", None),
    }
}

impl Powder {
    /// Dark, empty, and without powder.
    pub(super) fn new(capabilities: PowderCapabilities, slots: usize) -> Self {
        Self {
            buffer: LayerBuffer::new(capabilities.clone(), slots),
            recoating: None,
            marking: None,
            recoated: false,
            next_vector: 0,
            broken: false,
            scanner_um: centre(&capabilities),
            melt: None,
            tells_vectors: false,
            capabilities,
        }
    }

    /// Draws what is melted from now on.
    pub(super) fn draw(&mut self, settings: MeltSettings) {
        self.melt = Some(Melt::new(settings));
    }

    /// Tells each vector that the laser was on from now on.
    pub(super) fn tell_vectors(&mut self) {
        self.tells_vectors = true;
    }

    /// When an act under way goes on.
    pub(super) fn next_timeout_us(&self) -> Option<u64> {
        let recoated_us = self.recoating.as_ref().map(|recoating| recoating.ends_us);
        recoated_us.into_iter().chain(self.marking.as_ref().map(Marking::due_us)).min()
    }

    /// The layer that is being marked, and the longest time of the act in milliseconds.
    pub(super) fn exposure(&self) -> Option<(ExposureId, u32)> {
        self.marking.as_ref().map(|marking| (marking.id, marking.most_ms))
    }

    /// Whether laser or recoater are at work.
    pub(super) fn is_acting(&self) -> bool {
        self.recoating.is_some() || self.marking.is_some()
    }

    /// Whether a layer is being marked, and the laser does not wait for its bytes.
    pub(super) fn light_on(&self) -> bool {
        self.marking.as_ref().is_some_and(Marking::light_on)
    }

    /// The layers that may be marked.
    pub(super) fn slot_ids(&self) -> Vec<Option<ExposureId>> {
        self.buffer.slot_ids()
    }

    /// What only a powder machine reports of its state.
    pub(super) fn state(&self) -> PowderState {
        let next_vector = self.marking.as_ref().map_or(self.next_vector, |marking| marking.next_vector);
        PowderState { next_vector, broken: self.marking.is_none() && self.broken, recoated: self.recoated }
    }

    /// Does what is due by `now_us`, each at its own time.
    pub(super) fn advance(&mut self, board: &mut Board, now_us: u64) {
        if let Some(recoating) = self.recoating.take_if(|recoating| recoating.ends_us <= now_us) {
            board.now_us = recoating.ends_us;
            self.recoated = !recoating.is_disturbed;
            board.statistics.recoats += 1;
            board.record(ActRecord { event: "recoated", ..ActRecord::default() });
            board.reply(recoating.number, Reply::Powder(PowderReply::Recoated));
        }
        // Every turn takes a vector from the buffer, or leaves a phase that lies before one.
        while let Some(marking) = self.marking.as_mut().filter(|marking| marking.due_us() <= now_us) {
            board.now_us = board.now_us.max(marking.due_us());
            let end = marking.step(&mut self.buffer, self.melt.as_mut());
            self.tell_ended(board);
            if let Some(end) = end {
                self.end_marking(board, end);
            }
        }
        self.report_room(board);
    }

    /// Tells the vector that just ended, if there is one and it is to be told.
    fn tell_ended(&mut self, board: &mut Board) {
        let ended = self.marking.as_mut().and_then(Marking::take_ended);
        board.actions.extend(ended.filter(|_| self.tells_vectors).map(CoreAction::Vector));
    }

    /// Begins an act. None is under way.
    pub(super) fn begin_act(&mut self, board: &mut Board, number: u32, request: PowderRequest) -> Result<(), Refusal> {
        match request {
            PowderRequest::Home => {
                self.recoated = false;
                self.scanner_um = centre(&self.capabilities);
                board.begin_homing(number);
            }
            PowderRequest::Move { position_um, speed_um_s } => {
                board.begin_move(number, position_um, speed_um_s)?;
                self.recoated = false;
            }
            PowderRequest::Recoat => {
                self.recoated = false;
                self.recoating =
                    Some(Recoating { number: Some(number), ends_us: board.now_us + RECOAT_US, is_disturbed: false });
            }
            PowderRequest::Mark { id, from_vector, most_ms } => self.mark(board, number, id, from_vector, most_ms)?,
        }
        Ok(())
    }

    fn mark(
        &mut self,
        board: &mut Board,
        number: u32,
        id: ExposureId,
        from_vector: u32,
        most_ms: u32,
    ) -> Result<(), Refusal> {
        if !board.plate.is_homed() {
            return Err(Refusal::NotHomed);
        }
        if !self.recoated {
            return Err(Refusal::NotRecoated);
        }
        if most_ms == 0 || most_ms > board.capabilities.max_exposure_ms {
            return Err(Refusal::BadDuration);
        }
        if board.was_exposed(id) {
            return Err(Refusal::AlreadyExposed);
        }
        let (slot, layer) = self.buffer.ready_layer(id).ok_or(Refusal::NoSuchLayer)?;
        let is_continued = board.cut_short.is_some_and(|(cut, _)| cut == id);
        let first = if is_continued { self.next_vector } else { 0 };
        if from_vector != first || layer.vectors.is_some_and(|vectors| from_vector > vectors) {
            return Err(Refusal::WrongVector);
        }
        let PowderCapabilities { field_um, max_power_mw, .. } = self.capabilities;
        let commanded = (from_vector, most_ms);
        let layer = (number, slot, layer);
        let mut marking = Marking::new(layer, commanded, field_um, max_power_mw, self.scanner_um, board.now_us);
        if let Some(melt) = &mut self.melt {
            melt.begin(id);
        }
        board.record(ActRecord { from_vector: Some(from_vector), ..of_layer("laser_on", id) });
        let end = marking.resume(&mut self.buffer, board.now_us);
        self.marking = Some(marking);
        if let Some(end) = end {
            self.end_marking(board, end);
        }
        Ok(())
    }

    fn end_marking(&mut self, board: &mut Board, end: End) {
        let Some(marking) = self.marking.take() else { return };
        self.scanner_um = marking.at_um();
        board.statistics.vectors += u64::from(marking.next_vector - marking.from_vector);
        board.statistics.starved_ms += u64::from(marking.starved_ms());
        match end {
            End::Whole(vectors) => self.end_whole(board, &marking, vectors),
            End::Cut(reason) => self.end_early(board, &marking, reason.into()),
            End::Bad(why) => {
                let text = format!("layer {}: {why}", marking.id.layer);
                self.end_early(board, &marking, text.clone());
                board.report_fault(Some(Fault { code: FAULT_BAD_LAYER, text }));
                board.fault_ends_us = Some(board.now_us + FAULT_US);
            }
            End::NoSuchVector => {
                self.buffer.drop_layer(marking.slot);
                board.record(of_layer("laser_off", marking.id));
                if let Some(number) = marking.number {
                    board.refused(number, Some(marking.id), "mark", Refusal::WrongVector);
                }
            }
        }
    }

    fn end_whole(&mut self, board: &mut Board, marking: &Marking, vectors: u32) {
        let id = marking.id;
        board.last_exposed = Some(id);
        if board.cut_short.take_if(|(cut, _)| *cut == id).is_some() {
            (self.next_vector, self.broken) = (0, false);
        }
        self.buffer.drop_layer(marking.slot);
        board.statistics.exposed += 1;
        board.record(of_layer("laser_off", id));
        // The picture goes before its log line, so that a reader of the log finds the file.
        if let Some(picture) = self.melt.as_mut().and_then(|melt| melt.take(id)) {
            board.actions.push_back(CoreAction::Picture(id, picture));
        }
        let (laser_ms, starved_ms) = (marking.laser_ms(), marking.starved_ms());
        board.record(ActRecord { vectors: Some(vectors), ..of_act("marked", marking) });
        board.reply(marking.number, Reply::Powder(PowderReply::Marked { id, vectors, laser_ms, starved_ms }));
    }

    fn end_early(&mut self, board: &mut Board, marking: &Marking, reason: String) {
        board.cut_short = Some((marking.id, marking.laser_ms()));
        (self.next_vector, self.broken) = (marking.next_vector, marking.broken);
        self.buffer.drop_layer(marking.slot);
        board.statistics.cut_short += 1;
        let next_vector = Some(marking.next_vector);
        board.record(ActRecord { next_vector, reason: Some(reason), ..of_act("laser_off", marking) });
        board.reply(marking.number, Reply::Refused(Refusal::CutShort));
    }

    /// The laser goes off now.
    pub(super) fn cut(&mut self, board: &mut Board, reason: &'static str) {
        if let Some(marking) = &mut self.marking {
            marking.interrupt(self.melt.as_mut(), board.now_us);
            self.tell_ended(board);
            self.end_marking(board, End::Cut(reason));
        }
    }

    /// The laser goes off at the end of its vector; now, if it is between two.
    fn stop(&mut self, board: &mut Board, reason: &'static str) {
        match &mut self.marking {
            Some(marking) if marking.is_in_vector() => marking.stopping = marking.stopping.or(Some(reason)),
            _ => self.cut(board, reason),
        }
    }

    /// Somebody moved the plate by hand: powder that was spread before does not count.
    pub(super) fn plate_pushed(&mut self) {
        self.recoated = false;
        if let Some(recoating) = &mut self.recoating {
            recoating.is_disturbed = true;
        }
    }

    /// The recoater stops where it is.
    pub(super) fn stop_recoater(&mut self, board: &mut Board) {
        if let Some(recoating) = self.recoating.take() {
            let reason = Some("stopped".into());
            board.record(ActRecord { event: "recoated", reason, ..ActRecord::default() });
            board.reply(recoating.number, Reply::Refused(Refusal::CutShort));
        }
    }

    /// The requests of acts under way are not answered any more.
    pub(super) fn forget_request(&mut self) {
        if let Some(recoating) = &mut self.recoating {
            recoating.number = None;
        }
        if let Some(marking) = &mut self.marking {
            marking.number = None;
        }
    }
}

fn centre(capabilities: &PowderCapabilities) -> [i32; 2] {
    // No field is so large that this would saturate.
    capabilities.field_um.map(|um| i32::try_from(um / 2).unwrap_or(i32::MAX))
}

/// A line of the log about an act of marking that ended.
fn of_act(event: &'static str, marking: &Marking) -> ActRecord {
    ActRecord {
        duration_ms: Some(marking.laser_ms()),
        from_vector: Some(marking.from_vector),
        starved_ms: Some(marking.starved_ms()),
        ..of_layer(event, marking.id)
    }
}
