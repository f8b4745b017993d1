//! Whether the light that a device reports is light that was commanded, and for no longer than commanded.

use crate::deadline::Deadline;
use crate::link::message::{DeviceState, ExposureId};

/// What a device may take beyond the commanded time of an exposure and the round trip of its request: half a second covers the
/// answer's way on a slow line that repairs one loss.
const GRACE_US: u64 = 500_000;
/// A request whose arrival nobody has confirmed counts as arrived after this time. A line that carries nothing for so long is
/// lost anyway.
const MAX_ROUND_TRIP_US: u64 = 2_000_000;
/// A device that was told to put its light off must report dark within this time, microseconds: it takes 100 ms, and the rest is
/// for a line that is just being repaired.
pub const DARK_LIMIT_US: u64 = 5_000_000;
/// What the operator is told about a device that is lit for longer than [`DARK_LIMIT_US`] after the order to be dark.
pub const STAYS_LIT: &str =
    "WARNING: the device does not put its light off: switch the machine off at its mains and look";

/// What a reported state says about the light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Light {
    /// No light, and no exposure under way.
    Dark,
    /// The exposure commanded last is under way.
    Commanded {
        /// It must have ended by this time, microseconds.
        until_us: u64,
    },
    /// Light that nobody commanded, or that lasts too long; the text says which. It must be put off.
    Uncommanded(String),
}

/// Watches the light of one device, across its sessions. Times are microseconds of any clock that never goes back.
#[derive(Clone, Debug, Default)]
pub struct LightWatch {
    exposure: Option<Exposure>,
    put_off: PutOff,
    /// By when the device must be dark; `None` where it has no unwanted light as far as it has said.
    dark_due: Option<Deadline>,
    /// It reported light after that time.
    stays_lit: bool,
}

/// The exposure commanded last, until it is known to have ended.
#[derive(Clone, Copy, Debug)]
struct Exposure {
    id: ExposureId,
    duration_ms: u32,
    /// When it was commanded.
    commanded_us: u64,
    /// When the device was first known to have the command.
    taken_us: Option<u64>,
    /// The device said that it exposes it.
    shone: bool,
}

/// An order to put the light off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum PutOff {
    /// None, or it was answered and the device has reported dark since.
    #[default]
    Settled,
    /// Not answered yet. It is repeated until it is, so light commanded now could be cut short by it.
    Sent,
    /// Answered; the device has not reported dark since.
    Answered,
}

impl LightWatch {
    /// An exposure is commanded.
    pub fn command(&mut self, id: ExposureId, duration_ms: u32, now_us: u64) {
        self.exposure = Some(Exposure { id, duration_ms, commanded_us: now_us, taken_us: None, shone: false });
    }

    /// The device is known to have the command.
    pub fn taken(&mut self, now_us: u64) {
        if let Some(exposure) = &mut self.exposure {
            exposure.taken_us.get_or_insert(now_us);
        }
    }

    /// An exposure that an earlier process commanded is found under way: it gets its whole commanded time from now. Nothing
    /// changes where this process commanded it.
    pub fn found(&mut self, id: ExposureId, duration_ms: u32, now_us: u64) {
        if self.exposure.is_none_or(|known| known.id != id) {
            self.exposure =
                Some(Exposure { id, duration_ms, commanded_us: now_us, taken_us: Some(now_us), shone: true });
        }
    }

    /// The exposure commanded last has ended.
    pub fn ended(&mut self) {
        self.exposure = None;
    }

    /// By when the exposure commanded last must have ended; `None` where none is under way.
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

    /// A state came in a welcome that is not judged any further: where it shows no light, there is none.
    pub fn greeted(&mut self, state: &DeviceState) {
        if !state.light_on && state.exposing.is_none() {
            self.is_right();
        }
    }

    fn is_right(&mut self) {
        (self.dark_due, self.stays_lit) = (None, false);
    }

    /// Whether the device showed unwanted light when it was last heard of.
    pub fn is_unwanted(&self) -> bool {
        self.dark_due.is_some()
    }

    /// Whether the device stays lit although it was told to be dark [`DARK_LIMIT_US`] ago.
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

    /// Whether the device was seen exposing that layer as the exposure commanded last.
    pub fn has_shone(&self, id: ExposureId) -> bool {
        self.exposure.is_some_and(|exposure| exposure.id == id && exposure.shone)
    }

    /// What to tell the operator where [`Self::limit_us`] has passed without a word that the exposure has ended.
    pub fn overdue(&self) -> Option<String> {
        let Exposure { id, duration_ms, .. } = self.exposure?;
        Some(format!("the device does not report the end of layer {}'s exposure of {duration_ms} ms", id.layer))
    }

    /// The device was told to put its light off.
    pub fn put_off(&mut self) {
        self.put_off = PutOff::Sent;
    }

    /// The device answered that order.
    pub fn put_off_answered(&mut self) {
        if self.put_off == PutOff::Sent {
            self.put_off = PutOff::Answered;
        }
    }

    /// Whether that order is not answered yet. It is repeated until it is.
    pub fn awaits_answer(&self) -> bool {
        self.put_off == PutOff::Sent
    }

    /// Nobody waits for the answer any longer.
    pub fn give_up(&mut self) {
        self.put_off = PutOff::Settled;
    }

    /// Whether nothing may be commanded yet: the device was told to put its light off, and has not answered or not reported
    /// dark since.
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
