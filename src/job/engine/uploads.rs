//! For which exposures the device holds layers, and which one to send next. See it used in `Engine::pump_uploads`.

use crate::job::JobPlan;
use crate::link::message::{DeviceState, ExposureId};

/// Refusals in a row after which a layer is not sent again. The line repairs its own errors, so a second refusal already means
/// that the device cannot decode the layer.
const MAX_REFUSALS: u8 = 3;

/// The device's slots as far as this job is concerned.
#[derive(Debug, Default)]
pub(super) struct Uploads {
    /// The exposure of the job whose layer is in each slot.
    slots: Vec<Option<u32>>,
    /// The upload under way: exposure and slot.
    running: Option<(u32, u8)>,
    /// The exposure whose layer the running sweep computes next.
    sweep_at: Option<u32>,
    refusals: u8,
    /// The first layer of this session has arrived: from now on a missing layer is late.
    warm: bool,
}

/// The next upload.
pub(super) struct Wanted {
    pub(super) exposure: u32,
    pub(super) slot: u8,
    /// Whether a new sweep must start there.
    pub(super) new_sweep: bool,
}

impl Uploads {
    /// Takes the slots from the state of a new session. An upload under way is void. A layer of which `knows` says that too little
    /// is known to expose it is sent again.
    pub(super) fn reset(&mut self, plan: &JobPlan, state: &DeviceState, knows: impl Fn(u32) -> bool) {
        let ours = |slot: &Option<ExposureId>| plan.exposure(slot.as_ref()?).filter(|exposure| knows(*exposure));
        self.warm = false;
        self.slots = state.slots.iter().map(ours).collect();
        self.cancel();
    }

    /// Forgets the upload under way.
    pub(super) fn cancel(&mut self) {
        self.running = None;
        self.sweep_at = None;
    }

    pub(super) fn holds(&self, exposure: u32) -> bool {
        self.slots.contains(&Some(exposure))
    }

    /// Notes that no slot holds the layer any longer: it was exposed, or the device lost it.
    pub(super) fn release(&mut self, exposure: u32) {
        for slot in &mut self.slots {
            *slot = slot.filter(|held| *held != exposure);
        }
    }

    /// Notes that an upload succeeded. Returns false if it is not the one under way.
    pub(super) fn uploaded(&mut self, exposure: u32) -> bool {
        let Some((_, slot)) = self.running.take_if(|running| running.0 == exposure) else {
            return false;
        };
        self.refusals = 0;
        if let Some(place) = self.slots.get_mut(usize::from(slot)) {
            *place = Some(exposure);
        }
        true
    }

    /// Whether the machine may go to where `next_exposure` is exposed: it waits for the first layer of a session before that, and for
    /// a later one in place.
    pub(super) fn may_begin(&mut self, next_exposure: u32) -> bool {
        self.warm |= self.holds(next_exposure);
        self.warm
    }

    /// Notes a refused upload. Returns the number of refusals in a row if sending the layer again is pointless.
    pub(super) fn refused(&mut self, exposure: u32) -> Option<u8> {
        self.running.take_if(|running| running.0 == exposure)?;
        self.cancel();
        self.refusals += 1;
        (self.refusals >= MAX_REFUSALS).then_some(self.refusals)
    }

    /// The next upload if `next_exposure` is exposed next. `None` while an upload is under way, while the slots hold all layers
    /// that fit, and when no layer is left.
    pub(super) fn next(&mut self, next_exposure: u32, exposure_count: u32) -> Option<Wanted> {
        if self.running.is_some() {
            return None;
        }
        let ahead = u32::try_from(self.slots.len()).ok()?;
        let needed = next_exposure..exposure_count.min(next_exposure.saturating_add(ahead));
        let exposure = needed.clone().find(|exposure| !self.holds(*exposure))?;
        let free = |slot: &Option<u32>| slot.is_none_or(|held| !needed.contains(&held));
        let slot = u8::try_from(self.slots.iter().position(free)?).ok()?;
        self.slots[usize::from(slot)] = None;
        self.running = Some((exposure, slot));
        let new_sweep = self.sweep_at != Some(exposure);
        self.sweep_at = Some(exposure + 1);
        Some(Wanted { exposure, slot, new_sweep })
    }
}
