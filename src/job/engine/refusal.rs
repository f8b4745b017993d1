//! Refusals by the device: of a layer, of an act of the cycle, of an exposure. Tested by `tests/job_lies/dose.rs`.

use super::Engine;
use super::next::Sign;
use crate::job::JobState;
use crate::job::cycle::Requested;
use crate::link::message::Refusal;

impl Engine {
    /// The device did not take a layer.
    pub(super) fn on_upload_refused(&mut self, exposure: u32, refusal: Refusal, now_us: u64) {
        if let Some(count) = self.uploads.refused(exposure) {
            let remedy = self.cycle.remedy(Requested::Upload, refusal);
            let text = format!("the device refused {} {count} times: {remedy}", self.plan.passes.text(exposure));
            self.wind_down(self.failed_or_interrupted(), text, now_us);
        }
    }

    /// The device refused an act of the cycle.
    pub(super) fn on_act_refused(&mut self, refusal: Refusal, now_us: u64) {
        let busy = if refusal == Refusal::Busy { self.cycle.busy() } else { None };
        if let Some(step) = busy {
            self.deadline = None;
            return self.take(step, now_us);
        }
        let remedy = self.cycle.remedy(Requested::Act, refusal);
        self.end_unparked(format!("the device refused to move: {remedy}"));
    }

    /// The device refused the exposure, or ended it early.
    pub(super) fn on_exposure_refused(&mut self, refusal: Refusal, now_us: u64) {
        let layer = self.next_text();
        match refusal {
            // Its state tells up to which vector it was marked.
            Refusal::CutShort if self.cycle.continues() => self.ask(now_us),
            Refusal::CutShort if self.light.must_wait() => self.doubt("its light was switched off", now_us),
            Refusal::CutShort => {
                self.doubt("the device ended its light early (`layerctl device` tells after how long)", now_us);
            }
            // Its state must agree that there was no light.
            _ => {
                if refusal == Refusal::AlreadyExposed {
                    self.out.notice(format!("the device says it exposed {layer} before; asking it for its state"));
                }
                self.next.note(Sign::Refused(refusal));
                self.ask(now_us);
            }
        }
    }

    /// The device refused to expose the layer, and nothing shows that there was light.
    pub(super) fn on_refused_unlit(&mut self, refusal: Refusal, now_us: u64) {
        let layer = self.next_text();
        self.deny();
        match refusal {
            Refusal::AlreadyExposed => {}
            Refusal::NoSuchLayer => {
                self.out.notice(format!("the device no longer holds {layer}; it is sent again"));
                self.uploads.release(self.next.number);
            }
            _ => {
                let state = match refusal {
                    // The operator can do something about it.
                    Refusal::NotReady | Refusal::NotRecoated | Refusal::WrongVector | Refusal::NoSuchVat => {
                        JobState::Interrupted
                    }
                    _ => JobState::Failed,
                };
                let remedy = self.cycle.remedy(Requested::Act, refusal);
                self.intent.add_end(state, format!("the device refused to expose {layer}: {remedy}"));
            }
        }
        self.advance(now_us);
    }
}
