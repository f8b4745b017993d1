//! The smallest host that prints: uploads ahead, exposes, reconnects; what the daemon does, without geometry and plate.

use layerd::device::encoding::{encode, picture_crc32};
use layerd::device::{Act, DriverEvent, FramedDriver, Outcome, VatAct, VatOutcome};
use layerd::link::message::{DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, Refusal};
use layerd::link::session::HostSession;

use super::{Host, capabilities, id, picture, send_all};

pub struct Printer {
    layers: u32,
    exposure_ms: u32,
    next: u32,
    driver: Option<FramedDriver>,
    /// The layer in each of the device's slots.
    slots: Vec<Option<u32>>,
    /// The layer on its way, and its slot.
    uploading: Option<(u32, usize)>,
    /// Whether no exposure of an earlier session is running.
    settled: bool,
    unsent: Option<HostMessage>,
    /// What the device reported to keep it from working.
    pub fault: Option<Fault>,
    /// How often the line was opened.
    pub openings: u32,
}

impl Printer {
    pub fn new(layers: u32, exposure_ms: u32) -> Self {
        Self {
            layers,
            exposure_ms,
            next: 0,
            driver: None,
            slots: Vec::new(),
            uploading: None,
            settled: false,
            unsent: None,
            fault: None,
            openings: 0,
        }
    }

    fn learn(&mut self, state: &DeviceState) {
        self.settled = state.exposing.is_none();
        if self.settled {
            let exposed = state.last_exposed.filter(|last| last.job == id(0).job).map_or(0, |last| last.layer + 1);
            assert!(exposed >= self.next, "the device forgot an exposure: {exposed} < {}", self.next);
            self.next = exposed;
        } else if let Some(driver) = &mut self.driver {
            driver.query_state(0);
        }
    }
}

impl Host for Printer {
    fn is_done(&self) -> bool {
        self.next == self.layers || self.fault.is_some()
    }

    fn opened(&mut self) {
        self.openings += 1;
    }

    fn connected(&mut self, state: &DeviceState) {
        self.driver = Some(FramedDriver::new(id(0).job, &capabilities().machine));
        self.unsent = None;
        self.uploading = None;
        let own = |slot: &Option<ExposureId>| slot.filter(|held| held.job == id(0).job).map(|held| held.layer);
        self.slots = state.slots.iter().map(own).collect();
        self.learn(state);
    }

    fn lost(&mut self) {
        self.driver = None;
    }

    fn message(&mut self, message: DeviceMessage) {
        let Some(driver) = &mut self.driver else { return };
        let Some(event) = driver.handle(message) else { return };
        match event {
            DriverEvent::ActDone(Outcome::Vat(VatOutcome::Exposed { layer, .. })) => {
                assert_eq!(layer, self.next);
                self.next += 1;
            }
            // The answer to the question behind an act.
            DriverEvent::StateKnown { .. } if driver.is_acting() => {}
            DriverEvent::StateKnown { state, .. } => self.learn(&state),
            // The old exposure may have begun just before its session ended.
            DriverEvent::ActDone(Outcome::Refused(Refusal::Busy)) => driver.query_state(0),
            DriverEvent::Fault(fault) => self.fault = fault,
            // Asked for before the fault was heard of.
            DriverEvent::ActDone(Outcome::Refused(_)) if self.fault.is_some() => {}
            DriverEvent::UploadRefused { refusal: Refusal::NotReady, .. } if self.fault.is_some() => {
                self.uploading = None;
            }
            DriverEvent::Uploaded { layer } => {
                let (sent, slot) = self.uploading.take().expect("an upload");
                assert_eq!(layer, sent);
                self.slots[slot] = Some(layer);
            }
            other => panic!("{other:?}"),
        }
    }

    fn work(&mut self, session: &mut HostSession) {
        let Some(driver) = &mut self.driver else { return };
        if self.settled {
            let needed = self.next..self.layers.min(self.next + 2);
            let missing = needed.clone().find(|layer| !self.slots.contains(&Some(*layer)));
            let free = self.slots.iter().position(|held| held.is_none_or(|layer| !needed.contains(&layer)));
            if let (Some(layer), Some(slot), None) = (missing, free, self.uploading) {
                let mut bytes = Vec::new();
                encode(&picture(layer), Encoding::Group4, &mut bytes).expect("bits");
                let crc32 = picture_crc32(&picture(layer));
                driver.upload(layer, 0, slot as u8, Encoding::Group4, bytes, crc32).expect("no upload under way");
                self.slots[slot] = None;
                self.uploading = Some((layer, slot));
            }
            if !driver.is_acting() && self.slots.contains(&Some(self.next)) {
                let act = Act::Vat(VatAct::Expose {
                    layer: self.next,
                    pass: 0,
                    duration_ms: self.exposure_ms,
                    light_pwm: 255,
                });
                driver.act(act, 0).expect("no act under way");
            }
        }
        send_all(session, &mut self.unsent, |piece_bytes| driver.next_message(piece_bytes, 0));
    }
}
