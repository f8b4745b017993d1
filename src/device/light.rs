//! Compares the light that a device reports with the exposure that was commanded.
//!
//! ```
//! use layerd::device::{Light, LightWatch};
//! use layerd::link::message::{DeviceState, ExposureId};
//!
//! let id = ExposureId::first_pass(7, 0);
//! let mut watch = LightWatch::default();
//! watch.command(id, 2000, 0);
//! watch.taken(10_000);
//! // It may last its 2 s from when the command arrived, and half a second more.
//! let lit = DeviceState { light_on: true, exposing: Some(id), ..DeviceState::default() };
//! assert_eq!(watch.observe(&lit, 1_000_000), Light::Commanded { until_us: 2_510_000 });
//! assert!(matches!(watch.observe(&lit, 2_600_000), Light::Uncommanded(_)));
//! ```

use crate::deadline::Deadline;
use crate::link::message::{DeviceState, ExposureId};

/// Time that an exposure may take beyond its commanded time and the round trip of its request. Half a second covers the reply on a
/// slow line that recovers from one loss.
const GRACE_US: u64 = 500_000;
/// A request without confirmed arrival counts as arrived after this time. A line that carries nothing for so long is lost anyway.
const MAX_ROUND_TRIP_US: u64 = 2_000_000;
/// Time in which a device must report dark after a light-off, microseconds. The device takes 100 ms; the rest is for the recovery
/// of the line.
pub const DARK_LIMIT_US: u64 = 5_000_000;
/// Warning to the operator about a device that is lit for longer than [`DARK_LIMIT_US`] after a light-off.
pub const STAYS_LIT: &str =
    "WARNING: the device does not switch its light off: switch the machine off at its mains and look";

/// What a reported state says about the light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Light {
    /// No light, and no exposure under way.
    Dark,
    /// The last commanded exposure is under way.
    Commanded {
        /// It must have ended by this time, microseconds.
        until_us: u64,
    },
    /// Light that was not commanded, or that lasts too long; the text says which. It must be switched off.
    Uncommanded(String),
}

/// Watches the light of one device, across its sessions. Times are microseconds of a monotonic clock.
#[derive(Clone, Debug, Default)]
pub struct LightWatch {
    exposure: Option<Exposure>,
    put_off: PutOff,
    /// When the device must be dark; `None` while it reports no unwanted light.
    dark_due: Option<Deadline>,
    /// It reported light after that time.
    stays_lit: bool,
    /// An abort was ordered and no exposure was commanded since: no light is right.
    aborted: bool,
}

/// The last commanded exposure, until it is known to have ended.
#[derive(Clone, Copy, Debug)]
struct Exposure {
    id: ExposureId,
    duration_ms: u32,
    /// When it was commanded.
    commanded_us: u64,
    /// When the device was known to have received the command.
    taken_us: Option<u64>,
    /// The device reported that it exposes the layer.
    shone: bool,
}

/// The state of a light-off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum PutOff {
    /// No order, or it was answered and the device has reported dark since.
    #[default]
    Settled,
    /// Not answered yet. The order is repeated until it is answered, and would cut short an exposure commanded now.
    Sent,
    /// Answered; the device has not reported dark since.
    Answered,
}

impl LightWatch {
    /// An exposure is commanded.
    pub fn command(&mut self, id: ExposureId, duration_ms: u32, now_us: u64) {
        self.exposure = Some(Exposure { id, duration_ms, commanded_us: now_us, taken_us: None, shone: false });
        self.aborted = false;
    }

    /// The device is known to have received the command. It counts as received 2 s after it was sent at the latest: a device
    /// that withholds its reply gains no light. If the time limit passed without the host acting on it, the host stood still: then
    /// the exposure gets its whole commanded time from now, so that the device is not blamed.
    pub fn taken(&mut self, now_us: u64) {
        let host_acts = self.put_off != PutOff::Settled;
        let Some(exposure) = self.exposure.as_mut().filter(|exposure| exposure.taken_us.is_none()) else { return };
        let host_stood_still = !host_acts && now_us > exposure.limit_us();
        let latest_us = exposure.commanded_us + MAX_ROUND_TRIP_US;
        exposure.taken_us = Some(if host_stood_still { now_us } else { now_us.min(latest_us) });
    }

    /// An exposure that an earlier process commanded is found under way. It gets its whole commanded time from now. Does nothing if
    /// this process commanded it, or after an abort.
    pub fn found(&mut self, id: ExposureId, duration_ms: u32, now_us: u64) {
        if !self.aborted && self.exposure.is_none_or(|known| known.id != id) {
            self.exposure =
                Some(Exposure { id, duration_ms, commanded_us: now_us, taken_us: Some(now_us), shone: true });
        }
    }

    /// The last commanded exposure has ended.
    pub fn ended(&mut self) {
        self.exposure = None;
    }

    /// An abort is ordered. From now on no light counts as commanded, until the next [`Self::command`].
    pub fn abort(&mut self) {
        self.exposure = None;
        self.aborted = true;
    }

    /// When the last commanded exposure must have ended; `None` if none is under way.
    pub fn limit_us(&self) -> Option<u64> {
        self.exposure.map(|exposure| exposure.limit_us())
    }

    /// Judges a state that the device reported.
    pub fn observe(&mut self, state: &DeviceState, now_us: u64) -> Light {
        let light = self.judge(state, now_us);
        if matches!(light, Light::Uncommanded(_)) {
            let due = self.dark_due.get_or_insert(Deadline::at(now_us + DARK_LIMIT_US));
            self.stays_lit |= due.is_over(now_us);
        } else {
            self.is_right();
        }
        light
    }

    /// Takes over the state of a welcome without judging it: if it shows no light, the device is dark.
    pub fn greeted(&mut self, state: &DeviceState) {
        if !state.light_on && state.exposing.is_none() {
            self.is_right();
        }
    }

    fn is_right(&mut self) {
        (self.dark_due, self.stays_lit) = (None, false);
    }

    /// Whether the last reported state shows unwanted light.
    pub fn is_unwanted(&self) -> bool {
        self.dark_due.is_some()
    }

    /// Whether the device is still lit [`DARK_LIMIT_US`] after it was ordered dark.
    pub fn stays_lit(&self) -> bool {
        self.stays_lit
    }

    fn judge(&mut self, state: &DeviceState, now_us: u64) -> Light {
        let Some(lit) = state.exposing else {
            if state.light_on {
                return Light::Uncommanded("the device shows light without an exposure".into());
            }
            if self.put_off == PutOff::Answered {
                self.put_off = PutOff::Settled;
            }
            return Light::Dark;
        };
        match self.exposure.as_mut().filter(|exposure| exposure.id == lit) {
            None => Light::Uncommanded(format!("the device exposes layer {}, which was not commanded", lit.layer)),
            Some(exposure) if now_us > exposure.limit_us() => Light::Uncommanded(exposure.too_long()),
            Some(exposure) => {
                exposure.shone = true;
                Light::Commanded { until_us: exposure.limit_us() }
            }
        }
    }

    /// Whether the layer was commanded last, and a state showed it being exposed.
    pub fn has_shone(&self, id: ExposureId) -> bool {
        self.exposure.is_some_and(|exposure| exposure.id == id && exposure.shone)
    }

    /// Message to the operator if [`Self::limit_us`] has passed and the exposure is not reported to have ended.
    pub fn overdue(&self) -> Option<String> {
        let Exposure { id, duration_ms, .. } = self.exposure?;
        Some(format!("the device does not report the end of layer {}'s exposure of {duration_ms} ms", id.layer))
    }

    /// A light-off was sent to the device.
    pub fn put_off(&mut self) {
        self.put_off = PutOff::Sent;
    }

    /// The device answered the light-off.
    pub fn put_off_answered(&mut self) {
        if self.put_off == PutOff::Sent {
            self.put_off = PutOff::Answered;
        }
    }

    /// Whether the light-off is not answered yet. It is repeated until it is.
    pub fn awaits_answer(&self) -> bool {
        self.put_off == PutOff::Sent
    }

    /// Stops waiting for the answer to the light-off.
    pub fn give_up(&mut self) {
        self.put_off = PutOff::Settled;
    }

    /// Whether nothing may be commanded yet: a light-off was sent, and the device has not answered it or has not reported dark
    /// since.
    pub fn must_wait(&self) -> bool {
        self.put_off != PutOff::Settled
    }
}

impl Exposure {
    fn limit_us(&self) -> u64 {
        let began_us = self.taken_us.unwrap_or(self.commanded_us + MAX_ROUND_TRIP_US);
        began_us + u64::from(self.duration_ms) * 1000 + GRACE_US
    }

    fn too_long(&self) -> String {
        let Self { id, duration_ms, .. } = self;
        format!("layer {} still has light after its commanded {duration_ms} ms", id.layer)
    }
}
