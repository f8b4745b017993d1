//! The printer: one loop that owns the jobs, the line to the device and the running job's engine. Every event arrives here, and
//! every decision is made here. Nothing in the loop waits for a disk, the line or a computation.

pub(crate) mod background;
pub(crate) mod doubt;
pub(crate) mod faults;
pub(crate) mod idle;
pub(crate) mod line;
pub(crate) mod plate;
pub(crate) mod publish;
pub(crate) mod running;
pub(crate) mod session;
pub(crate) mod turn;
pub(crate) mod view;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::anyhow;
use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;

use self::background::Background;
use self::faults::FaultNews;
use self::idle::Idle;
use self::line::Line;
use self::running::{Running, Task};
use crate::api::DeviceView;
use crate::daemon::handle::Desk;
use crate::daemon::host::clock::Clock;
use crate::daemon::host::notify;
use crate::daemon::jobs::Jobs;
use crate::daemon::orders::raised::RaisedNote;
use crate::daemon::orders::unwritten::Unwritten;
use crate::daemon::setting::Setting;
use crate::device::DlpDriver;
use crate::job::{Event, Progress, Spool};
use crate::link::message::{Capabilities, DeviceState, HostMessage, Request, Urgent};
use crate::pipeline::EncodedLayer;
use crate::stream::{Finished, MemoryBudget};

/// Capacity of the queue of background results; when full, the worker blocks.
const BACKGROUND_EVENTS: usize = 16;
/// How often statistics are published and the device's state is queried.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// Limit of a shutdown: enough for an exposure of half a minute and a slow lift of 40 mm after it, and less than systemd's
/// TimeoutStopSec of 120 s.
const SHUTDOWN_LIMIT_US: u64 = 110_000_000;

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
    finished_background: mpsc::Receiver<Background>,
    pub(crate) link: Line,
    pub(crate) capabilities: Option<Capabilities>,
    pub(crate) idle: Idle,
    /// From where the plate was raised, until it is known to be empty.
    pub(crate) raised: RaisedNote,
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
}

impl Printer {
    /// A printer with the jobs of its spool; no job runs yet.
    pub(crate) fn new(
        setting: Arc<Setting>,
        spool: Spool,
        jobs: Jobs,
        budget: MemoryBudget,
        desk: Desk,
        link: Line,
    ) -> Self {
        let (background, finished_background) = mpsc::channel(BACKGROUND_EVENTS);
        let raised = RaisedNote::load(&spool);
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
        }
    }

    /// Runs until `shutdown` becomes true and the machine is safe.
    ///
    /// # Errors
    /// The machine could not be made safe, or the line's task ended with a panic.
    pub(crate) async fn run(mut self, mut shutdown: watch::Receiver<bool>) -> anyhow::Result<()> {
        let watchdog = notify::alive_interval().unwrap_or(HEARTBEAT).min(HEARTBEAT);
        let mut heartbeat = tokio::time::interval(watchdog);
        heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut give_up_us = None;
        self.publish();
        let ended = loop {
            self.settle();
            if self.shutting_down && self.is_idle() {
                break Ok(());
            }
            let room = self.link.room();
            let timeout_us = self.next_timeout_us();
            // Orders first. The line comes last: a busy or broken one can bring events without end, and must not delay timers or
            // the watchdog.
            tokio::select! {
                biased;
                Some(order) = self.desk.orders.next() => self.order(order),
                Ok(()) = shutdown.changed(), if !self.shutting_down => {
                    give_up_us = Some(self.clock.now_us() + SHUTDOWN_LIMIT_US);
                    self.begin_shutdown();
                }
                () = sleep_until(self.clock, give_up_us) => break Err(self.late_shutdown()),
                _ = heartbeat.tick() => self.heartbeat(),
                () = sleep_until(self.clock, timeout_us) => self.timeout(),
                Some(event) = self.finished_background.recv() => self.background(event),
                computed = wanted_layer(self.running.as_mut()) => {
                    let now_us = self.clock.now_us();
                    self.with_engine(|running| running.computed(computed, now_us));
                }
                event = self.link.next_event() => match event {
                    Some(event) => self.link_event(event),
                    None => break Err(anyhow!("the line's task ended with a panic; the device's own limits keep it safe")),
                },
                () = room, if self.message.is_some() => {
                    if let Some(message) = self.message.take() {
                        self.link.send(message);
                    }
                }
            }
        };
        if let Some(running) = self.running.take() {
            running.release().await;
        }
        self.link.close().await;
        ended
    }

    /// Whether no job holds the machine or the memory.
    pub(crate) fn is_idle(&self) -> bool {
        self.running.is_none() && self.opening.is_none() && !self.releasing
    }

    fn begin_shutdown(&mut self) {
        self.shutting_down = true;
        self.take_back_raise("the daemon is shutting down");
        notify::stopping();
        let now_us = self.clock.now_us();
        self.with_engine(|running| running.engine.handle(Event::Shutdown, now_us));
    }

    /// Why a shutdown did not end in time.
    fn late_shutdown(&self) -> anyhow::Error {
        if self.running.as_ref().is_some_and(|running| running.engine.is_over()) {
            anyhow!("the disk did not take the job's last records in time; the machine is at rest")
        } else {
            anyhow!("the machine could not be made safe in time; the device's own limits must do it")
        }
    }

    /// The next deadline of the running job, or of the idle device.
    fn next_timeout_us(&self) -> Option<u64> {
        self.running.as_ref().map_or_else(|| self.idle.next_timeout_us(), Running::next_timeout_us)
    }

    fn timeout(&mut self) {
        let now_us = self.clock.now_us();
        if let Some(event) = self.driver().and_then(|driver| driver.handle_timeout(now_us)) {
            self.driver_event(event, now_us);
        }
        let hindrance = self.link.hindrance();
        match &mut self.running {
            Some(running) => {
                running.engine.hindered(hindrance.map(|hindrance| hindrance.to_string()));
                running.engine.handle(Event::Timeout, now_us);
            }
            None => self.idle_timeout(now_us),
        }
    }

    /// Calls `act` with the running job, if there is one.
    pub(crate) fn with_engine(&mut self, act: impl FnOnce(&mut Running)) {
        if let Some(running) = &mut self.running {
            act(running);
        }
    }

    /// Carries out the engine's actions, publishes progress, and opens the next job if none runs.
    fn settle(&mut self) {
        let now_us = self.clock.now_us();
        self.answer_written();
        while let Some(task) = self.running.as_mut().and_then(|running| running.next_task(&self.budget, now_us)) {
            match task {
                Task::Urgent(urgent) => self.send_urgent(urgent),
                Task::Notice(text) => {
                    let of = self.holder().map_or_else(String::new, |job| format!("job {job}: "));
                    self.notice(format!("{of}{text}"));
                }
                Task::EndSession(why) => self.end_session(why, now_us),
                Task::NewSession(why) => self.renew_session(why, now_us),
                Task::Finished => self.finish(),
            }
        }
        self.tell_progress();
        if self.message.is_none() {
            let piece_bytes = self.link.piece_bytes();
            self.message = self.driver().and_then(|driver| driver.next_message(piece_bytes, now_us));
        }
        if self.is_idle() && !self.shutting_down && self.idle.raise.is_none() {
            self.open_next();
        }
    }

    /// The driver of the present session: the running job's, else the idle device's.
    pub(crate) fn driver(&mut self) -> Option<&mut DlpDriver> {
        match &mut self.running {
            Some(running) => running.driver.as_mut(),
            None => self.idle.driver.as_mut(),
        }
    }

    pub(crate) fn send_urgent(&mut self, urgent: Urgent) {
        // An exposure that waits for room must not reach the device after an order to go dark. An abort drops every message.
        let is_exposure =
            |message: &mut HostMessage| matches!(message, HostMessage::Request { request: Request::Expose { .. }, .. });
        let is_unsent = self.message.as_mut().is_some_and(is_exposure);
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

    fn background(&mut self, event: Background) {
        let now_us = self.clock.now_us();
        match event {
            Background::Journalled { job, result } => {
                let event = result.map_or_else(Event::JournalFailed, |()| Event::Journalled);
                self.with_engine(|running| {
                    if running.job == job {
                        running.engine.handle(event, now_us);
                    }
                });
            }
            Background::Opened { job, result } => self.opened(job, result, now_us),
            Background::Accepted { result, jobs_ended, reply } => self.accepted(result, jobs_ended, reply),
            Background::Changed { job, result, reply } => self.changed(job, result, reply),
            Background::RaisedNoted { from_um, result } => self.raised_noted(from_um, result),
            Background::Removed { job, result, reply } => self.removed(job, result, reply),
            Background::Released { forgotten } => {
                self.releasing = false;
                match forgotten {
                    Ok(forgotten) => self.jobs.forget(&forgotten),
                    Err(text) => self.notice(text),
                }
                self.publish();
            }
        }
    }

    fn heartbeat(&mut self) {
        notify::alive();
        let now_us = self.clock.now_us();
        if let Some(driver) = self.driver() {
            driver.query_state(now_us);
        }
        self.late_faults();
        self.retry_raised();
        self.publish();
    }

    /// The job that has the machine, or is about to.
    pub(crate) fn holder(&self) -> Option<u32> {
        self.running.as_ref().map(|running| running.job).or(self.opening)
    }
}

async fn sleep_until(clock: Clock, time_us: Option<u64>) {
    match time_us {
        Some(time_us) => tokio::time::sleep_until(clock.at(time_us)).await,
        None => std::future::pending().await,
    }
}

async fn wanted_layer(running: Option<&mut Running>) -> Result<Finished<EncodedLayer>, String> {
    match running {
        Some(running) => running.wanted_layer().await,
        None => std::future::pending().await,
    }
}
