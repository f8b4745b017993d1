//! What all parts of the firmware share: the clock, the plate, what was exposed last, and the actions for the owner. Part of
//! [`DeviceCore`](super::DeviceCore).

use std::collections::VecDeque;

use super::plate::Plate;
use super::{CoreAction, LayerBegin, Statistics};
use crate::device::sim::log::ActRecord;
use crate::link::message::{Capabilities, DeviceMessage, Encoding, ExposureId, Fault, Refusal, Reply, Report};

/// Whether the device begins acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Readiness {
    /// It does.
    Ready,
    /// Begins nothing until Release; at most one request waits.
    Held,
    /// Aborted, the host silent, or just started: begins nothing until a hello.
    WaitsForHello,
}

/// What all parts of the firmware share.
#[derive(Debug)]
pub(super) struct Board {
    pub(super) capabilities: Capabilities,
    pub(super) readiness: Readiness,
    pub(super) fault: Option<Fault>,
    /// When the firmware's own fault ends, microseconds of the device's clock; `None` for a fault that its owner ends.
    pub(super) fault_ends_us: Option<u64>,
    pub(super) plate: Plate,
    /// Kept across resets, as in a real device's non-volatile memory.
    pub(super) last_exposed: Option<ExposureId>,
    pub(super) cut_short: Option<(ExposureId, u32)>,
    pub(super) now_us: u64,
    /// At most a handful of entries for each call; the owner empties it after each.
    pub(super) actions: VecDeque<CoreAction>,
    pub(super) statistics: Statistics,
}

impl Board {
    /// A board that was just switched on.
    pub(super) fn new(capabilities: Capabilities) -> Self {
        Self {
            capabilities,
            readiness: Readiness::WaitsForHello,
            fault: None,
            fault_ends_us: None,
            plate: Plate::new(),
            last_exposed: None,
            cut_short: None,
            now_us: 0,
            actions: VecDeque::new(),
            statistics: Statistics::default(),
        }
    }

    /// Whether acts may begin and layers may be sent.
    pub(super) fn check_ready(&self) -> Result<(), Refusal> {
        let ready = self.readiness != Readiness::WaitsForHello && self.fault.is_none();
        if ready { Ok(()) } else { Err(Refusal::NotReady) }
    }

    /// Whether an announced layer may be sent; returns its encoding. `busy_slot` is the slot that is being exposed, and `decodable`
    /// gives an encoding as this kind of machine decodes it.
    pub(super) fn check_layer<E>(
        &self,
        begin: &LayerBegin,
        busy_slot: Option<usize>,
        decodable: impl FnOnce(Encoding) -> Option<E>,
    ) -> Result<E, Refusal> {
        self.check_ready()?;
        if begin.slot >= self.capabilities.layer_slots {
            return Err(Refusal::NoSuchLayer);
        }
        if busy_slot == Some(begin.slot.into()) {
            return Err(Refusal::SlotBusy);
        }
        // The capabilities may state encodings of another kind of machine. They are not decoded.
        let offered = self.capabilities.encodings.contains(&begin.encoding);
        let encoding = decodable(begin.encoding).filter(|_| offered).ok_or(Refusal::BadEncoding)?;
        if begin.encoded_bytes == 0 {
            return Err(Refusal::BadLayer);
        }
        Ok(encoding)
    }

    /// Whether this exposure, or a later one of its job, has run its whole time.
    pub(super) fn was_exposed(&self, id: ExposureId) -> bool {
        self.last_exposed.is_some_and(|last| last.job == id.job && id <= last)
    }

    /// Sets the present fault, or ends it, and reports it.
    pub(super) fn report_fault(&mut self, fault: Option<Fault>) {
        if let Some(fault) = &fault {
            self.record(ActRecord { event: "fault", reason: Some(fault.text.clone()), ..ActRecord::default() });
        }
        self.fault_ends_us = None;
        self.fault.clone_from(&fault);
        self.send(DeviceMessage::Report(Report::Fault(fault)));
    }

    /// Refuses a request.
    pub(super) fn refused(&mut self, number: u32, id: Option<ExposureId>, what: &str, refusal: Refusal) {
        self.statistics.refused += 1;
        let reason = Some(format!("{what}: {refusal:?}"));
        let record = id.map_or(ActRecord { event: "refused", ..ActRecord::default() }, |id| of_layer("refused", id));
        self.record(ActRecord { reason, ..record });
        self.reply(Some(number), Reply::Refused(refusal));
    }

    /// Answers a request, unless its session has ended.
    pub(super) fn reply(&mut self, number: Option<u32>, reply: Reply) {
        if let Some(number) = number {
            self.send(DeviceMessage::Reply { number, reply });
        }
    }

    /// Sends a message to the host.
    pub(super) fn send(&mut self, message: DeviceMessage) {
        self.actions.push_back(CoreAction::Send(message));
    }

    /// Writes a line of the log, with the present time.
    pub(super) fn record(&mut self, record: ActRecord) {
        self.actions.push_back(CoreAction::Record(ActRecord { t_ms: self.now_us / 1000, ..record }));
    }
}

/// A line of the log about a layer.
pub(super) fn of_layer(event: &'static str, id: ExposureId) -> ActRecord {
    let pass = Some(id.pass).filter(|pass| *pass > 0);
    ActRecord { event, job: Some(id.job), layer: Some(id.layer), pass, ..ActRecord::default() }
}
