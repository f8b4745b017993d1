//! Whether the light that a device reports is light that was commanded, and for no longer than commanded.

use crate::link::message::{DeviceState, ExposureId};

/// What a device may take beyond the commanded time of an exposure and the round trip of its request: half a second covers the
/// answer's way on a slow line that repairs one loss.
const GRACE_US: u64 = 500_000;
/// A request whose arrival nobody has confirmed counts as arrived after this time. A line that carries nothing for so long is
/// lost anyway.
const LONGEST_ROUND_TRIP_US: u64 = 2_000_000;

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
        let began_us = self.taken_us.unwrap_or(self.commanded_us + LONGEST_ROUND_TRIP_US);
        began_us + u64::from(self.duration_ms) * 1000 + GRACE_US
    }

    fn too_long(&self) -> String {
        let Self { id, duration_ms, .. } = self;
        format!("layer {} still has light after its commanded {duration_ms} ms", id.layer)
    }
}
