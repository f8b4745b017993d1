//! The printer owns the jobs, the line to the device and the running job's engine. Every decision is made here, by one task.
//!
//! This file holds what it is made of. `event_loop` is where every event arrives; `turn`, `session`, `light`, `plate`, `doubt`
//! and `publish` say what an event changes, and [`orders`](super::orders) what an order does. `tests/print.rs` prints with it.

mod doubt;
mod event_loop;
mod fits;
mod light;
mod plate;
pub(crate) mod publish;
mod sampler;
mod session;
mod turn;
pub(crate) mod unread;

use std::sync::{Arc, Mutex};

use tokio::sync::mpsc;

use self::sampler::Sampler;
use self::unread::Unread;
use super::background::Background;
use super::handle::Desk;
use super::host::clock::Clock;
use super::jobs::Jobs;
use super::jobs::unwritten::Unwritten;
use super::machine::faults::FaultNews;
use super::machine::idle::Idle;
use super::machine::line::LineHandle;
use super::machine::raised::RaisedNote;
use super::machine::running::Running;
use super::setting::Setting;
use crate::api::DeviceView;
use crate::device::FramedDriver;
use crate::job::{Progress, Spool};
use crate::link::message::{Capabilities, DeviceState, HostMessage, Urgent};
use crate::stream::MemoryBudget;

/// Capacity of the queue of background results; when full, the worker blocks.
const MAX_BACKGROUND_RESULTS: usize = 16;
/// The printer. See the [module](self).
pub(crate) struct Printer {
    pub(crate) setting: Arc<Setting>,
    pub(crate) spool: Arc<Mutex<Spool>>,
    pub(crate) budget: MemoryBudget,
    pub(crate) desk: Desk,
    pub(crate) clock: Clock,
    pub(crate) jobs: Jobs,
    pub(crate) running: Option<Running>,
    /// The job being opened.
    pub(crate) opening: Option<u32>,
    /// Whether the last job's memory is still being given back.
    pub(crate) releasing: bool,
    pub(crate) background: mpsc::Sender<Background>,
    pub(crate) finished_background: mpsc::Receiver<Background>,
    pub(crate) link: LineHandle,
    pub(crate) capabilities: Option<Capabilities>,
    pub(crate) idle: Idle,
    /// From where the plate was raised, until it is known to be empty.
    pub(crate) raised: RaisedNote,
    /// Journals that could not be read.
    pub(crate) unread: Unread,
    /// Estimates how much resin parts take.
    pub(crate) sampler: Sampler,
    pub(crate) device: DeviceView,
    pub(crate) faults: FaultNews,
    /// The device's latest state in this session; `None` without one.
    pub(crate) device_state: Option<DeviceState>,
    /// Orders that are answered once their records are on disk. Each leaves within two seconds.
    pub(crate) unwritten: Vec<Unwritten>,
    /// A message of the driver that waits for room on the line.
    pub(crate) message: Option<HostMessage>,
    /// Number of the last abort, until a device answers it.
    pub(crate) last_abort: Option<u32>,
    pub(crate) last_progress: Option<Progress>,
    /// See [`crate::daemon::handle::Snapshot::jobs_ended`].
    pub(crate) jobs_ended: u64,
    /// Sessions that were lost since the start.
    pub(crate) reconnects: u64,
    pub(crate) shutting_down: bool,
    /// Each submission that is being checked and stored holds it, until it is answered or its check has panicked.
    pub(crate) accepting: Arc<()>,
}

impl Printer {
    /// A printer with the jobs of its spool; no job runs yet.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub(crate) fn new(
        setting: Arc<Setting>,
        spool: Spool,
        raised: RaisedNote,
        jobs: Jobs,
        budget: MemoryBudget,
        desk: Desk,
        link: LineHandle,
    ) -> Self {
        let (background, finished_background) = mpsc::channel(MAX_BACKGROUND_RESULTS);
        let sampler = Sampler::start(background.clone());
        jobs.unsampled().for_each(|job| sampler.want(job));
        Self {
            setting,
            spool: Arc::new(Mutex::new(spool)),
            budget,
            desk,
            clock: Clock::new(),
            jobs,
            running: None,
            opening: None,
            releasing: false,
            background,
            finished_background,
            link,
            capabilities: None,
            idle: Idle::default(),
            raised,
            unread: Unread::default(),
            sampler,
            device: DeviceView::default(),
            faults: FaultNews::default(),
            device_state: None,
            unwritten: Vec::new(),
            message: None,
            last_abort: None,
            last_progress: None,
            jobs_ended: 0,
            reconnects: 0,
            shutting_down: false,
            accepting: Arc::default(),
        }
    }

    /// Whether no job holds the machine or the memory.
    pub(crate) fn is_idle(&self) -> bool {
        self.running.is_none() && self.opening.is_none() && !self.releasing
    }

    /// Whether orders are being carried out and are not answered yet. If the daemon ended now, they would be called refused and might be
    /// carried out all the same.
    pub(crate) fn owes_answers(&self) -> bool {
        Arc::strong_count(&self.accepting) > 1 || self.jobs.are_ordered()
    }

    /// Calls `act` with the running job, if there is one.
    pub(crate) fn with_engine(&mut self, act: impl FnOnce(&mut Running)) {
        if let Some(running) = &mut self.running {
            act(running);
        }
    }

    /// The driver of the present session: the running job's, else the idle device's.
    pub(crate) fn driver(&mut self) -> Option<&mut FramedDriver> {
        match &mut self.running {
            Some(running) => running.driver.as_mut(),
            None => self.idle.driver.as_mut(),
        }
    }

    /// Hands the waiting message to the line.
    fn send_message(&mut self) {
        let Some(message) = self.message.take() else { return };
        if self.driver().is_some_and(|driver| driver.is_act(&message)) {
            let now_us = self.clock.now_us();
            match &mut self.running {
                Some(running) => running.act_sent(now_us),
                None => self.raise_sent(now_us),
            }
        }
        self.link.send(message);
    }

    pub(crate) fn send_urgent(&mut self, urgent: Urgent) {
        // An exposure that waits for room must not reach the device after an order to go dark. An abort drops every message.
        let is_exposure = |message: &HostMessage| match message {
            HostMessage::Request { request, .. } => request.is_exposure(),
            HostMessage::LayerData(_) => false,
        };
        let is_unsent = self.message.as_ref().is_some_and(is_exposure);
        self.message.take_if(|message| urgent == Urgent::Abort || is_exposure(message));
        if urgent == Urgent::LightOff {
            let now_us = self.clock.now_us();
            self.with_engine(|running| {
                if running.driver.as_mut().is_some_and(|driver| driver.take_back_exposure(is_unsent)) {
                    running.exposure_taken_back(now_us);
                }
            });
        }
        let number = self.link.urgent(urgent);
        if urgent == Urgent::Abort {
            self.take_back_raise("an abort came first");
            self.last_abort = Some(number);
            if self.running.is_none() {
                self.idle.light.abort();
            }
        }
        // The answer to an abort is awaited, whatever is sent beside it.
        self.with_engine(|running| match running.urgent {
            Some((_, Urgent::Abort)) if urgent != Urgent::Abort => {}
            _ => running.urgent = Some((number, urgent)),
        });
    }

    /// The job that has the machine, or is about to.
    pub(crate) fn holder(&self) -> Option<u32> {
        self.running.as_ref().map(|running| running.job).or(self.opening)
    }
}
