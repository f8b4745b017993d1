//! Signs of an earlier part on the plate or in the vat, and the operator's confirmation that it is gone.
//!
//! A job that has had no light yet drives the plate down: at its first approach, or while homing. Before that, each sign of an
//! earlier part that device or spool shows must be accounted for: by a record that the plate was lifted, or by the operator, who
//! is told each sign and confirms with `layerctl resume JOB`. A part whose plate was lifted is taken off by the operator, before
//! they start the next job or before they confirm one that waited in the queue.

use std::fmt;

use super::Printer;
use super::background::Background;
use super::idle::Idle;
use crate::config::Machine;
use crate::daemon::handle::CommandError;
use crate::daemon::jobs::Account;
use crate::daemon::jobs::job::{Job, TakeUp};
use crate::daemon::orders::Step;
use crate::job::{Event, Trace};
use crate::link::message::{DeviceState, ExposureId};
use crate::text::mm_text;

/// A plate this far below the clear height still counts as clear, micrometres: axes report positions to some ten micrometres.
pub(crate) const CLEAR_TOLERANCE_UM: i32 = 100;

/// Signs kept for a job. A device shows a handful, and few devices are connected one after the other.
const MAX_SIGNS: usize = 64;

/// Where the device's state shows an exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Seen {
    LastExposed,
    CutShort,
    Exposing,
    InSlot,
}

/// A sign of an earlier part that may be on the plate or in the vat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sign {
    /// The device shows an exposure that no journal here accounts for.
    Exposure {
        /// The exposure.
        trace: Trace,
        /// Where the device's state shows it.
        seen: Seen,
        /// The job with its key, whose journal has no record of it; `None` if no job here has that key.
        job: Option<u32>,
    },
    /// The plate is not clear of the resin.
    Low {
        /// Where it is.
        position_um: i32,
        /// Where it would be clear.
        clear_um: i32,
        /// The boot of the device.
        boot_id: u32,
    },
    /// `layerctl raise` lifted a plate that was not clear of the resin.
    Raised {
        /// From where.
        from_um: i32,
    },
    /// A job of this spool ended, and no record says that its plate was lifted.
    Left {
        /// The job.
        job: u32,
        /// Names its exposures.
        key: u64,
    },
}

impl Sign {
    /// Whether an operator who has confirmed the signs `known` has thereby confirmed this one. `state` is the device's.
    fn is_known(&self, known: &[Self], state: Option<&DeviceState>) -> bool {
        known.iter().any(|known| match (self, known) {
            (Self::Exposure { trace, .. }, Self::Exposure { trace: known, .. }) => trace == known,
            (Self::Low { boot_id, .. }, Self::Low { boot_id: known, .. }) => boot_id == known,
            // A part left in the vat means a low plate, on the device that printed it.
            (Self::Low { .. }, Self::Left { key, .. }) => state.is_some_and(|state| {
                let cut = state.cut_short.map(|(id, _)| id);
                state.last_exposed.into_iter().chain(cut).any(|id| id.job == *key)
            }),
            (Self::Left { job, .. }, Self::Left { job: known, .. }) => job == known,
            (Self::Raised { from_um }, Self::Raised { from_um: known }) => from_um == known,
            _ => false,
        })
    }
}

impl fmt::Display for Sign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exposure { trace: Trace::Lit { layer, .. } | Trace::Held { layer, .. }, seen, job } => {
                match seen {
                    Seen::LastExposed => write!(f, "the device last exposed layer {layer}")?,
                    Seen::CutShort => write!(f, "the device cut short the light of layer {layer}")?,
                    Seen::Exposing => write!(f, "the device is exposing layer {layer}")?,
                    Seen::InSlot => write!(f, "the device holds layer {layer}")?,
                }
                match job {
                    Some(job) => write!(f, " of job {job}, whose journal has no record of it"),
                    None => write!(f, " of a job this spool does not know"),
                }
            }
            Self::Low { position_um, clear_um, .. } => write!(
                f,
                "the plate is {} above the vat, below the clear height of {} (`layerctl raise` lifts it)",
                mm_text(*position_um),
                mm_text(*clear_um)
            ),
            Self::Raised { from_um } => {
                write!(f, "the plate was raised from {} above the vat, and may carry a part", mm_text(*from_um))
            }
            Self::Left { job, .. } => write!(f, "no record says that the plate was lifted at the end of job {job}"),
        }
    }
}

/// What to do and the signs, as one text. Of each job only the first exposure is named.
pub(crate) fn text(signs: &[Sign], job: u32) -> String {
    let mut keys = Vec::new();
    let is_new = |sign: &&Sign| match sign {
        Sign::Exposure { trace: Trace::Lit { job, .. } | Trace::Held { job, .. }, .. } => {
            let is_new = !keys.contains(job);
            keys.push(*job);
            is_new
        }
        Sign::Low { .. } | Sign::Raised { .. } | Sign::Left { .. } => true,
    };
    let signs: Vec<_> = signs.iter().filter(is_new).map(ToString::to_string).collect();
    format!(
        "waits for an empty plate: look at plate and vat, take out what is there, then `layerctl resume {job}`. Why: {}",
        signs.join("; ")
    )
}

/// The exposures that a device shows, and where.
fn traces(state: &DeviceState) -> Vec<(Trace, Seen)> {
    let lit = |id: ExposureId| Trace::Lit { job: id.job, layer: id.layer };
    let held = |id: ExposureId| Trace::Held { job: id.job, layer: id.layer };
    let slots = state.slots.iter().flatten().map(|id| (held(*id), Seen::InSlot));
    let shown = [
        (state.exposing, Seen::Exposing),
        (state.last_exposed, Seen::LastExposed),
        (state.cut_short.map(|(id, _)| id), Seen::CutShort),
    ];
    shown.into_iter().filter_map(|(id, seen)| Some((lit(id?), seen))).chain(slots).collect()
}

impl Printer {
    /// The signs that the operator must still confirm before this job, which has had no light, may move the plate down. `state` is
    /// the device's latest in this session.
    pub(crate) fn unknown_signs(&self, job: &Job, state: Option<&DeviceState>) -> Vec<Sign> {
        let mut signs: Vec<_> = self.jobs.left().map(|(job, key)| Sign::Left { job, key }).into_iter().collect();
        if let Some(state) = state {
            let unaccounted = |(trace, seen): (Trace, Seen)| match self.jobs.account(trace, job.directory.id) {
                Account::Known => None,
                Account::NotOf(job) => Some(Sign::Exposure { trace, seen, job: Some(job) }),
                Account::Foreign => Some(Sign::Exposure { trace, seen, job: None }),
            };
            signs.extend(traces(state).into_iter().filter_map(unaccounted));
            signs.extend(self.low_plate(state));
        }
        signs.extend(self.raised.height_um().map(|from_um| Sign::Raised { from_um }));
        signs.retain(|sign| !sign.is_known(&job.cleared, state));
        signs
    }

    pub(crate) fn low_plate(&self, state: &DeviceState) -> Option<Sign> {
        let position_um = state.position_um?;
        let clear_um = self.clear_um();
        let is_own = self.jobs.bare_on() == Some(state.boot_id);
        (position_um < clear_um - CLEAR_TOLERANCE_UM && !is_own).then_some(Sign::Low {
            position_um,
            clear_um,
            boot_id: state.boot_id,
        })
    }

    /// The height at which the plate is clear of the resin, or the device's highest if that is lower, micrometres.
    pub(crate) fn clear_um(&self) -> i32 {
        // `as` saturates; the configuration allows two metres.
        let Machine::Dlp(machine) = &self.setting.machine;
        let clear_um = machine.clear_height_um.ceil() as i32;
        self.capabilities.as_ref().map_or(clear_um, |capabilities| clear_um.min(capabilities.max_position_um))
    }

    /// Updates what each queued job waits for; returns the jobs where that changed.
    pub(crate) fn explain_queue(&mut self) -> Vec<u32> {
        // While a job runs, it is unknown what the next one will find.
        let next = self.jobs.next().filter(|job| job.needs_bare_plate() && self.holder().is_none());
        let told = next.map(|job| (job.directory.id, self.unknown_signs(job, self.device_state.as_ref())));
        if let Some((id, signs)) = told
            && let Some(job) = self.jobs.get_mut(id)
        {
            job.tell(signs);
        }
        let misfit = self.jobs.next().and_then(|job| self.awaits_other_device(job));
        let light = self.unwanted_light();
        self.jobs.explain(self.holder(), light, misfit.as_deref())
    }

    /// Takes the operator's confirmation for a queued job that the plate is empty. Refused until the job is next: before that the
    /// operator cannot have looked at the plate that the job will find.
    pub(crate) fn plate_is_clear(&mut self, id: u32) -> Result<Step, CommandError> {
        if let Some(ahead) = self.jobs.ahead_of(id, self.holder()) {
            let text = format!("job {id} {ahead}; what is on the plate then is not known yet");
            return Err(CommandError::new(409, text));
        }
        if let Some(misfit) = self.jobs.get(id).and_then(|job| self.misfit_of(job)) {
            let text =
                format!("job {id} waits for a device that fits, and the plate is not taken to be empty yet: {misfit}");
            return Err(CommandError::new(409, text));
        }
        let job = self.waiting(id)?;
        job.awaits_plate = false;
        job.clear_told();
        self.set_raised(None);
        self.publish_job(id);
        Ok(Step::Done(id))
    }

    /// Whether the running job may use a new session. A job that has not begun waits in the queue for a device that fits. A job
    /// that has had no light may move the plate down only if no sign of an earlier part is left unconfirmed on this device.
    pub(crate) fn plate_allows(&mut self, state: &DeviceState, now_us: u64) -> bool {
        let unbegun = self.running.as_ref().filter(|running| !running.engine.has_begun()).map(|running| running.job);
        if let Some(misfit) = unbegun.and_then(|id| self.jobs.get(id)).and_then(|job| self.awaits_other_device(job))
            && let Some(id) = unbegun
        {
            tracing::warn!("job {id} waits for a device that fits: {misfit}");
            self.put_back(id);
            return false;
        }
        let Some(running) = self.running.as_ref().filter(|running| running.engine.goes_down_bare()) else {
            return true;
        };
        let id = running.job;
        let Some(job) = self.jobs.get(id) else { return true };
        let signs = self.unknown_signs(job, Some(state));
        if signs.is_empty() {
            self.note_clear_plate(id, state, now_us);
            return true;
        }
        tracing::warn!(job = id, "{}", text(&signs, id));
        if let Some(job) = self.jobs.get_mut(id) {
            job.tell(signs.clone());
        }
        match &mut self.running {
            Some(running) if running.engine.has_begun() => {
                running.engine.handle(Event::PlateUnclear(text(&signs, id)), now_us);
            }
            _ => self.put_back(id),
        }
        false
    }

    /// Records in the journal, before the first move, that the plate was bare, and the exposures that the operator has confirmed.
    fn note_clear_plate(&mut self, id: u32, state: &DeviceState, now_us: u64) {
        // Accounted for only by the operator's confirmation.
        let is_told = |trace: &Trace| self.jobs.account(*trace, id) != Account::Known;
        let mut traces: Vec<_> = traces(state).into_iter().map(|(trace, _)| trace).filter(is_told).collect();
        traces.dedup();
        let Some(job) = self.jobs.get_mut(id) else { return };
        if job.past.plate_clear_on == Some(state.boot_id) && traces.is_empty() {
            return;
        }
        job.past.plate_clear_on = Some(state.boot_id);
        job.past.traces.extend(&traces);
        let boot_id = state.boot_id;
        self.with_engine(|running| running.engine.handle(Event::PlateClear { boot_id, traces }, now_us));
    }

    /// Takes the machine from a job that has not begun; it waits in the queue for the operator's confirmation.
    fn put_back(&mut self, id: u32) {
        let Some(running) = self.running.take() else { return };
        self.forget_progress();
        if let Some(TakeUp::Print(choice)) = self.jobs.get(id).map(|job| job.take_up) {
            self.jobs.take_up(id, TakeUp::Print(choice));
        }
        self.idle = Idle::after(running.engine.light().clone());
        self.releasing = true;
        let background = self.background.clone();
        tokio::spawn(async move {
            running.release().await;
            let _ = background.send(Background::Released { forgotten: Ok(Vec::new()) }).await;
        });
        self.publish_job(id);
    }
}

impl Job {
    /// Whether it is to get the machine to print, not to end.
    pub(crate) fn is_to_print(&self) -> bool {
        matches!(self.take_up, TakeUp::Print(_))
    }

    /// Whether the plate must be bare when it begins: it is to print, and has had no light.
    pub(crate) fn needs_bare_plate(&self) -> bool {
        self.is_to_print() && !self.past.touched && !self.past.unknown
    }

    /// Sets the signs that the operator is told of. An earlier sign stays until it is confirmed, even if the device no longer
    /// shows it: raising the plate or losing the position does not empty the vat.
    fn tell(&mut self, signs: Vec<Sign>) {
        let told = std::mem::replace(&mut self.told, signs);
        for sign in told {
            let is_told = self.told.iter().any(|new| match (new, &sign) {
                (Sign::Low { .. }, Sign::Low { .. }) => true,
                (new, sign) => new == sign,
            });
            if !is_told && self.told.len() < MAX_SIGNS {
                self.told.push(sign);
            }
        }
    }

    /// Marks every sign told so far as confirmed.
    pub(crate) fn clear_told(&mut self) {
        let told = std::mem::take(&mut self.told);
        self.cleared.extend(told);
    }
}
