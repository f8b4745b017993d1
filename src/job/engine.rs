//! The life of one job as a pure state machine: no I/O, no clock. Events and the time go in, actions come out.
//!
//! ```text
//!             Ready + Connected
//!  Checking ───────────────────▶ take stock of the device ◀────────── Connected ── Lost ◀── LineLost, from anywhere
//!                                 │ position unknown, plate bare: Home            (bounded; else interrupted)
//!                                 ▼
//!        ┌──────────────────▶ advance ── pause, stop, shutdown, failure, last layer ──▶ Parking ──▶ Resting | Ending
//!        │                        │                                                    (plate clear)
//!        │    layer exposed last: Lifting ──▶ Dripping (wait_after_lift) ──▶ advance
//!        │                        │
//!        │                   Approaching (retract to the layer's height)
//!        │                        ▼
//!        │                    Settling (light_off_delay + wait_before_exposure)
//!        │                        ▼
//!        │                    Waiting, dark, while the layer is late
//!        │                        ▼
//!        │      Commanding: journal Commanded ──▶ Exposing ──▶ Confirming: journal Confirmed
//!        │                                                          ▼
//!        └───────────────────────────────────────────────────── Curing (wait_after_exposure)
//!
//!  Light that was not commanded, or lasts too long: Urgent(LightOff) ──▶ Darkening ──▶ take stock ──▶ Parking ──▶ Ending
//!
//!  Abort, from anywhere: Urgent(Abort) ──▶ AbortSent ──▶ AbortReconnect ──▶ Parking ──▶ Ending
//!  (as long as there is light: Urgent(LightOff) as well, and Urgent(Abort) again in a new session each half second)
//! ```
//!
//! How to drive it: after every [`Engine::handle`], call [`Engine::next_action`] until it returns `None`, and carry out each
//! action (uploads and acts in the background). At [`Engine::next_timeout_us`], call [`Engine::handle`] with
//! [`Event::Timeout`]. Times are microseconds of a monotonic clock.
//!
//! Invariants, whatever the order of events:
//! - A layer is exposed only after its `Commanded` record is on disk.
//! - One act runs at a time, and it waits for the records before it. One exception: if the disk is slow, the lift that clears
//!   the plate does not wait.
//! - Light that was not commanded, or that lasts too long, is switched off at once. Nothing else is commanded until the device
//!   reports dark.
//! - The print stops if a reported light time or position differs from the commanded one.
//! - A layer counts as exposed only if the device or the operator says so.
//! - The engine never homes with a part on the plate: homing drives the plate to the bottom of the vat.
//! - Every wait is limited in time, except a pause.

mod cycle;
mod disk;
mod ending;
mod light;
mod outbox;
mod pace;
mod phase;
mod recovery;
mod report;
mod track;
mod uploads;

use disk::DiskWatch;
use outbox::Outbox;
use pace::Pace;
use phase::{Intent, Phase};
use track::{AbortOrder, ActWatch, Failures};
use uploads::Uploads;

use super::{Action, Command, EndOrder, Event, JobPlan, JobState, Record, ResumeChoice, StartPoint, Unconfirmed};
use crate::deadline::Deadline;
use crate::device::{Act, LightWatch, least_move_us};
use crate::link::message::{DeviceState, Refusal};

const SECOND_US: u64 = 1_000_000;

/// Longest wait for a new session. A replugged cable or a restarted device takes seconds; a minute lets the operator walk to
/// the machine. A part should not stay in the resin for longer.
const RECONNECT_US: u64 = 60 * SECOND_US;
/// Allowance beyond an act's computed time: acceleration ramps, a busy line, one recovery of the link (at most 5 s).
pub const ACT_MARGIN_US: u64 = 15 * SECOND_US;
/// Longest wait for a layer. One that takes ten minutes to compute will not come.
const LATE_LIMIT_US: u64 = 600 * SECOND_US;
/// Protocol errors in a row, without a layer printed in between, that end the job.
const MAX_MISBEHAVIOURS: u32 = 3;
/// Printed layers that make up for one protocol error. Each error costs a session and some seconds, during which a layer stays
/// in the resin longer than the others. One error an hour is acceptable; one per layer makes bad parts.
const LAYERS_PER_MISBEHAVIOUR: u32 = 50;
/// Protocol errors, not yet made up for, that are tolerated. A few in a row are chance; more show a faulty device.
const MAX_MISBEHAVIOURS_OPEN: u32 = 8;

/// The engine of one job.
#[derive(Debug)]
pub struct Engine {
    plan: JobPlan,
    phase: Phase,
    intent: Intent,
    out: Outbox,
    uploads: Uploads,
    /// End of the phase's wait.
    deadline: Option<Deadline>,
    ready: bool,
    line_up: bool,
    ever_connected: bool,
    /// The last state that the device reported.
    device: DeviceState,
    max_position_um: i32,
    position_um: Option<i32>,
    /// Target of the move under way.
    target_um: i32,
    light: LightWatch,
    next_layer: u32,
    unconfirmed: Option<Unconfirmed>,
    /// Set if it is unknown how much light the next layer had; says what is known.
    in_doubt: Option<String>,
    /// The device refused the commanded exposure. Its state must tell whether there was light all the same.
    refused: Option<Refusal>,
    /// A state named the layer as exposed sooner than it can be; describes it.
    ended_early: Option<String>,
    choice: ResumeChoice,
    /// The job may have had light, so a part may hang on the plate. Homing would crush it.
    touched: bool,
    /// Whether the device ever confirmed a layer of this job.
    confirmed: bool,
    /// The plate is parked clear of the resin.
    lifted: bool,
    /// The layer exposed last still sticks to the vat's film.
    stuck: bool,
    /// The first layer of this run has arrived: from now on a missing layer is late.
    warm: bool,
    /// A fault forbids moving.
    immobile: bool,
    aborting: bool,
    /// The operator ordered the end of the job, so it cannot be resumed.
    ordered: bool,
    light_known_off: bool,
    act: ActWatch,
    abort_order: AbortOrder,
    failures: Failures,
    commands_of_layer: u32,
    /// What keeps data from getting through, as reported by the line.
    hindrance: Option<String>,
    /// The highest layer of this job that the device reported as exposed last.
    told_exposed: Option<u32>,
    /// Set once the device reports a lower layer after that; describes it.
    went_back: Option<String>,
    loss: String,
    pace: Pace,
    disk: DiskWatch,
    /// Light time that the device reported for the layer confirmed last, milliseconds.
    light_ms: Option<u32>,
}

impl Engine {
    /// An engine that waits for [`Event::Ready`] and [`Event::Connected`]. `start` comes from
    /// [`super::History::start`], or is the default for a new job.
    pub fn new(plan: JobPlan, start: StartPoint) -> Self {
        Self {
            plan,
            phase: Phase::Checking,
            intent: Intent::Print,
            out: Outbox::default(),
            uploads: Uploads::default(),
            deadline: None,
            ready: false,
            line_up: false,
            ever_connected: false,
            device: DeviceState::default(),
            max_position_um: 0,
            position_um: None,
            target_um: 0,
            light: LightWatch::default(),
            next_layer: start.next_layer,
            unconfirmed: start.unconfirmed,
            in_doubt: start.in_doubt.then(|| "it was not settled before".into()),
            refused: None,
            ended_early: None,
            choice: start.choice,
            touched: start.touched,
            confirmed: start.confirmed,
            lifted: false,
            stuck: start.touched,
            warm: false,
            immobile: false,
            aborting: false,
            ordered: false,
            light_known_off: false,
            act: ActWatch::default(),
            abort_order: AbortOrder::default(),
            failures: Failures::default(),
            commands_of_layer: 0,
            hindrance: None,
            told_exposed: None,
            went_back: None,
            loss: String::new(),
            pace: Pace::default(),
            disk: DiskWatch::default(),
            light_ms: None,
        }
    }

    /// Takes over the light watch that observed the device before this job.
    #[must_use]
    pub fn watching(mut self, light: LightWatch) -> Self {
        self.light = light;
        self
    }

    /// The light watch, to be continued after this job.
    pub fn light(&self) -> &LightWatch {
        &self.light
    }

    /// Notes what keeps data from getting through on the line. It is named in the message about an overdue answer.
    pub fn hindered(&mut self, by: Option<String>) {
        self.hindrance = by;
    }

    /// Handles an event. Events that mean nothing in the present state are ignored.
    pub fn handle(&mut self, event: Event, now_us: u64) {
        match &event {
            Event::Journalled | Event::JournalFailed(_) => self.disk.answered(),
            Event::Timeout => self.look_at_disk(now_us),
            _ => {}
        }
        match event {
            Event::Command(Command::Abort) => self.abort(now_us),
            Event::Journalled => {
                if self.out.journalled() {
                    self.on_journal_idle(now_us);
                }
            }
            Event::JournalFailed(text) => self.on_journal_failed(&text, now_us),
            _ if self.phase == Phase::Ending || self.phase == Phase::Done => {}
            _ if matches!(self.phase, Phase::AbortSent | Phase::AbortReconnect) => self.while_aborting(event, now_us),
            Event::Ready => self.on_ready(now_us),
            Event::Unfit(text) => self.on_unfit(text, now_us),
            Event::Connected { state, max_position_um } => self.on_connected(state, max_position_um, now_us),
            Event::LineLost(reason) => self.on_line_lost(reason, now_us),
            Event::Misbehaved(text) => self.on_misbehaved(&text, now_us),
            Event::State(state) => self.on_state(state, now_us),
            Event::ActTaken { number } => self.on_act_taken(number, now_us),
            Event::Uploaded { layer } => self.on_uploaded(layer, now_us),
            Event::UploadRefused { layer, refusal } => {
                if let Err(text) = self.uploads.refused(layer, refusal) {
                    self.wind_down(self.failed_or_interrupted(), text, now_us);
                }
            }
            Event::LayerFailed { layer, text } => {
                self.uploads.cancel();
                let text = format!("layer {layer} cannot be computed: {text}");
                self.wind_down(self.failed_or_interrupted(), text, now_us);
            }
            Event::ActDone { number, outcome } => {
                if self.act.running == Some(number) {
                    self.act.running = None;
                    self.on_act_done(outcome, now_us);
                }
            }
            // The device's state tells whether it is dark. It is polled where that matters.
            Event::UrgentDone(_) | Event::UrgentFailed(_) => self.light.put_off_answered(),
            Event::PlateClear { boot_id, traces } => self.out.journal(Record::PlateClear { boot_id, traces }),
            Event::PlateUnclear(text) => self.end_unparked(text),
            Event::Fault(fault) => self.on_fault(fault.as_ref(), now_us),
            Event::Command(command) => self.command(command, now_us),
            Event::Shutdown => self.shutdown(now_us),
            Event::Timeout => {
                if self.deadline.as_mut().is_some_and(|deadline| deadline.is_over(now_us)) {
                    self.deadline = None;
                    self.on_timeout(now_us);
                }
            }
        }
        self.lift_without_disk(now_us);
        self.pump_uploads();
    }

    /// The next thing to do; `None` until another event comes in.
    pub fn next_action(&mut self) -> Option<Action> {
        self.out.next()
    }

    /// When [`Event::Timeout`] is due.
    pub fn next_timeout_us(&self) -> Option<u64> {
        self.deadline.map(Deadline::at_us).into_iter().chain(self.disk.due_us()).min()
    }

    fn on_ready(&mut self, now_us: u64) {
        self.ready = true;
        if self.phase != Phase::Checking {
            return;
        }
        if self.line_up {
            self.begin(now_us);
        } else {
            self.deadline = Some(Deadline::at(now_us + RECONNECT_US));
        }
    }

    fn command(&mut self, command: Command, now_us: u64) {
        self.ordered |= command == Command::Stop;
        match (command, &self.intent) {
            (Command::Pause, Intent::Print) => self.intent = Intent::Pause,
            (Command::Resume, Intent::Pause) => {
                self.intent = Intent::Print;
                if self.phase == Phase::Resting {
                    self.out.journal(Record::Resumed);
                    self.advance(now_us);
                }
                return;
            }
            (Command::Stop, Intent::Print | Intent::Pause) => {
                self.out.journal(Record::Ordered(EndOrder::Stop));
                return self.wind_down(JobState::Stopped, "stopped by the operator".into(), now_us);
            }
            (Command::Stop, Intent::End(JobState::Interrupted, reason)) => {
                self.out.journal(Record::Ordered(EndOrder::Stop));
                self.intent = Intent::End(JobState::Stopped, format!("stopped by the operator; {reason}"));
                return;
            }
            _ => return self.out.notice(format!("nothing to do: the job is {}", self.state())),
        }
        self.reconsider(false, now_us);
    }

    fn on_timeout(&mut self, now_us: u64) {
        match self.phase {
            Phase::Settling => self.want_layer(now_us),
            Phase::Curing | Phase::Dripping => self.advance(now_us),
            Phase::WarmingUp | Phase::Waiting { .. } => {
                let text = format!(
                    "layer {} did not come within {} s: run `layerctl check` on the part, then resume",
                    self.next_layer,
                    LATE_LIMIT_US / SECOND_US
                );
                self.wind_down(JobState::Interrupted, text, now_us);
            }
            Phase::Asking { until_us } => self.ask_again(until_us, now_us),
            Phase::Darkening { until_us } => self.ask_for_dark(until_us, now_us),
            Phase::Exposing { .. } => self.on_overdue_light(now_us),
            Phase::CuttingShort => {
                let text = self.with_cause("the device did not say how the exposure ended");
                self.end_session(&text, now_us);
            }
            Phase::Homing | Phase::Lifting | Phase::Approaching | Phase::Parking if self.out.act.is_some() => {
                // It waits for the disk, not for the device.
                self.deadline = Some(Deadline::at(now_us + ACT_MARGIN_US));
            }
            Phase::Homing | Phase::Lifting | Phase::Approaching | Phase::Parking => self.on_overdue_move(now_us),
            Phase::Checking | Phase::Lost => self.on_no_device(),
            _ => {}
        }
    }

    fn start_move(&mut self, position_um: i32, speed_um_s: u32, phase: Phase, now_us: u64) {
        let from_um = self.position_um.unwrap_or(0);
        self.target_um = position_um;
        let distance_um = position_um.abs_diff(from_um);
        let travel_us = u64::from(distance_um) * SECOND_US / u64::from(speed_um_s.max(1));
        self.start_act(Act::Move { position_um, speed_um_s }, phase, now_us + travel_us + ACT_MARGIN_US, now_us);
        // The move may end this much short of its target.
        let least_um = distance_um.saturating_sub(self.plan.position_tolerance_um());
        self.act.least_us = self.plan.host_us(least_move_us(least_um, speed_um_s));
    }

    fn start_act(&mut self, act: Act, phase: Phase, deadline_us: u64, now_us: u64) {
        self.lifted = false;
        self.act.number += 1;
        self.act.running = Some(self.act.number);
        self.act.sent_us = Some(now_us);
        (self.act.began_us, self.act.least_us) = (now_us, 0);
        self.out.act = Some((self.act.number, act));
        self.wait_until(phase, deadline_us);
    }

    fn wait_until(&mut self, phase: Phase, deadline_us: u64) {
        self.phase = phase;
        self.deadline = Some(Deadline::at(deadline_us));
    }

    fn pump_uploads(&mut self) {
        use Phase::{AbortReconnect, AbortSent, Asking, Checking, Darkening, Done, Ending, Lost};
        let idle = matches!(
            self.phase,
            Checking | Lost | Asking { .. } | Darkening { .. } | AbortSent | AbortReconnect | Ending | Done
        );
        if idle || !self.line_up || matches!(self.intent, Intent::End(..)) || self.out.upload.is_some() {
            return;
        }
        if let Some(wanted) = self.uploads.next(self.next_layer, self.plan.layer_count) {
            self.out.upload = Some((wanted.layer, wanted.slot));
            self.out.need_from = wanted.new_sweep.then_some(wanted.layer).or(self.out.need_from);
        }
    }
}
