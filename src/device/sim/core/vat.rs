//! What only a vat machine does: exposures of whole pictures, and moves of the plate. Part of [`DeviceCore`].

mod plate;

use super::{ActRecord, CoreAction, DeviceCore, Readiness, of_layer};
use crate::layer::Bitmap;
use crate::link::message::{ExposureId, Refusal, Reply, VatReply, VatRequest};
use plate::{HOMING_SPEED_UM_S, Motion};

/// Where the plate stands before the first homing. Only the simulation knows it.
const UNKNOWN_POSITION_UM: i32 = 20_000;

/// Light and plate.
#[derive(Debug)]
pub(super) struct Vat {
    exposure: Option<Exposure>,
    motion: Option<Motion>,
    /// The request that came during a hold.
    waiting: Option<(u32, VatRequest)>,
    position_um: i32,
    homed: bool,
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

impl Vat {
    /// Dark, at rest, and not homed.
    pub(super) fn new() -> Self {
        Self { exposure: None, motion: None, waiting: None, position_um: UNKNOWN_POSITION_UM, homed: false }
    }

    /// When an act under way ends.
    pub(super) fn next_timeout_us(&self) -> Option<u64> {
        let light_off_us = self.exposure.as_ref().map(Exposure::ends_us);
        let arrival_us = self.motion.as_ref().map(|motion| motion.arrives_us);
        light_off_us.into_iter().chain(arrival_us).min()
    }

    pub(super) fn exposing(&self) -> Option<ExposureId> {
        self.exposure.as_ref().map(|exposure| exposure.id)
    }

    pub(super) fn exposes_slot(&self, slot: usize) -> bool {
        self.exposure.as_ref().is_some_and(|exposure| exposure.slot == slot)
    }

    pub(super) fn is_moving(&self) -> bool {
        self.motion.is_some()
    }

    /// Where the plate is; `None` before homing.
    pub(super) fn position_um(&self, now_us: u64) -> Option<i32> {
        let moving_at = self.motion.as_ref().map(|motion| motion.position_um(now_us));
        self.homed.then_some(moving_at.unwrap_or(self.position_um))
    }

    /// The session has ended: acts under way go on without a reply, and the request that waits is void.
    pub(super) fn forget_requests(&mut self) {
        self.waiting = None;
        if let Some(exposure) = &mut self.exposure {
            exposure.number = None;
        }
        if let Some(motion) = &mut self.motion {
            motion.number = None;
        }
    }
}

/// The name of a request in the log, and its exposure.
pub(super) fn named(request: VatRequest) -> (&'static str, Option<ExposureId>) {
    match request {
        VatRequest::Expose { id, .. } => ("expose", Some(id)),
        VatRequest::Home => ("home", None),
        VatRequest::Move { .. } => ("move", None),
    }
}

impl DeviceCore {
    /// The exposure under way, and its commanded time in milliseconds.
    pub fn exposure(&self) -> Option<(ExposureId, u32)> {
        self.vat.exposure.as_ref().map(|exposure| (exposure.id, exposure.duration_ms))
    }

    /// Ends the acts that are due by `now_us`, each at its own time.
    pub(super) fn advance_vat(&mut self, now_us: u64) {
        if let Some(exposure) = self.vat.exposure.take_if(|exposure| exposure.ends_us() <= now_us) {
            self.now_us = exposure.ends_us();
            self.end_exposure(&exposure);
        }
        if let Some(motion) = self.vat.motion.take_if(|motion| motion.arrives_us <= now_us) {
            self.now_us = motion.arrives_us;
            self.arrive(&motion);
        }
    }

    /// Begins an act, or lets it wait during a hold.
    pub(super) fn begin_act(&mut self, number: u32, request: VatRequest) -> Result<(), Refusal> {
        self.check_ready()?;
        if self.readiness == Readiness::Held {
            if self.vat.waiting.is_some() {
                return Err(Refusal::Busy);
            }
            self.vat.waiting = Some((number, request));
            return Ok(());
        }
        // Light while the plate moves would smear the layer.
        if self.vat.exposure.is_some() || self.vat.motion.is_some() {
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

    /// The request that waited during a hold.
    pub(super) fn take_waiting(&mut self) -> Option<(u32, VatRequest)> {
        self.vat.waiting.take()
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
        self.vat.exposure = Some(Exposure { number: Some(number), slot, id, began_us: self.now_us, duration_ms });
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

    /// The light goes off now, whatever is left of the exposure.
    pub(super) fn cut_exposure(&mut self, reason: &str) {
        let Some(exposure) = self.vat.exposure.take() else { return };
        let lit_ms = ((self.now_us - exposure.began_us) / 1000) as u32;
        self.cut_short = Some((exposure.id, lit_ms));
        self.slots[exposure.slot] = None;
        self.statistics.cut_short += 1;
        let record = of_layer("light_off", exposure.id);
        self.record(ActRecord { duration_ms: Some(lit_ms), reason: Some(reason.into()), ..record });
        self.reply(exposure.number, Reply::Refused(Refusal::CutShort));
    }
}
