//! What the printer tells: the snapshot that `status` reads, events for subscribers, systemd's line of status.

use super::api::{Event as News, LayerExposed};
use super::printer::Printer;
use super::{notify, view};

impl Printer {
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

    /// Compares what the engine says with what was told last, and tells the difference.
    pub(super) fn tell_progress(&mut self) {
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
