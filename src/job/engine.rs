//! The life of one job as a pure state machine: no I/O, no clock. Events and the time go in, actions come out. What the machine
//! does between two layers is decided by its cycle, in `job/cycle/`.
//!
//! ```text
//!             Ready + Connected
//!  Checking ───────────────────▶ take stock of the device ◀────────── Connected ── Lost ◀── LineLost, from anywhere
//!                                 │                                  (bounded; else interrupted)
//!                                 ▼
//!        ┌──────────────────▶ advance ── pause, stop, shutdown, failure, last layer ──▶ Parking ──▶ Resting | Ending
//!        │                        │                                               (the cycle parks)
//!        │            Acting, Standing: the cycle makes the machine ready
//!        │                        ▼
//!        │                    Waiting, dark, while the layer is late
//!        │                        ▼
//!        │      Commanding: journal Commanded ──▶ Exposing ──▶ Confirming: journal Confirmed
//!        │                                                          ▼
//!        └────────────────────────────────────── Standing: the cycle's wait after an exposure
//!
//!  Light that was not commanded, or lasts too long: Urgent(LightOff) ──▶ Darkening ──▶ take stock ──▶ Parking ──▶ Ending
//!
//!  Abort, from anywhere: Urgent(Abort) ──▶ AbortSent ──▶ AbortReconnect ──▶ Parking ──▶ Ending
//!  (as long as there is light: Urgent(LightOff) as well, and Urgent(Abort) again in a new session each half second)
//! ```
//!
//! How to drive it: after every [`Engine::handle`], call [`Engine::next_action`] until it returns `None`, and carry out each
//! action (uploads and acts in the background). At [`Engine::next_timeout_us`], call [`Engine::handle`] with
//! [`Event::Timeout`]. Times are microseconds of a monotonic clock. The example in `job/mod.rs` shows the first steps.
//!
//! What is counted are exposures, in the order of [`Passes`](crate::device::Passes). In a part of one material a layer is one exposure.
//!
//! Invariants, whatever the order of events:
//! - A layer is exposed only after its `Commanded` record is on disk.
//! - One act runs at a time, and it waits for the records before it. One exception: if the disk is slow, the act that parks the
//!   machine does not wait.
//! - Light that was not commanded, or that lasts too long, is switched off at once. Nothing else is commanded until the device
//!   reports dark.
//! - The print stops if a reported light time or position differs from the commanded one.
//! - A layer counts as exposed only if the device or the operator says so.
//! - The machine moves only as its cycle allows, which knows what could harm a part.
//! - Every wait is limited in time, except a pause.

mod abort;
mod connection;
mod disk;
mod ending;
mod exposure;
mod light;
mod next;
mod outbox;
mod pace;
mod phase;
mod recovery;
mod refusal;
mod report;
mod steps;
mod track;
mod uploads;

use disk::DiskWatch;
use next::NextExposure;
use outbox::Outbox;
use pace::Pace;
use phase::{End, Intent, Phase};
use track::{AbortOrder, ActWatch, Failures, LineState, Memory, PartState};
use uploads::Uploads;

use super::cycle::Cycle;
use super::{Action, Command, EndOrder, Event, JobPlan, JobState, Record, StartPoint};
use crate::deadline::Deadline;
use crate::device::{Act, LightWatch};
use crate::link::message::{DeviceState, ExposureId};

const SECOND_US: u64 = 1_000_000;

/// Longest wait for a new session. A replugged cable or a restarted device takes seconds; a minute lets the operator walk to
/// the machine. A part should not stay in the machine unattended for longer.
const RECONNECT_US: u64 = 60 * SECOND_US;
/// Allowance beyond an act's computed time: acceleration ramps, a busy line, one recovery of the link (at most 5 s).
pub const ACT_MARGIN_US: u64 = 15 * SECOND_US;
/// Longest wait for a layer. One that takes ten minutes to compute will not come.
const LATE_LIMIT_US: u64 = 600 * SECOND_US;

/// The engine of one job.
#[derive(Debug)]
pub struct Engine {
    plan: JobPlan,
    /// What the machine does between two layers.
    cycle: Cycle,
    phase: Phase,
    intent: Intent,
    /// End of the phase's wait.
    deadline: Option<Deadline>,
    out: Outbox,
    uploads: Uploads,
    line: LineState,
    /// The last state that the device reported.
    device: DeviceState,
    light: LightWatch,
    memory: Memory,
    next: NextExposure,
    part: PartState,
    /// What the device had exposed last, of another job, before this job had light.
    exposed_before: Option<ExposureId>,
    /// A fault forbids moving.
    immobile: bool,
    act: ActWatch,
    abort_order: AbortOrder,
    failures: Failures,
    pace: Pace,
    disk: DiskWatch,
}

impl Engine {
    /// An engine that waits for [`Event::Ready`] and [`Event::Connected`]. `start` comes from
    /// [`super::History::start`], or is the default for a new job.
    pub fn new(plan: JobPlan, start: StartPoint) -> Self {
        Self {
            cycle: Cycle::new(&plan, start),
            plan,
            phase: Phase::Checking { ready: false },
            intent: Intent::Print,
            deadline: None,
            out: Outbox::default(),
            uploads: Uploads::default(),
            line: LineState::default(),
            device: DeviceState::default(),
            light: LightWatch::default(),
            memory: Memory::default(),
            part: PartState::new(start.touched, start.confirmed),
            exposed_before: start.exposed_before,
            next: NextExposure::new(start),
            immobile: false,
            act: ActWatch::default(),
            abort_order: AbortOrder::default(),
            failures: Failures::default(),
            pace: Pace::default(),
            disk: DiskWatch::default(),
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
        self.line.hindrance = by;
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
            Event::Connected { state, limits } => self.on_connected(state, limits, now_us),
            Event::LineLost(reason) => self.on_line_lost(reason, now_us),
            Event::Misbehaved(text) => self.on_misbehaved(&text, now_us),
            Event::State(state) => self.on_state(state, now_us),
            Event::ActSent { number } => self.act.handed_to_line(number, now_us),
            Event::ActTaken { number } => self.on_act_taken(number, now_us),
            Event::Uploaded { exposure, times } => self.on_uploaded(exposure, times, now_us),
            Event::UploadRefused { exposure, refusal } => self.on_upload_refused(exposure, refusal, now_us),
            Event::LayerFailed { exposure, text } => {
                self.uploads.cancel();
                let text = format!("{} cannot be computed: {text}", self.plan.passes.text(exposure));
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
        self.park_without_disk(now_us);
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
        let Phase::Checking { ready } = &mut self.phase else { return };
        *ready = true;
        if self.line.is_up() {
            self.start(now_us);
        } else {
            self.deadline = Some(Deadline::at(now_us + RECONNECT_US));
        }
    }

    fn command(&mut self, command: Command, now_us: u64) {
        match (command, &mut self.intent) {
            (Command::Pause, Intent::Print) => {
                self.intent = Intent::Pause;
                self.reconsider(false, now_us);
            }
            (Command::Resume, Intent::Pause) => {
                self.intent = Intent::Print;
                if self.phase == Phase::Resting {
                    self.out.journal(Record::Resumed);
                    self.advance(now_us);
                }
            }
            (Command::Stop, Intent::Print | Intent::Pause) => {
                self.out.journal(Record::Ordered(EndOrder::Stop));
                let reason = "stopped by the operator".into();
                self.intent = Intent::End(End { state: JobState::Stopped, reason, ordered: Some(EndOrder::Stop) });
                self.reconsider(false, now_us);
            }
            (Command::Stop, Intent::End(end)) if end.state == JobState::Interrupted => {
                self.out.journal(Record::Ordered(EndOrder::Stop));
                end.state = JobState::Stopped;
                end.reason = format!("stopped by the operator; {}", end.reason);
                end.ordered.get_or_insert(EndOrder::Stop);
            }
            (command, intent) => {
                if let (Command::Stop, Intent::End(end)) = (command, intent) {
                    end.ordered.get_or_insert(EndOrder::Stop);
                }
                self.out.notice(format!("nothing to do: the job is {}", self.state()));
            }
        }
    }

    fn on_timeout(&mut self, now_us: u64) {
        match self.phase {
            Phase::Standing { .. } => {
                let step = self.cycle.waited();
                self.take(step, now_us);
            }
            Phase::WarmingUp | Phase::Waiting { .. } => {
                let text = format!(
                    "{} did not come within {} s: run `layerctl check` on the part, then resume",
                    self.next_text(),
                    LATE_LIMIT_US / SECOND_US
                );
                self.wind_down(JobState::Interrupted, text, now_us);
            }
            Phase::Asking { until_us } => self.ask_again(until_us, now_us),
            Phase::Darkening { until_us } => self.ask_for_dark(until_us, now_us),
            Phase::Exposing { .. } => self.on_overdue_light(now_us),
            Phase::CuttingShort => {
                let text = self.line.with_cause("the device did not say how the exposure ended");
                self.end_session(&text, now_us);
            }
            Phase::Acting | Phase::Parking if self.out.act.is_some() => {
                // It waits for the disk, not for the device.
                self.deadline = Some(Deadline::at(now_us + ACT_MARGIN_US));
            }
            Phase::Acting | Phase::Parking => self.on_overdue_act(now_us),
            Phase::Checking { .. } | Phase::Lost => self.on_no_device(),
            _ => {}
        }
    }

    fn start_act(&mut self, act: Act, least_us: u64, phase: Phase, deadline_us: u64, now_us: u64) {
        let number = self.act.begin(self.plan.host_us(least_us), now_us);
        self.out.act = Some((number, act));
        self.wait_until(phase, deadline_us);
    }

    fn wait_until(&mut self, phase: Phase, deadline_us: u64) {
        self.phase = phase;
        self.deadline = Some(Deadline::at(deadline_us));
    }

    /// Identifies the next exposure.
    fn exposure_id(&self) -> ExposureId {
        self.plan.passes.id(self.plan.key, self.next.number)
    }

    /// The next exposure in words.
    fn next_text(&self) -> String {
        self.plan.passes.text(self.next.number)
    }

    fn pump_uploads(&mut self) {
        use Phase::{AbortReconnect, AbortSent, Asking, Checking, Darkening, Done, Ending, Lost};
        let idle = matches!(
            self.phase,
            Checking { .. } | Lost | Asking { .. } | Darkening { .. } | AbortSent | AbortReconnect | Ending | Done
        );
        if idle || !self.line.is_up() || matches!(self.intent, Intent::End(_)) || self.out.upload.is_some() {
            return;
        }
        if let Some(wanted) = self.uploads.next(self.next.number, self.plan.passes.exposure_count()) {
            self.out.upload = Some((wanted.exposure, wanted.slot));
            self.out.need_from = wanted.new_sweep.then_some(wanted.exposure).or(self.out.need_from);
        }
    }
}
