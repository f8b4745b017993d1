//! The printer: one loop that owns the jobs, the line to the device and the running job's engine. Everything that happens
//! arrives here as an event, and everything that is decided leaves from here; nothing in the loop waits for a disk, the line
//! or a computation.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{mpsc, watch};

use super::api::{DeviceView, Event as News, LayerExposed, LinkState};
use super::clock::Clock;
use super::handle::Desk;
use super::jobs::Jobs;
use super::line::Line;
use super::running::{Background, Opened, Running, Task};
use super::{notify, view};
use crate::config::{DaemonConfig, Machine};
use crate::device::DlpDriver;
use crate::job::{Event, JobState, Progress, Spool};
use crate::link::driver::LinkEvent;
use crate::link::message::{Capabilities, HostMessage, Urgent};
use crate::link::session::HostEvent;
use crate::stream::MemoryBudget;

/// Things that may end in the background at once: one journal record, one opening, and a few uploads being accepted.
const BACKGROUND_EVENTS: usize = 16;
/// How often statistics are published, and the idle device asked how it is.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// The engine bounds each of its own steps; this bounds them all, well below systemd's TimeoutStopSec.
const SHUTDOWN_LIMIT: Duration = Duration::from_secs(30);

/// What does not change while the daemon runs.
pub struct Setting {
    /// The daemon's settings.
    pub config: DaemonConfig,
    /// The machine.
    pub machine: Machine,
    /// Text of the machine file, kept with each job.
    pub machine_text: String,
    /// The default recipe's text.
    pub recipe_text: String,
    /// Its name.
    pub recipe_name: String,
    /// Threads that compute layers.
    pub threads: usize,
}

/// The printer. See the [module](self).
pub(super) struct Printer {
    pub(super) setting: Arc<Setting>,
    pub(super) spool: Arc<Mutex<Spool>>,
    pub(super) budget: MemoryBudget,
    pub(super) desk: Desk,
    pub(super) clock: Clock,
    pub(super) jobs: Jobs,
    pub(super) running: Option<Running>,
    /// The job being opened.
    pub(super) opening: Option<u32>,
    /// The operator aborted the job being opened.
    pub(super) abort_opening: bool,
    pub(super) background: mpsc::Sender<Background>,
    finished_background: mpsc::Receiver<Background>,
    link: Line,
    capabilities: Option<Capabilities>,
    /// Asks the device how it is while no job runs; `None` without a session.
    idle: Option<DlpDriver>,
    device: DeviceView,
    /// A message the driver gave and the line has no room for yet.
    message: Option<HostMessage>,
    /// Number of the abort sent last that no device has answered.
    last_abort: Option<u32>,
    last_progress: Option<Progress>,
    /// Sessions begun because the one before was lost.
    reconnects: u64,
    shutting_down: bool,
}

impl Printer {
    /// A printer with the jobs of its spool; nothing runs yet.
    pub(super) fn new(
        setting: Arc<Setting>,
        spool: Spool,
        jobs: Jobs,
        budget: MemoryBudget,
        desk: Desk,
        link: Line,
    ) -> Self {
        let (background, finished_background) = mpsc::channel(BACKGROUND_EVENTS);
        Self {
            setting,
            spool: Arc::new(Mutex::new(spool)),
            budget,
            desk,
            clock: Clock::new(),
            jobs,
            running: None,
            opening: None,
            abort_opening: false,
            background,
            finished_background,
            link,
            capabilities: None,
            idle: None,
            device: DeviceView::default(),
            message: None,
            last_abort: None,
            last_progress: None,
            reconnects: 0,
            shutting_down: false,
        }
    }

    /// Runs until `shutdown` becomes true and the machine is safe.
    pub(super) async fn run(mut self, mut shutdown: watch::Receiver<bool>) {
        let watchdog = notify::alive_interval().unwrap_or(HEARTBEAT).min(HEARTBEAT);
        let mut heartbeat = tokio::time::interval(watchdog);
        let mut give_up = None;
        self.publish();
        loop {
            self.settle().await;
            let room = self.link.room();
            if self.shutting_down && self.running.is_none() && self.opening.is_none() {
                break;
            }
            tokio::select! {
                biased;
                Some(order) = self.desk.orders.next() => self.order(order),
                Some(event) = self.link.next_event() => self.link_event(event),
                Some(event) = self.finished_background.recv() => self.background(event),
                () = sleep_until(self.clock, self.running.as_ref().and_then(|running| running.engine.next_timeout_us())) => {
                    let now_us = self.clock.now_us();
                    self.with_engine(|running| running.engine.handle(Event::Timeout, now_us));
                }
                () = room, if self.message.is_some() => {
                    if let Some(message) = self.message.take() {
                        self.link.send(message);
                    }
                }
                computed = wanted_layer(self.running.as_mut()) => {
                    let now_us = self.clock.now_us();
                    self.with_engine(|running| running.computed(computed, now_us));
                }
                _ = heartbeat.tick() => self.heartbeat(),
                Ok(()) = shutdown.changed(), if !self.shutting_down => {
                    give_up = Some(tokio::time::Instant::now() + SHUTDOWN_LIMIT);
                    self.begin_shutdown();
                }
                () = tokio::time::sleep_until(give_up.unwrap_or_else(tokio::time::Instant::now)), if give_up.is_some() => {
                    tracing::error!("the machine could not be made safe in time; the device's own limits must do it");
                    break;
                }
            }
        }
        if let Some(running) = self.running.take() {
            running.release().await;
        }
        self.link.close().await;
    }

    fn begin_shutdown(&mut self) {
        self.shutting_down = true;
        notify::stopping();
        let now_us = self.clock.now_us();
        self.with_engine(|running| running.engine.handle(Event::Shutdown, now_us));
    }

    pub(super) fn with_engine(&mut self, act: impl FnOnce(&mut Running)) {
        if let Some(running) = &mut self.running {
            act(running);
        }
    }

    /// Carries out what the engine wants, starts the next job where none runs, and tells what changed.
    async fn settle(&mut self) {
        while let Some(task) = self.running.as_mut().and_then(|running| running.next_task(&self.budget)) {
            match task {
                Task::Urgent(urgent) => self.send_urgent(urgent),
                Task::Notice(text) => self.notice(text),
                Task::Finished => self.finish().await,
            }
        }
        self.tell_progress();
        if self.message.is_none() {
            let piece_bytes = self.link.piece_bytes();
            self.message = self.driver().and_then(|driver| driver.next_message(piece_bytes));
        }
        if self.running.is_none() && self.opening.is_none() && !self.shutting_down {
            self.open_next();
        }
    }

    fn driver(&mut self) -> Option<&mut DlpDriver> {
        match &mut self.running {
            Some(running) => running.driver.as_mut(),
            None => self.idle.as_mut(),
        }
    }

    fn send_urgent(&mut self, urgent: Urgent) {
        // What waits for room must not reach the device after an abort.
        self.message = None;
        let number = self.link.urgent(urgent);
        if urgent == Urgent::Abort {
            self.last_abort = Some(number);
        }
        self.with_engine(|running| running.urgent = Some((number, urgent)));
    }

    pub(super) fn notice(&self, text: String) {
        tracing::warn!("{text}");
        let _ = self.desk.events.send(News::Notice { text });
    }

    fn open_next(&mut self) {
        let Some(id) = self.jobs.take_next() else { return };
        let Some(job) = self.jobs.get_mut(id) else { return };
        job.view.state = JobState::Checking;
        let (directory, choice) = (job.directory.clone(), std::mem::take(&mut job.choice));
        let (threads, limit_bytes) = (self.setting.threads, self.budget.limit_bytes());
        let background = self.background.clone();
        self.opening = Some(id);
        self.publish_job(id);
        tokio::task::spawn_blocking(move || {
            let result = Opened::open(&directory, choice, threads, limit_bytes).map(Box::new);
            let _ = background.blocking_send(Background::Opened { job: id, result });
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
            Background::Accepted { result, reply } => self.accepted(result, reply),
        }
    }

    fn opened(&mut self, id: u32, result: Result<Box<Opened>, String>, now_us: u64) {
        self.opening = None;
        let abort = std::mem::take(&mut self.abort_opening);
        match result {
            Ok(opened) => {
                let mut running = Running::new(id, *opened, self.background.clone(), now_us);
                if abort {
                    running.command(crate::job::Command::Abort, now_us);
                }
                if self.shutting_down {
                    running.engine.handle(Event::Shutdown, now_us);
                }
                self.idle = None;
                self.message = None;
                self.running = Some(running);
                // A new session tells the device's state afresh and numbers requests from 1 for the job's driver.
                self.link.reconnect();
            }
            Err(text) => {
                self.notice(format!("job {id} cannot be printed: {text}"));
                if let Some(job) = self.jobs.get_mut(id) {
                    let state = if job.view.layers_done == 0 { JobState::Failed } else { JobState::Interrupted };
                    job.end(state, Some(text));
                }
                self.publish_job(id);
            }
        }
    }

    async fn finish(&mut self) {
        self.tell_progress();
        let Some(running) = self.running.take() else { return };
        self.message = None;
        let id = running.job;
        running.release().await;
        self.last_progress = None;
        tracing::info!(job = id, state = %self.jobs.get(id).map_or(JobState::Failed, |job| job.view.state), "job ended");
        self.tidy_spool();
        self.idle = None;
        self.link.reconnect();
        self.publish();
    }

    fn tidy_spool(&mut self) {
        let over = self.jobs.over();
        let tidied = {
            let spool = self.spool.lock().unwrap_or_else(PoisonError::into_inner);
            spool.tidy(&over).and_then(|()| spool.jobs())
        };
        match tidied {
            Ok(directories) => self.jobs.keep_only(&directories),
            Err(error) => self.notice(error.to_string()),
        }
    }

    fn link_event(&mut self, event: LinkEvent) {
        let now_us = self.clock.now_us();
        match event {
            LinkEvent::Session(HostEvent::Connected { capabilities, state, .. }) => {
                self.message = None;
                view::device_connected(&mut self.device, &capabilities, &state, &self.jobs);
                match &mut self.running {
                    Some(running) => running.connected(&capabilities, &state, now_us),
                    None => self.idle = Some(DlpDriver::new(0, &capabilities, &state)),
                }
                self.capabilities = Some(capabilities);
                self.link_changed(LinkState::Connected, None);
            }
            LinkEvent::Session(HostEvent::Message(message)) => {
                let event = self.driver().and_then(|driver| driver.handle(message));
                if let Some(event) = event {
                    view::device_told(&mut self.device, &event, &self.jobs);
                    self.with_engine(|running| running.driver_event(event, now_us));
                }
            }
            LinkEvent::Session(HostEvent::UrgentDone { number, light_on }) => {
                self.urgent_done(number, light_on, now_us);
            }
            LinkEvent::Session(HostEvent::Lost(reason)) => self.lost(reason.to_string(), now_us),
            LinkEvent::Session(HostEvent::Refused(refusal)) => self.lost(refusal.to_string(), now_us),
            LinkEvent::NotOpen(error) => self.lost(error.to_string(), now_us),
            LinkEvent::NotSent(error) => {
                // Without it the device and the driver no longer agree on what was asked.
                self.lost(format!("a message could not be sent: {error}"), now_us);
                self.link.reconnect();
            }
            LinkEvent::PortFailed(error) => self.lost(format!("the port failed: {error}"), now_us),
        }
    }

    fn urgent_done(&mut self, number: u32, light_on: bool, now_us: u64) {
        let awaited = self.running.as_mut().and_then(|running| {
            let (_, urgent) = running.urgent.take_if(|(awaited, _)| *awaited == number)?;
            Some((running, urgent))
        });
        let Some((running, urgent)) = awaited else {
            if self.last_abort.take_if(|abort| *abort == number).is_some() {
                // Of a job that ended before the device came back. It obeys now, and does nothing more until a new hello.
                self.lost("the device has only now obeyed the abort of an earlier job".into(), now_us);
                self.link.reconnect();
            }
            return;
        };
        running.engine.handle(
            if light_on {
                Event::UrgentFailed("the device says that its light is still on".into())
            } else {
                Event::UrgentDone
            },
            now_us,
        );
        if urgent == Urgent::Abort {
            self.last_abort = None;
            // An aborted device does nothing more until a new hello.
            self.link.reconnect();
        }
    }

    fn lost(&mut self, reason: String, now_us: u64) {
        self.message = None;
        self.idle = None;
        self.reconnects += u64::from(std::mem::take(&mut self.device.connected));
        self.with_engine(|running| running.line_lost(reason.clone(), now_us));
        let state = if self.capabilities.is_some() { LinkState::Lost } else { LinkState::Connecting };
        self.link_changed(state, Some(reason));
    }

    fn link_changed(&mut self, state: LinkState, reason: Option<String>) {
        let path = self.setting.machine.link.path.display().to_string();
        let device = self.capabilities.as_ref().map(|capabilities| capabilities.name.clone());
        let link = super::api::LinkView { state, path, device, reason };
        let changed = self.desk.snapshot.borrow().link != link;
        if changed {
            tracing::info!(state = %link.state, reason = link.reason.as_deref().unwrap_or(""), "line");
            self.desk.snapshot.send_modify(|snapshot| snapshot.link = link.clone());
            let _ = self.desk.events.send(News::Link(link));
        }
        self.publish();
    }

    fn heartbeat(&mut self) {
        notify::alive();
        if let Some(idle) = &mut self.idle {
            idle.query_state();
        }
        self.publish();
    }

    /// Compares what the engine says with what was told last, and tells the difference.
    fn tell_progress(&mut self) {
        let Some(running) = &self.running else { return };
        let (id, progress) = (running.job, running.engine.progress());
        let before = self.last_progress.replace(progress.clone());
        if let Some(before) = before.filter(|before| before.layers_done < progress.layers_done) {
            let late_ms = progress.late_ms_total - before.late_ms_total;
            let layer = progress.layers_done - 1;
            let exposure_ms = running.exposure_ms(layer);
            let exposed = LayerExposed { job: id.to_string(), layer, exposure_ms, late_ms };
            let _ = self.desk.events.send(News::Layer(exposed));
        }
        if self.jobs.get_mut(id).is_some_and(|job| job.update(&progress)) {
            self.publish_job(id);
        }
    }

    pub(super) fn publish_job(&mut self, id: u32) {
        let Some(job) = self.jobs.get(id) else { return };
        let _ = self.desk.events.send(News::Job(Box::new(job.view.clone())));
        notify::status(&view::status_line(&job.view));
        self.publish();
    }

    fn publish(&mut self) {
        let line = view::line(&self.link.statistics(), self.reconnects);
        let budget = view::budget(&self.budget);
        let (device, jobs) = (self.device.clone(), self.jobs.views());
        self.desk.snapshot.send_modify(|snapshot| {
            snapshot.line = line;
            snapshot.budget = budget;
            snapshot.device = device;
            snapshot.jobs = jobs;
        });
    }
}

async fn sleep_until(clock: Clock, time_us: Option<u64>) {
    match time_us {
        Some(time_us) => tokio::time::sleep_until(clock.at(time_us)).await,
        None => std::future::pending().await,
    }
}

async fn wanted_layer(
    running: Option<&mut Running>,
) -> Result<crate::stream::Finished<super::part::EncodedLayer>, String> {
    match running {
        Some(running) => running.wanted_layer().await,
        None => std::future::pending().await,
    }
}
