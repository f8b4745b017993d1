//! The printer: one loop that owns the jobs, the line to the device and the running job's engine. Everything that happens
//! arrives here as an event, and everything that is decided leaves from here; nothing in the loop waits for a disk, the line
//! or a computation.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::anyhow;
use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;

use super::api::{DeviceView, Event as News, LayerExposed};
use super::background::Background;
use super::clock::Clock;
use super::faults::FaultNews;
use super::handle::{CommandError, Desk};
use super::idle::Idle;
use super::jobs::{Jobs, TakeUp};
use super::line::Line;
use super::opened::{Opened, Unopened};
use super::part::EncodedLayer;
use super::running::{Running, Task};
use super::setting::Setting;
use super::settle::Change;
use super::unwritten::Unwritten;
use super::{notify, raise, view};
use crate::device::DlpDriver;
use crate::job::{Command, Event, JobState, Progress, Spool};
use crate::link::message::{Capabilities, DeviceState, HostMessage, Request, Urgent};
use crate::stream::{Finished, MemoryBudget};

/// Ends from the background that may wait; what more ends waits with its thread: nobody gives so many orders at once.
const BACKGROUND_EVENTS: usize = 16;
/// How often statistics are published, and the device asked how it is.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// Half a minute for an exposure to end and a slow lift of 40 mm behind it, below systemd's TimeoutStopSec of 120 s.
const SHUTDOWN_LIMIT_US: u64 = 110_000_000;

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
    /// The last job's memory is still being given back.
    pub(super) releasing: bool,
    pub(super) background: mpsc::Sender<Background>,
    finished_background: mpsc::Receiver<Background>,
    pub(super) link: Line,
    pub(super) capabilities: Option<Capabilities>,
    pub(super) idle: Idle,
    /// From where the plate was raised, below its clear height, micrometres; nobody has said since that it is bare.
    pub(super) raised_from_um: Option<i32>,
    /// The same, for the spool: writes may overtake each other, and each writes what stands here.
    pub(super) raised_note: Arc<Mutex<Option<i32>>>,
    pub(super) device: DeviceView,
    pub(super) faults: FaultNews,
    /// The device as last heard of in this session; `None` without one.
    pub(super) device_state: Option<DeviceState>,
    /// Orders answered once they are on disk: at most a few, each leaves within a second or two.
    pub(super) unwritten: Vec<Unwritten>,
    /// A message the driver gave and the line has no room for yet.
    pub(super) message: Option<HostMessage>,
    /// Number of the abort sent last that no device has answered.
    pub(super) last_abort: Option<u32>,
    last_progress: Option<Progress>,
    /// See [`super::handle::Snapshot::jobs_ended`].
    pub(super) jobs_ended: u64,
    /// Sessions begun because the one before was lost.
    pub(super) reconnects: u64,
    pub(super) shutting_down: bool,
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
        let raised_from_um = raise::noted(&spool);
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
            raised_from_um,
            raised_note: Arc::new(Mutex::new(raised_from_um)),
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
    /// Where the machine could not be made safe, or the line's task is gone.
    pub(super) async fn run(mut self, mut shutdown: watch::Receiver<bool>) -> anyhow::Result<()> {
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
            // Orders first. What a busy or broken line can bring without end comes last: no timer and no watchdog waits for it.
            tokio::select! {
                biased;
                Some(order) = self.desk.orders.next() => self.order(order),
                Ok(()) = shutdown.changed(), if !self.shutting_down => {
                    give_up_us = Some(self.clock.now_us() + SHUTDOWN_LIMIT_US);
                    self.begin_shutdown();
                }
                () = sleep_until(self.clock, give_up_us) => {
                    let is_over = self.running.as_ref().is_some_and(|running| running.engine.is_over());
                    break Err(if is_over {
                        anyhow!("the disk did not take the job's last records in time; the machine is at rest")
                    } else {
                        anyhow!("the machine could not be made safe in time; the device's own limits must do it")
                    });
                }
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
    pub(super) fn is_idle(&self) -> bool {
        self.running.is_none() && self.opening.is_none() && !self.releasing
    }

    fn begin_shutdown(&mut self) {
        self.shutting_down = true;
        notify::stopping();
        let now_us = self.clock.now_us();
        self.with_engine(|running| running.engine.handle(Event::Shutdown, now_us));
    }

    /// When something is overdue that the running job, or the device without a job, owes.
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

    /// Does something with the running job, if there is one.
    pub(super) fn with_engine(&mut self, act: impl FnOnce(&mut Running)) {
        if let Some(running) = &mut self.running {
            act(running);
        }
    }

    /// Carries out what the engine wants, starts the next job where none runs, and tells what changed.
    fn settle(&mut self) {
        let now_us = self.clock.now_us();
        self.answer_written();
        while let Some(task) = self.running.as_mut().and_then(|running| running.next_task(&self.budget, now_us)) {
            match task {
                Task::Urgent(urgent) => self.send_urgent(urgent),
                Task::Notice(text) => self.notice(text),
                Task::EndSession(why) => self.end_session(why, now_us),
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

    /// Who speaks with the device now.
    pub(super) fn driver(&mut self) -> Option<&mut DlpDriver> {
        match &mut self.running {
            Some(running) => running.driver.as_mut(),
            None => self.idle.driver.as_mut(),
        }
    }

    pub(super) fn send_urgent(&mut self, urgent: Urgent) {
        // An exposure that waits for room must not reach the device after an order to be dark; anything else only an abort ends.
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
            self.last_abort = Some(number);
        }
        self.with_engine(|running| running.urgent = Some((number, urgent)));
    }

    /// Tells the operator something to look at.
    pub(super) fn notice(&self, text: String) {
        tracing::warn!("{text}");
        let _ = self.desk.events.send(News::Notice { text });
    }

    /// Tells the operator that all is well.
    pub(super) fn tell(&self, text: String) {
        tracing::info!("{text}");
        let _ = self.desk.events.send(News::Notice { text });
    }

    fn open_next(&mut self) {
        let Some(job) = self.jobs.next() else { return };
        let waits_for_word = || {
            let signs = || self.unknown_signs(job, self.device_state.as_ref());
            job.needs_bare_plate() && !(job.told.is_empty() && signs().is_empty())
        };
        if job.is_to_print() && self.unwanted_light().is_some() {
            return;
        }
        if job.awaits_plate || (job.awaits_device && !self.device.connected) || waits_for_word() {
            return;
        }
        let id = job.directory.id;
        self.jobs.take(id, self.setting.machine.confirm_plate);
        let Some(job) = self.jobs.get_mut(id) else { return };
        let (directory, take_up, has_begun) = (job.directory.clone(), job.take_up, job.has_begun());
        job.view.state = take_up.state_before(JobState::Checking);
        job.view.reason = None;
        let (threads, limit_bytes) = (self.setting.threads, self.budget.limit_bytes());
        let background = self.background.clone();
        self.opening = Some(id);
        self.publish_job(id);
        tokio::task::spawn_blocking(move || {
            let result = Opened::open(&directory, take_up, has_begun, threads, limit_bytes).map(Box::new);
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
            Background::Accepted { result, jobs_ended, reply } => self.accepted(result, jobs_ended, reply),
            Background::Changed { job, result, reply } => self.changed(job, result, reply),
            Background::RaisedNoted(result) => self.raised_noted(result),
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

    fn opened(&mut self, id: u32, result: Result<Box<Opened>, Unopened>, now_us: u64) {
        self.opening = None;
        // Perhaps ordered while it was opened.
        let end = self.jobs.get(id).and_then(|job| match job.take_up {
            TakeUp::Print(_) => None,
            TakeUp::End(command) => Some(command),
        });
        match result {
            Ok(mut opened) => {
                tracing::info!(job = id, "job begins");
                // Of the device that is there now, not of the job: an interrupted one can go on once it is corrected.
                opened.machine.time_scale = self.setting.machine.time_scale;
                let mut running =
                    Running::new(id, *opened, std::mem::take(&mut self.idle).light, self.background.clone(), now_us);
                if let Some(command) = end {
                    running.command(command, now_us);
                }
                if self.shutting_down {
                    running.engine.handle(Event::Shutdown, now_us);
                }
                self.message = None;
                self.running = Some(running);
                // A new session tells the device's state afresh and numbers requests from 1 for the job's driver.
                self.link.reconnect();
            }
            Err(Unopened { text, state }) => {
                self.notice(format!("job {id} cannot be printed: {text}"));
                if let Some(job) = self.jobs.get_mut(id) {
                    job.end(state, Some(text.clone()));
                }
                self.jobs_ended += 1;
                self.publish_job(id);
                let mut replies = self.take_unwritten(id);
                if let (Some(Command::Abort), JobState::Interrupted) = (end, state) {
                    let reply = replies.pop().unwrap_or_else(|| tokio::sync::oneshot::channel().0);
                    self.change(id, Change::Close, reply);
                }
                for reply in replies {
                    let failed = || CommandError::new(409, format!("job {id} could not be taken up: {text}"));
                    // Whoever asked may have gone.
                    let _ = reply.send(if state.is_final() { self.view(id, None) } else { Err(failed()) });
                }
            }
        }
    }

    /// The running job is over: its memory and the spool's old jobs are given up in the background.
    fn finish(&mut self) {
        self.tell_progress();
        let Some(running) = self.running.take() else { return };
        self.forget_progress();
        let id = running.job;
        let mut again = None;
        if let Some(job) = self.jobs.get_mut(id) {
            job.past.update(&running.engine);
            // An order to end that the device was not there for.
            again = job.past.ordered.filter(|_| job.view.state == JobState::Interrupted && !self.device.connected);
        }
        if running.engine.journal_failed() && self.jobs.get(id).is_some_and(|job| job.view.state.is_final()) {
            self.answer_unwritten(id);
        }
        self.jobs_ended += 1;
        // Of before the job's last moves.
        self.device_state = None;
        if let Some(job) = self.jobs.get(id) {
            job.log_end();
        }
        if let Some(order) = again {
            self.jobs.end_later(id, order);
        }
        self.idle = Idle::after(running.engine.light().clone());
        self.link.reconnect();
        self.releasing = true;
        let (spool, over, background) = (Arc::clone(&self.spool), self.jobs.over(), self.background.clone());
        tokio::spawn(async move {
            running.release().await;
            let tidy = move || spool.lock().unwrap_or_else(PoisonError::into_inner).tidy(&over);
            let forgotten = match tokio::task::spawn_blocking(tidy).await {
                Ok(tidied) => tidied.map_err(|error| error.to_string()),
                Err(panic) => Err(panic.to_string()),
            };
            let _ = background.send(Background::Released { forgotten }).await;
        });
        self.publish();
    }

    /// What was told of the job that runs no more.
    pub(super) fn forget_progress(&mut self) {
        self.message = None;
        self.last_progress = None;
    }

    fn heartbeat(&mut self) {
        notify::alive();
        let now_us = self.clock.now_us();
        if let Some(driver) = self.driver() {
            driver.query_state(now_us);
        }
        self.late_faults();
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
            let exposed = LayerExposed { job: id.to_string(), layer, exposure_ms: progress.light_ms, late_ms };
            let _ = self.desk.events.send(News::Layer(exposed));
        }
        if self.jobs.get_mut(id).is_some_and(|job| job.update(&progress)) {
            self.publish_job(id);
        }
    }

    /// Tells that a job changed.
    pub(super) fn publish_job(&mut self, id: u32) {
        // First: it fills in what a queued job waits for.
        let told = self.publish();
        let Some(job) = self.jobs.get(id) else { return };
        if !told.contains(&id) {
            let _ = self.desk.events.send(News::Job(Box::new(job.view.clone())));
        }
        notify::status(&view::status_line(&job.view));
    }

    /// The job that has the machine, or is about to.
    pub(super) fn holder(&self) -> Option<u32> {
        self.running.as_ref().map(|running| running.job).or(self.opening)
    }

    /// Writes what subscribers and `status` read. Gives the jobs that wait for something else than before, which is told.
    pub(super) fn publish(&mut self) -> Vec<u32> {
        self.look_at_light();
        let told = self.explain_queue();
        for id in &told {
            if let Some(job) = self.jobs.get(*id) {
                let _ = self.desk.events.send(News::Job(Box::new(job.view.clone())));
            }
        }
        let line = view::line(&self.link.statistics(), self.link.hindrance(), self.reconnects, self.link.busy_share());
        let budget = view::budget(&self.budget);
        let (device, jobs, jobs_ended, fit) = (self.device.clone(), self.jobs.views(), self.jobs_ended, self.fit());
        self.desk.snapshot.send_modify(|snapshot| {
            snapshot.line = line;
            snapshot.budget = budget;
            snapshot.device = device;
            snapshot.jobs_ended = jobs_ended;
            snapshot.fit = Some(fit);
            snapshot.jobs = jobs;
        });
        told
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
