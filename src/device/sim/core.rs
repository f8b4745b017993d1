//! The firmware of a simulated machine, on top of the device's session: messages and the time go in, actions come out. This file has
//! what every machine does; `vat` has light and plate.
//!
//! Times are microseconds of the device's own clock. The end of an exposure or a move is stamped with the time when it was due,
//! however late [`DeviceCore::advance`] is called. The light is on only during an exposure. An exposure ends by the device's clock,
//! by an urgent light-off or abort, by a fault, or by a reset. `tests/device_core/` shows every reply.

mod upload;
mod vat;

use std::collections::VecDeque;

use upload::Upload;
use vat::Vat;

use super::log::ActRecord;
use crate::layer::Bitmap;
use crate::link::message::{
    Capabilities, DeviceMessage, DeviceState, ExposureId, Fault, HostMessage, Refusal, Reply, Report, Request, Urgent,
};

/// What the owner of the core must do, in order.
#[derive(Clone, Debug, PartialEq)]
pub enum CoreAction {
    /// Send to the host; void without a session.
    Send(DeviceMessage),
    /// Write a line of the log.
    Record(ActRecord),
    /// Keep the picture of a layer whose exposure ended.
    Picture(u32, Bitmap),
}

/// Counts since the device was made; resets do not clear them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Exposures that ran their whole time.
    pub exposed: u64,
    /// Exposures ended early.
    pub cut_short: u64,
    /// Layers received without error.
    pub uploads: u64,
    /// Bytes of layer data taken.
    pub layer_bytes: u64,
    /// Bytes of layer data that belonged to no layer.
    pub stray_bytes: u64,
    /// Requests refused.
    pub refused: u64,
    /// Moves and homings that arrived.
    pub moves: u64,
    /// Times the host fell silent.
    pub silences: u64,
    /// Resets.
    pub resets: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Readiness {
    Ready,
    /// Begins nothing until Release; at most one request waits.
    Held,
    /// Aborted, the host silent, or just started: begins nothing until a hello.
    WaitsForHello,
}

/// The state of the firmware.
#[derive(Debug)]
pub struct DeviceCore {
    capabilities: Capabilities,
    boot_id: u32,
    readiness: Readiness,
    fault: Option<Fault>,
    slots: Vec<Option<(ExposureId, Bitmap)>>,
    upload: Option<Upload>,
    vat: Vat,
    /// Kept across resets, as in a real device's non-volatile memory.
    last_exposed: Option<ExposureId>,
    cut_short: Option<(ExposureId, u32)>,
    now_us: u64,
    /// At most a handful of entries for each call; the owner empties it after each.
    actions: VecDeque<CoreAction>,
    statistics: Statistics,
}

impl DeviceCore {
    /// A device that was just switched on: dark, not homed, waiting for a hello. `boot_id` differs from start to start.
    pub fn new(capabilities: Capabilities, boot_id: u32) -> Self {
        let slots = vec![None; usize::from(capabilities.layer_slots)];
        Self {
            capabilities,
            boot_id,
            readiness: Readiness::WaitsForHello,
            fault: None,
            slots,
            upload: None,
            vat: Vat::new(),
            last_exposed: None,
            cut_short: None,
            now_us: 0,
            actions: VecDeque::new(),
            statistics: Statistics::default(),
        }
    }

    /// The capabilities that the device reports.
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// Counts.
    pub fn statistics(&self) -> Statistics {
        self.statistics
    }

    /// The next action for the owner.
    pub fn action(&mut self) -> Option<CoreAction> {
        self.actions.pop_front()
    }

    /// When [`advance`](Self::advance) must be called next.
    pub fn next_timeout_us(&self) -> Option<u64> {
        self.vat.next_timeout_us()
    }

    /// Ends what is due by `now_us`. Every other call with a time does this first.
    pub fn advance(&mut self, now_us: u64) {
        self.advance_vat(now_us);
        self.now_us = self.now_us.max(now_us);
    }

    /// The state, as sent in the welcome and in reply to [`Request::State`].
    pub fn state(&self) -> DeviceState {
        let exposing = self.vat.exposing();
        DeviceState {
            boot_id: self.boot_id,
            last_exposed: self.last_exposed,
            exposing,
            cut_short: self.cut_short,
            light_on: exposing.is_some(),
            position_um: self.vat.position_um(self.now_us),
            moving: self.vat.is_moving(),
            slots: self.slots.iter().map(|slot| slot.as_ref().map(|(id, _)| *id)).collect(),
            fault: self.fault.clone(),
        }
    }

    /// A host begins a session. A running act goes on, but its reply is not sent. An abort is cleared.
    pub fn hello(&mut self, now_us: u64) -> DeviceState {
        self.advance(now_us);
        self.drop_session();
        self.readiness = Readiness::Ready;
        self.record(ActRecord { event: "hello", ..ActRecord::default() });
        self.state()
    }

    /// The host was silent for too long. A running act ends by the device's clock; nothing begins until a hello.
    pub fn host_silent(&mut self, now_us: u64) {
        self.advance(now_us);
        self.drop_session();
        self.readiness = Readiness::WaitsForHello;
        self.statistics.silences += 1;
        self.record(ActRecord { event: "host_silent", ..ActRecord::default() });
    }

    /// The device restarts. Only its non-volatile memory survives.
    pub fn reset(&mut self, boot_id: u32, now_us: u64) {
        self.advance(now_us);
        self.drop_session();
        self.record(ActRecord { event: "reset", ..ActRecord::default() });
        self.cut_exposure("reset");
        self.lose_moving_position();
        self.stop_motion();
        self.slots.fill(None);
        (self.boot_id, self.readiness, self.fault) = (boot_id, Readiness::WaitsForHello, None);
        self.statistics.resets += 1;
    }

    /// A fault begins or ends (`None`).
    pub fn set_fault(&mut self, fault: Option<Fault>, now_us: u64) {
        self.advance(now_us);
        if let Some(fault) = &fault {
            self.cut_exposure("fault");
            self.stop_motion();
            self.record(ActRecord { event: "fault", reason: Some(fault.text.clone()), ..ActRecord::default() });
        }
        self.fault.clone_from(&fault);
        self.send(DeviceMessage::Report(Report::Fault(fault)));
    }

    /// Carries out an urgent order at once. Returns whether the light is on afterwards.
    pub fn urgent(&mut self, urgent: Urgent, now_us: u64) -> bool {
        self.advance(now_us);
        let name = match urgent {
            Urgent::Abort => "abort",
            Urgent::LightOff => "light_off",
            Urgent::Hold => "hold",
            Urgent::Release => "release",
        };
        self.record(ActRecord { event: "urgent", reason: Some(name.into()), ..ActRecord::default() });
        match urgent {
            Urgent::Abort => self.abort(),
            Urgent::LightOff => self.cut_exposure("light_off"),
            Urgent::Hold if self.readiness == Readiness::Ready => self.readiness = Readiness::Held,
            Urgent::Release if self.readiness == Readiness::Held => {
                self.readiness = Readiness::Ready;
                if let Some((number, request)) = self.take_waiting() {
                    self.request(number, Request::Vat(request));
                }
            }
            Urgent::Hold | Urgent::Release => {}
        }
        self.vat.exposing().is_some()
    }

    fn abort(&mut self) {
        self.cut_exposure("abort");
        self.stop_motion();
        self.readiness = Readiness::WaitsForHello;
        self.slots.fill(None);
        if let Some(upload) = self.upload.take() {
            self.reply(Some(upload.number), Reply::Refused(Refusal::NotReady));
        }
        if let Some((number, _)) = self.take_waiting() {
            self.reply(Some(number), Reply::Refused(Refusal::NotReady));
        }
    }

    /// Handles a message that the session delivers.
    pub fn handle(&mut self, message: HostMessage, now_us: u64) {
        self.advance(now_us);
        match message {
            HostMessage::Request { number, request } => self.request(number, request),
            HostMessage::LayerData(bytes) => self.layer_data(&bytes),
        }
    }

    fn request(&mut self, number: u32, request: Request) {
        let (result, (what, id)) = match request {
            Request::State => {
                let state = self.state();
                self.reply(Some(number), Reply::State(state));
                return;
            }
            Request::LayerBegin { slot, id, encoding, encoded_bytes, decoded_crc32 } => {
                let layer = (encoding, encoded_bytes, decoded_crc32);
                (self.layer_begin(number, slot, id, layer), ("layer_begin", Some(id)))
            }
            Request::Vat(request) => (self.begin_act(number, request), vat::named(request)),
        };
        if let Err(refusal) = result {
            self.refused(number, id, what, refusal);
        }
    }

    fn check_ready(&self) -> Result<(), Refusal> {
        let ready = self.readiness != Readiness::WaitsForHello && self.fault.is_none();
        if ready { Ok(()) } else { Err(Refusal::NotReady) }
    }

    /// Forgets the requests of the old session. A layer that is not complete is dropped.
    fn drop_session(&mut self) {
        self.upload = None;
        self.vat.forget_requests();
    }

    fn refused(&mut self, number: u32, id: Option<ExposureId>, what: &str, refusal: Refusal) {
        self.statistics.refused += 1;
        let reason = Some(format!("{what}: {refusal:?}"));
        let record = id.map_or(ActRecord { event: "refused", ..ActRecord::default() }, |id| of_layer("refused", id));
        self.record(ActRecord { reason, ..record });
        self.reply(Some(number), Reply::Refused(refusal));
    }

    fn reply(&mut self, number: Option<u32>, reply: Reply) {
        if let Some(number) = number {
            self.send(DeviceMessage::Reply { number, reply });
        }
    }

    fn send(&mut self, message: DeviceMessage) {
        self.actions.push_back(CoreAction::Send(message));
    }

    fn record(&mut self, record: ActRecord) {
        self.actions.push_back(CoreAction::Record(ActRecord { t_ms: self.now_us / 1000, ..record }));
    }
}

fn of_layer(event: &'static str, id: ExposureId) -> ActRecord {
    ActRecord { event, job: Some(id.job), layer: Some(id.layer), ..ActRecord::default() }
}
