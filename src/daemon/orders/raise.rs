//! `layerctl raise`: lifts the plate clear of the resin while no job runs. The plate only moves up. `tests/plate.rs` tests it.

use crate::api::RaiseView;
use crate::config::{Kind, Recipe};
use crate::daemon::error::OrderError;
use crate::daemon::handle::{Answer, Reply};
use crate::daemon::jobs::sign::CLEAR_TOLERANCE_UM;
use crate::daemon::jobs::unwritten::MAX_WRITE_US;
use crate::daemon::machine::raise::{Raise, Stage, raised_from};
use crate::daemon::printer::Printer;
use crate::deadline::Deadline;
use crate::device::{Act, Outcome, VatAct, VatOutcome, check_capabilities, host_us, least_move_us};
use crate::job::ACT_MARGIN_US;
use crate::text::mm_text;

impl Printer {
    /// Lifts the plate clear. The note for the next process comes first: a raised plate no longer shows that a part may hang on
    /// it. The order is answered when the move begins; a notice reports its end.
    pub(crate) fn raise(&mut self, reply: Reply) {
        if let Some(Raise { stage: Stage::Noting(replies), .. }) = &mut self.idle.raise {
            return replies.push(reply);
        }
        let view = match self.may_raise() {
            Ok(view) if view.to_um != view.from_um && self.idle.raise.is_none() => view,
            answer => {
                // The client may be gone.
                let _ = reply.send(answer.map(Answer::Raise));
                return;
            }
        };
        if self.device_state.as_ref().is_some_and(|state| self.low_plate(state).is_some()) {
            self.set_raised(Some(view.from_um));
        }
        let deadline = Deadline::at(self.clock.now_us() + MAX_WRITE_US);
        self.idle.raise = Some(Raise { view, stage: Stage::Noting(vec![reply]), deadline });
        if self.raised.is_written() {
            self.begin_raise(None);
        }
    }

    /// From where to where the plate would be raised now, or why it must not be.
    fn may_raise(&self) -> Result<RaiseView, OrderError> {
        if self.shutting_down {
            return Err(OrderError::new(503, "the daemon is shutting down and begins nothing new"));
        }
        if self.setting.machine.kind() == Kind::Slm {
            return Err(OrderError::new(409, NO_VAT));
        }
        if let Some(job) = self.holder() {
            let text = format!(
                "job {job} has the machine: `layerctl pause` or `layerctl stop` lifts its plate clear of the resin"
            );
            return Err(OrderError::new(409, text));
        }
        if let Some(Raise { view, stage: Stage::Moving { .. }, .. }) = &self.idle.raise {
            return Ok(view.clone());
        }
        let (Some(capabilities), Some(state)) = (&self.capabilities, &self.device_state) else { return Err(absent()) };
        check_capabilities(&self.setting.machine, capabilities)
            .map_err(|error| OrderError::new(409, error.to_string()))?;
        let from_um = raised_from(state).map_err(|text| OrderError::new(409, text))?;
        Ok(RaiseView { from_um, to_um: self.clear_um().max(from_um), warning: None })
    }

    /// The note is on disk, or could not be written: the move begins in any case, as a part in the resin gets worse.
    fn raise_noted(&mut self, failed: Option<String>) {
        match failed {
            None if self.raised.is_written() => self.begin_raise(None),
            None => {}
            Some(text) => self.begin_raise(Some(format!("the spool cannot record it ({text})"))),
        }
    }

    /// Begins the move, if one waits for its note, and answers those who ordered it. `unwritten` says why the note is not on disk.
    fn begin_raise(&mut self, unwritten: Option<String>) {
        let Some(Raise { stage: Stage::Noting(replies), .. }) =
            self.idle.raise.take_if(|raise| matches!(raise.stage, Stage::Noting(_)))
        else {
            return;
        };
        let warning = unwritten.map(|why| {
            format!(
                "the plate is raised, but {why}: layerd tries again; after a crash or a restart before that, look at the plate \
                 before the next job"
            )
        });
        // The device's state may have changed while the note was written.
        let begun = self.may_raise().and_then(|view| self.command_raise(RaiseView { warning, ..view }));
        if let Ok(RaiseView { warning: Some(warning), .. }) = &begun {
            self.notice(warning.clone());
        }
        for reply in replies {
            let _ = reply.send(begun.clone().map(Answer::Raise));
        }
    }

    fn command_raise(&mut self, view: RaiseView) -> Result<RaiseView, OrderError> {
        let RaiseView { from_um, to_um, .. } = view;
        let speed_um_s = match &self.setting.recipe {
            Recipe::Dlp(recipe) => recipe.lift_speed_um_s,
            Recipe::Slm(_) => return Err(OrderError::new(409, NO_VAT)),
        };
        let now_us = self.clock.now_us();
        let driver = self.idle.driver.as_mut().ok_or_else(absent)?;
        let act = Act::Vat(VatAct::Move { position_um: to_um, speed_um_s });
        driver.act(act, now_us).map_err(|error| OrderError::new(409, error.to_string()))?;
        let travel_us = u64::from(to_um.abs_diff(from_um)) * 1_000_000 / u64::from(speed_um_s.max(1));
        let deadline = Deadline::at(now_us + travel_us + ACT_MARGIN_US);
        // The move may end this much short of its target.
        let least_um = to_um.abs_diff(from_um).saturating_sub(CLEAR_TOLERANCE_UM as u32);
        let least_us = host_us(least_move_us(least_um, speed_um_s), self.setting.machine.time_scale());
        self.idle.raise =
            Some(Raise { view: view.clone(), stage: Stage::Moving { least_us, sent_us: None }, deadline });
        tracing::info!(from_um, to_um, "the plate is raised");
        Ok(view)
    }

    /// Takes back a move that has not begun.
    pub(crate) fn take_back_raise(&mut self, why: &str) {
        if let Some(Raise { stage: Stage::Noting(replies), .. }) =
            self.idle.raise.take_if(|raise| matches!(raise.stage, Stage::Noting(_)))
        {
            for reply in replies {
                let _ = reply.send(Err(OrderError::new(409, format!("the plate was not raised: {why}"))));
            }
        }
    }

    /// Reports the end of the move.
    pub(crate) fn raise_ended(&mut self, outcome: Outcome) {
        let Some(raise) = self.idle.raise.take() else { return };
        let to_um = raise.view.to_um;
        let too_soon_us = raise.too_soon_us(self.clock.now_us());
        let text = match outcome {
            Outcome::Vat(VatOutcome::Arrived { position_um }) => {
                if let Some(state) = &mut self.device_state {
                    state.position_um = Some(position_um);
                }
                if position_um.abs_diff(to_um) > CLEAR_TOLERANCE_UM as u32 {
                    format!(
                        "the plate was to be raised to {}, and the device says it is at {}: check the axis",
                        mm_text(to_um),
                        mm_text(position_um)
                    )
                } else if let Some(took_us) = too_soon_us {
                    format!(
                        "the device says that its plate was raised to {} {} ms after the order, which is too soon: look whether \
                         the plate is clear of the resin, and check the axis and the device",
                        mm_text(to_um),
                        took_us / 1000
                    )
                } else {
                    return self.tell(format!("the plate is raised: it is at {}", mm_text(position_um)));
                }
            }
            Outcome::Refused(refusal) => {
                format!("the plate was not raised: the device refused, or stopped the move ({refusal:?})")
            }
            Outcome::Vat(VatOutcome::Exposed { .. } | VatOutcome::Changed { .. })
            | Outcome::Powder(_)
            | Outcome::TakenBack => {
                "the plate was not raised: the device answered something else; check its firmware".into()
            }
        };
        self.notice(text);
    }

    /// The order to move was handed to the line.
    pub(crate) fn raise_sent(&mut self, now_us: u64) {
        if let Some(raise) = &mut self.idle.raise {
            raise.sent(now_us);
        }
    }

    /// Gives the move up: its end will not be reported.
    pub(crate) fn raise_lost(&mut self, why: &str) {
        self.take_back_raise(why);
        if self.idle.raise.take().is_some() {
            self.notice(format!(
                "it is unknown whether the plate was raised: {why}; `layerctl device` shows where it is"
            ));
        }
    }

    /// Remembers, here and in the spool, from where the plate was raised; `None` once it is known to be empty.
    pub(crate) fn set_raised(&mut self, from_um: Option<i32>) {
        if self.raised.set(from_um) {
            self.raised.write(&self.spool, &self.background);
        }
    }

    /// Tries again to write a note that could not be written.
    pub(crate) fn retry_raised(&mut self) {
        if self.raised.is_due(self.clock.now_us()) {
            self.raised.write(&self.spool, &self.background);
        }
    }

    /// A write of the note has ended. Tells the operator if the spool could not take it.
    pub(crate) fn raised_noted(&mut self, from_um: Option<i32>, result: Result<(), String>) {
        if !self.raised.ended(from_um, result.is_ok(), self.clock.now_us()) {
            // It changed meanwhile.
            return self.raised.write(&self.spool, &self.background);
        }
        if let Err(text) = &result
            && self.raised.must_tell()
        {
            self.notice(format!(
                "the spool cannot record whether the plate was raised with a part on it: {text}. layerd tries again; after a \
                 restart of layerd, look at the plate before the next job"
            ));
        }
        self.raise_noted(result.err());
    }

    /// Checks whether the note or the move is overdue.
    pub(crate) fn raise_timeout(&mut self, now_us: u64) {
        let Some(raise) = &mut self.idle.raise else { return };
        if !raise.deadline.is_over(now_us) {
            return;
        }
        match raise.stage {
            Stage::Noting(_) => self.begin_raise(Some("the disk has not taken the note of it yet".into())),
            Stage::Moving { .. } => {
                self.raise_lost("it did not arrive in time; check the axis and the device");
                // The device takes no other act before it has answered this one. A new session clears that.
                self.link.reconnect();
            }
        }
    }
}

const NO_VAT: &str = "only the plate of a resin printer is raised: a part in a bed of powder is safe where it is";

fn absent() -> OrderError {
    OrderError::new(409, "the device does not answer, so nothing can be moved: `layerctl status` tells why")
}
