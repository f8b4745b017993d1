//! What the printer publishes: the snapshot for status requests, events for subscribers, the status line for systemd.
//! `tests/control_api/events.rs` reads it.

use super::Printer;
use crate::api::{Event as News, JobView, LayerExposed};
use crate::daemon::host::notify;
use crate::daemon::machine::view;

/// What to do about a job that the end of the daemon interrupts, until the daemon has ended.
pub(crate) const RESUME_LATER: &str = "the daemon is stopping; resume once it runs again";

impl Printer {
    /// Sends the operator a notice of something to look at; logged as a warning.
    pub(crate) fn notice(&self, text: String) {
        tracing::warn!("{text}");
        let _ = self.desk.events.send(News::Notice { text });
    }

    /// Sends the operator a notice of something that went well.
    pub(crate) fn tell(&self, text: String) {
        tracing::info!("{text}");
        let _ = self.desk.events.send(News::Notice { text });
    }

    /// A job as operators see it. A daemon that is ending refuses `resume`, so it must not advise it.
    pub(crate) fn shown(&self, job: JobView) -> JobView {
        let advises = job.reason.as_ref().is_some_and(|reason| reason.contains("`layerctl resume"));
        if self.shutting_down && advises && !job.state.is_final() {
            return JobView { reason: Some(RESUME_LATER.into()), ..job };
        }
        job
    }

    /// Publishes what changed in the engine's progress since the last call.
    pub(crate) fn tell_progress(&mut self) {
        let Some(running) = &self.running else { return };
        let (id, progress) = (running.job, running.engine.progress());
        let before = self.last_progress.replace(progress.clone());
        if let Some(before) = before.filter(|before| before.exposures_done < progress.exposures_done) {
            let late_ms = progress.late_ms_total - before.late_ms_total;
            if let Some(job) = self.jobs.get(id) {
                let (passes, done) = (&job.past.passes, progress.exposures_done - 1);
                let exposed = LayerExposed {
                    job: id.to_string(),
                    layer: passes.at(done).layer,
                    material: passes.material(done).map(str::to_owned),
                    exposure_ms: progress.light_ms,
                    late_ms,
                };
                let _ = self.desk.events.send(News::Layer(exposed));
            }
        }
        if self.jobs.get_mut(id).is_some_and(|job| job.update(&progress)) {
            self.publish_job(id);
        }
    }

    /// Publishes a job that changed.
    pub(crate) fn publish_job(&mut self, id: u32) {
        // First, as it updates what a queued job waits for.
        let told = self.publish();
        let Some(job) = self.jobs.get(id) else { return };
        if !told.contains(&id) {
            let _ = self.desk.events.send(News::Job(Box::new(self.shown(job.view.clone()))));
        }
        notify::status(&view::status_line(&job.view));
    }

    /// Updates the snapshot, and sends an event for each queued job whose reason to wait changed. Returns these jobs.
    pub(crate) fn publish(&mut self) -> Vec<u32> {
        self.look_at_light();
        let told = self.explain_queue();
        for id in &told {
            if let Some(job) = self.jobs.get(*id) {
                let _ = self.desk.events.send(News::Job(Box::new(self.shown(job.view.clone()))));
            }
        }
        let line = view::line(&self.link.statistics(), self.link.hindrance(), self.reconnects, self.link.busy_share());
        let budget = view::budget(&self.budget);
        let (device, jobs, jobs_ended, fit) = (
            self.device.clone(),
            self.jobs.views().into_iter().map(|job| self.shown(job)).collect(),
            self.jobs_ended,
            self.fit(),
        );
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
