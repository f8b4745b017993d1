//! The loop: every event arrives here. Nothing in it waits for a disk, the line or a computation. `start/run.rs` starts it.

use std::time::Duration;

use anyhow::anyhow;
use tokio::sync::watch;
use tokio::time::MissedTickBehavior;

use super::Printer;
use crate::daemon::background::Background;
use crate::daemon::host::clock::Clock;
use crate::daemon::host::notify;
use crate::daemon::machine::running::{Running, Task};
use crate::job::Event;
use crate::pipeline::EncodedLayer;
use crate::stream::Finished;

/// How often statistics are published and the device's state is queried.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// Limit of a shutdown: enough for an exposure of half a minute and a slow lift of 40 mm after it, and less than systemd's
/// TimeoutStopSec of 120 s.
const MAX_SHUTDOWN_US: u64 = 110_000_000;

impl Printer {
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
            if self.shutting_down && self.is_idle() && !self.owes_answers() {
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
                    give_up_us = Some(self.clock.now_us() + MAX_SHUTDOWN_US);
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
                () = room, if self.message.is_some() => self.send_message(),
            }
        };
        if let Some(running) = self.running.take() {
            running.release().await;
        }
        self.link.close().await;
        ended
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
        if self.is_idle() {
            anyhow!("the disk did not take an order in time; the machine is at rest")
        } else if self.running.as_ref().is_some_and(|running| running.engine.is_over()) {
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
            Background::Accepted { result, jobs_ended, reply, under_way: _under_way } => {
                self.accepted(result, jobs_ended, reply);
            }
            Background::Sampled { job, result } => self.sampled(job, result),
            Background::Changed { job, result, reply } => self.changed(job, result, reply),
            Background::ReadAgain { jobs } => self.read_again(jobs),
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
        self.retry_unread();
        self.publish();
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
