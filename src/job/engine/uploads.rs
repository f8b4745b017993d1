//! Which layers the device holds, and which one to send next.

use crate::link::message::{DeviceState, ExposureId, Refusal};

/// Refusals in a row after which a layer is not sent again. The line repairs its own errors, so a second refusal already means
/// that the device cannot decode the layer.
const MAX_REFUSALS: u8 = 3;

/// The device's slots as far as this job is concerned.
#[derive(Debug, Default)]
pub(super) struct Uploads {
    /// The job's layer in each slot.
    slots: Vec<Option<u32>>,
    /// The upload under way: layer and slot.
    running: Option<(u32, u8)>,
    /// The layer that the running sweep computes next.
    sweep_at: Option<u32>,
    refusals: u8,
}

/// The next upload.
pub(super) struct Wanted {
    pub(super) layer: u32,
    pub(super) slot: u8,
    /// Whether a new sweep must start at that layer.
    pub(super) new_sweep: bool,
}

impl Uploads {
    /// Takes the slots from the state of a new session. An upload under way is void.
    pub(super) fn reset(&mut self, key: u64, state: &DeviceState) {
        let ours = |slot: &Option<ExposureId>| slot.filter(|id| *id == ExposureId::first_pass(key, id.layer));
        self.slots = state.slots.iter().map(|slot| ours(slot).map(|id| id.layer)).collect();
        self.cancel();
    }

    /// Forgets the upload under way.
    pub(super) fn cancel(&mut self) {
        self.running = None;
        self.sweep_at = None;
    }

    pub(super) fn holds(&self, layer: u32) -> bool {
        self.slots.contains(&Some(layer))
    }

    /// Notes that no slot holds the layer any longer: it was exposed, or the device lost it.
    pub(super) fn release(&mut self, layer: u32) {
        for slot in &mut self.slots {
            *slot = slot.filter(|held| *held != layer);
        }
    }

    /// Notes that an upload succeeded. Returns false if it is not the one under way.
    pub(super) fn uploaded(&mut self, layer: u32) -> bool {
        let Some((_, slot)) = self.running.take_if(|running| running.0 == layer) else {
            return false;
        };
        self.refusals = 0;
        if let Some(place) = self.slots.get_mut(usize::from(slot)) {
            *place = Some(layer);
        }
        true
    }

    /// Notes a refused upload.
    ///
    /// # Errors
    /// What to tell the operator if sending the layer again is pointless.
    pub(super) fn refused(&mut self, layer: u32, refusal: Refusal) -> Result<(), String> {
        if self.running.take_if(|running| running.0 == layer).is_none() {
            return Ok(());
        }
        self.cancel();
        self.refusals += 1;
        if self.refusals < MAX_REFUSALS {
            return Ok(());
        }
        Err(format!("the device refused layer {layer} {MAX_REFUSALS} times: {}", remedy(refusal)))
    }

    /// The next upload if `next_layer` is exposed next. `None` while an upload is under way, while the slots hold all layers
    /// that fit, and when no layer is left.
    pub(super) fn next(&mut self, next_layer: u32, layer_count: u32) -> Option<Wanted> {
        if self.running.is_some() {
            return None;
        }
        let ahead = u32::try_from(self.slots.len()).ok()?;
        let needed = next_layer..layer_count.min(next_layer.saturating_add(ahead));
        let layer = needed.clone().find(|layer| !self.holds(*layer))?;
        let free = |slot: &Option<u32>| slot.is_none_or(|held| !needed.contains(&held));
        let slot = u8::try_from(self.slots.iter().position(free)?).ok()?;
        self.slots[usize::from(slot)] = None;
        self.running = Some((layer, slot));
        let new_sweep = self.sweep_at != Some(layer);
        self.sweep_at = Some(layer + 1);
        Some(Wanted { layer, slot, new_sweep })
    }
}

/// Why a device does not take a layer, and what to do.
fn remedy(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NotReady => "it is not ready; look at the device, then resume",
        Refusal::NoSuchLayer => "it does not have the slots that it stated; check its firmware",
        Refusal::SlotBusy => {
            "it says that the slot is being exposed, which this job did not ask for; check its firmware"
        }
        Refusal::BadLayer => {
            "it cannot decode the layer; check that the machine file's width_px and height_px are the device's"
        }
        Refusal::BadEncoding => {
            "it does not read the encoding, although it stated that it does; check its firmware, or change `antialias` in the \
             recipe"
        }
        Refusal::Unknown => "it does not know the request; check that it is a DLP machine of this protocol version",
        Refusal::AlreadyExposed
        | Refusal::BadDuration
        | Refusal::BadMove
        | Refusal::NotHomed
        | Refusal::Busy
        | Refusal::CutShort => "this refusal does not apply to a layer; check its firmware",
    }
}
