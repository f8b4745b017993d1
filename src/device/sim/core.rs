//! The firmware of a simulated DLP machine, on top of the device's session: messages and the time go in, actions come out.
//!
//! Times are microseconds of the device's own clock. The end of an exposure or a move is stamped with the time when it was due,
//! however late [`DlpCore::advance`] is called. The light is on only during an exposure. An exposure ends by the device's clock,
//! by an urgent light-off or abort, by a fault, or by a reset.

mod plate;
mod upload;

use std::collections::VecDeque;

use plate::{HOMING_SPEED_UM_S, Motion};
use upload::Upload;

use super::log::ActRecord;
use crate::layer::Bitmap;
use crate::link::message::{
    Capabilities, DeviceMessage, DeviceState, ExposureId, Fault, HostMessage, Refusal, Reply, Report, Request, Urgent,
    VatReply, VatRequest,
};

/// Where the plate stands before the first homing. Only the simulation knows it.
const UNKNOWN_POSITION_UM: i32 = 20_000;

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

#[derive(Debug)]
struct Exposure {
    /// Number of the request, while its session lasts.
    number: Option<u32>,
    slot: usize,
    id: ExposureId,
    began_us: u64,
    duration_ms: u32,
}

/// The state of the firmware.
#[derive(Debug)]
pub struct DlpCore {
    capabilities: Capabilities,
    boot_id: u32,
    readiness: Readiness,
    fault: Option<Fault>,
    slots: Vec<Option<(ExposureId, Bitmap)>>,
    upload: Option<Upload>,
    exposure: Option<Exposure>,
    motion: Option<Motion>,
    waiting: Option<(u32, VatRequest)>,
    position_um: i32,
    homed: bool,
    /// Kept across resets, as in a real device's non-volatile memory.
    last_exposed: Option<ExposureId>,
    cut_short: Option<(ExposureId, u32)>,
    now_us: u64,
    /// At most a handful of entries for each call; the owner empties it after each.
    actions: VecDeque<CoreAction>,
    statistics: Statistics,
}

impl DlpCore {
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
            exposure: None,
            motion: None,
            waiting: None,
            position_um: UNKNOWN_POSITION_UM,
            homed: false,
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
        let light_off_us = self.exposure.as_ref().map(Exposure::ends_us);
        let arrival_us = self.motion.as_ref().map(|motion| motion.arrives_us);
        light_off_us.into_iter().chain(arrival_us).min()
    }

    /// Ends what is due by `now_us`. Every other call with a time does this first.
    pub fn advance(&mut self, now_us: u64) {
        if let Some(exposure) = self.exposure.take_if(|exposure| exposure.ends_us() <= now_us) {
            self.now_us = exposure.ends_us();
            self.end_exposure(&exposure);
        }
        if let Some(motion) = self.motion.take_if(|motion| motion.arrives_us <= now_us) {
            self.now_us = motion.arrives_us;
            self.arrive(&motion);
        }
        self.now_us = self.now_us.max(now_us);
    }

    /// The state, as sent in the welcome and in reply to [`Request::State`].
    pub fn state(&self) -> DeviceState {
        let moving_at = self.motion.as_ref().map(|motion| motion.position_um(self.now_us));
        DeviceState {
            boot_id: self.boot_id,
            last_exposed: self.last_exposed,
            exposing: self.exposure.as_ref().map(|exposure| exposure.id),
            cut_short: self.cut_short,
            light_on: self.exposure.is_some(),
            position_um: self.homed.then_some(moving_at.unwrap_or(self.position_um)),
            moving: self.motion.is_some(),
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
        // The position of a plate at rest is in non-volatile memory.
        self.homed &= self.motion.is_none();
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
                if let Some((number, request)) = self.waiting.take() {
                    self.request(number, Request::Vat(request));
                }
            }
            Urgent::Hold | Urgent::Release => {}
        }
        self.exposure.is_some()
    }

    fn abort(&mut self) {
        self.cut_exposure("abort");
        self.stop_motion();
        self.readiness = Readiness::WaitsForHello;
        self.slots.fill(None);
        if let Some(upload) = self.upload.take() {
            self.reply(Some(upload.number), Reply::Refused(Refusal::NotReady));
        }
        if let Some((number, _)) = self.waiting.take() {
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
            Request::Vat(request) => (self.begin_act(number, request), act_named(request)),
        };
        if let Err(refusal) = result {
            self.refused(number, id, what, refusal);
        }
    }

    fn begin_act(&mut self, number: u32, request: VatRequest) -> Result<(), Refusal> {
        self.check_ready()?;
        if self.readiness == Readiness::Held {
            if self.waiting.is_some() {
                return Err(Refusal::Busy);
            }
            self.waiting = Some((number, request));
            return Ok(());
        }
        // Light while the plate moves would smear the layer.
        if self.exposure.is_some() || self.motion.is_some() {
            return Err(Refusal::Busy);
        }
        match request {
            VatRequest::Expose { id, duration_ms, light_pwm } => self.expose(number, id, duration_ms, light_pwm),
            VatRequest::Move { position_um, speed_um_s } => self.begin_move(number, position_um, speed_um_s),
            VatRequest::Home => {
                self.begin_motion(number, 0, HOMING_SPEED_UM_S, true);
                Ok(())
            }
        }
    }

    fn check_ready(&self) -> Result<(), Refusal> {
        let ready = self.readiness != Readiness::WaitsForHello && self.fault.is_none();
        if ready { Ok(()) } else { Err(Refusal::NotReady) }
    }

    fn expose(&mut self, number: u32, id: ExposureId, duration_ms: u32, light_pwm: u8) -> Result<(), Refusal> {
        if duration_ms == 0 || light_pwm == 0 || duration_ms > self.capabilities.max_exposure_ms {
            return Err(Refusal::BadDuration);
        }
        if self.last_exposed.is_some_and(|last| last.job == id.job && id <= last) {
            return Err(Refusal::AlreadyExposed);
        }
        let held = |slot: &Option<(ExposureId, Bitmap)>| slot.as_ref().is_some_and(|(held, _)| *held == id);
        let slot = self.slots.iter().position(held).ok_or(Refusal::NoSuchLayer)?;
        self.exposure = Some(Exposure { number: Some(number), slot, id, began_us: self.now_us, duration_ms });
        self.record(of_layer("light_on", id));
        Ok(())
    }

    /// An exposure that ran its whole time.
    fn end_exposure(&mut self, exposure: &Exposure) {
        let Exposure { number, slot, id, duration_ms, .. } = *exposure;
        self.last_exposed = Some(id);
        self.statistics.exposed += 1;
        self.record(of_layer("light_off", id));
        // The picture goes before its log line, so that a reader of the log finds the file.
        if let Some((_, picture)) = self.slots[slot].take() {
            self.actions.push_back(CoreAction::Picture(id.layer, picture));
        }
        self.record(ActRecord { duration_ms: Some(duration_ms), ..of_layer("exposed", id) });
        self.reply(number, Reply::Vat(VatReply::Exposed { id, duration_ms }));
    }

    fn cut_exposure(&mut self, reason: &str) {
        let Some(exposure) = self.exposure.take() else { return };
        let lit_ms = ((self.now_us - exposure.began_us) / 1000) as u32;
        self.cut_short = Some((exposure.id, lit_ms));
        self.slots[exposure.slot] = None;
        self.statistics.cut_short += 1;
        let record = of_layer("light_off", exposure.id);
        self.record(ActRecord { duration_ms: Some(lit_ms), reason: Some(reason.into()), ..record });
        self.reply(exposure.number, Reply::Refused(Refusal::CutShort));
    }

    /// Forgets the requests of the old session. A layer that is not complete is dropped.
    fn drop_session(&mut self) {
        (self.upload, self.waiting) = (None, None);
        if let Some(exposure) = &mut self.exposure {
            exposure.number = None;
        }
        if let Some(motion) = &mut self.motion {
            motion.number = None;
        }
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

/// The name of a request in the log, and its exposure.
fn act_named(request: VatRequest) -> (&'static str, Option<ExposureId>) {
    match request {
        VatRequest::Expose { id, .. } => ("expose", Some(id)),
        VatRequest::Home => ("home", None),
        VatRequest::Move { .. } => ("move", None),
    }
}

fn of_layer(event: &'static str, id: ExposureId) -> ActRecord {
    ActRecord { event, job: Some(id.job), layer: Some(id.layer), ..ActRecord::default() }
}

impl Exposure {
    fn ends_us(&self) -> u64 {
        self.began_us + u64::from(self.duration_ms) * 1000
    }
}
