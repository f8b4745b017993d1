//! `layerctl raise`: lifts the plate clear of the resin while no job runs. The plate only moves up.

use std::sync::{Arc, PoisonError};

use super::api::RaiseView;
use super::background::Background;
use super::handle::{Answer, CommandError};
use super::plate::CLEAR_TOLERANCE_UM;
use super::printer::Printer;
use crate::deadline::Deadline;
use crate::device::{Act, Outcome, check_capabilities};
use crate::job::{ACT_MARGIN_US, Spool};
use crate::link::message::DeviceState;

/// A move of the plate that is under way.
#[derive(Debug)]
pub(super) struct Raise {
    view: RaiseView,
    /// The device must have answered by then.
    pub deadline: Deadline,
}

impl Printer {
    /// Begins to lift the plate clear. A notice reports the end.
    pub(super) fn raise(&mut self) -> Result<Answer, CommandError> {
        if self.shutting_down {
            return Err(CommandError::new(503, "the daemon is shutting down and begins nothing new"));
        }
        if let Some(job) = self.holder() {
            let text = format!(
                "job {job} has the machine: `layerctl pause` or `layerctl stop` lifts its plate clear of the resin"
            );
            return Err(CommandError::new(409, text));
        }
        if let Some(raise) = &self.idle.raise {
            return Ok(Answer::Raise(raise.view));
        }
        let absent = || {
            CommandError::new(409, "the device does not answer, so nothing can be moved: `layerctl status` tells why")
        };
        let (Some(capabilities), Some(state)) = (&self.capabilities, &self.device_state) else { return Err(absent()) };
        check_capabilities(&self.setting.machine, capabilities)
            .map_err(|error| CommandError::new(409, error.to_string()))?;
        let from_um = raised_from(state).map_err(|text| CommandError::new(409, text))?;
        let speed_um_s = self.setting.recipe.lift_speed_um_s;
        let view = RaiseView { from_um, to_um: self.clear_um().max(from_um) };
        if view.to_um == from_um {
            return Ok(Answer::Raise(view));
        }
        let raised = self.low_plate(state).map(|_| from_um);
        let now_us = self.clock.now_us();
        let driver = self.idle.driver.as_mut().ok_or_else(absent)?;
        let act = Act::Move { position_um: view.to_um, speed_um_s };
        driver.act(act, now_us).map_err(|error| CommandError::new(409, error.to_string()))?;
        // A raised plate no longer shows that a part may hang on it, so the height is remembered.
        self.set_raised(raised.or(self.raised_from_um));
        let travel_us = u64::from(view.to_um.abs_diff(from_um)) * 1_000_000 / u64::from(speed_um_s.max(1));
        self.idle.raise = Some(Raise { view, deadline: Deadline::at(now_us + travel_us + ACT_MARGIN_US) });
        tracing::info!(from_um, to_um = view.to_um, "the plate is raised");
        Ok(Answer::Raise(view))
    }

    /// Remembers, here and in the spool, from where the plate was raised; `None` once it is confirmed to be empty.
    pub(super) fn set_raised(&mut self, from_um: Option<i32>) {
        if std::mem::replace(&mut self.raised_from_um, from_um) == from_um {
            return;
        }
        *self.raised_note.lock().unwrap_or_else(PoisonError::into_inner) = from_um;
        let (spool, note, background) =
            (Arc::clone(&self.spool), Arc::clone(&self.raised_note), self.background.clone());
        tokio::task::spawn_blocking(move || {
            let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
            let from_um = *note.lock().unwrap_or_else(PoisonError::into_inner);
            let result = spool.set_raised(from_um).map_err(|error| error.to_string());
            let _ = background.blocking_send(Background::RaisedNoted(result));
        });
    }

    /// Tells the operator if the spool could not take the note.
    pub(super) fn raised_noted(&self, result: Result<(), String>) {
        if let Err(text) = result {
            self.notice(format!(
                "the spool cannot record whether the plate was raised with a part on it: {text}. After a restart of layerd, look \
                 at the plate before the next job"
            ));
        }
    }

    /// Reports the end of the move.
    pub(super) fn raise_ended(&mut self, outcome: Outcome) {
        let Some(raise) = self.idle.raise.take() else { return };
        let to_um = raise.view.to_um;
        let text = match outcome {
            Outcome::Arrived { position_um } => {
                if let Some(state) = &mut self.device_state {
                    state.position_um = Some(position_um);
                }
                if position_um.abs_diff(to_um) > CLEAR_TOLERANCE_UM as u32 {
                    format!(
                        "the plate was to be raised to {to_um} µm, and the device says it is at {position_um} µm: check \
                         the axis"
                    )
                } else {
                    return self.tell(format!("the plate is raised: it is at {position_um} µm"));
                }
            }
            Outcome::Refused(refusal) => {
                format!("the plate was not raised: the device refused, or stopped the move ({refusal:?})")
            }
            Outcome::Exposed { .. } | Outcome::TakenBack => {
                "the plate was not raised: the device answered something else; check its firmware".into()
            }
        };
        self.notice(text);
    }

    /// Gives the move up: its end will not be reported.
    pub(super) fn raise_lost(&mut self, why: &str) {
        if self.idle.raise.take().is_some() {
            self.notice(format!(
                "it is unknown whether the plate was raised: {why}; `layerctl device` shows where it is"
            ));
        }
    }

    /// Checks whether the move is overdue.
    pub(super) fn raise_timeout(&mut self, now_us: u64) {
        if self.idle.raise.as_mut().is_some_and(|raise| raise.deadline.is_over(now_us)) {
            self.raise_lost("it did not arrive in time; check the axis and the device");
            // The device takes no other act before it has answered this one. A new session clears that.
            self.link.reconnect();
        }
    }
}

/// The note of an earlier process. If it cannot be read, the plate counts as raised: the operator must look.
pub(super) fn noted(spool: &Spool) -> Option<i32> {
    spool.raised_from_um().unwrap_or_else(|error| {
        tracing::warn!("{error}; the plate is assumed to have been raised with a part on it");
        Some(0)
    })
}

/// The plate's present height, micrometres, or why it must not move.
fn raised_from(state: &DeviceState) -> Result<i32, String> {
    if let Some(fault) = &state.fault {
        return Err(format!("the device has a fault and moves nothing: {}", fault.text));
    }
    if state.light_on || state.exposing.is_some() {
        return Err("there is light, and the plate must not move: `layerctl abort` puts it off".into());
    }
    if state.moving {
        return Err("the plate moves already: try again once it rests".into());
    }
    state.position_um.ok_or_else(|| {
        "the device does not know where its plate is, and only homing would tell it, which goes down. Raise the plate by \
         hand or at the machine"
            .into()
    })
}
