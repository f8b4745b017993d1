//! What operators are told, compared with what really happened.

use std::sync::PoisonError;

use layerd::api::Event;
use layerd::daemon::handle::Snapshot;
use layerd::job::JobState;
use layerd::link::message::ExposureId;
use tokio::sync::broadcast::error::TryRecvError;

use super::{PANIC, World};
use crate::host::Host;
use crate::machine::Character;
use crate::operators::number;

impl World {
    /// What the host must never do.
    pub(super) fn check_host(&mut self) {
        let panic = PANIC.take();
        self.check("no panic", panic.is_none(), || panic.unwrap_or_default());
        let access = self.shared.take_loop_access();
        self.check("no disk on the loop", access.is_none(), || {
            format!("the loop itself used the disk: {}", access.unwrap_or_default())
        });
    }

    pub(super) fn look_at_host(&mut self) {
        let answers = std::mem::take(&mut *self.answers.lock().unwrap_or_else(PoisonError::into_inner));
        answers.into_iter().for_each(|given| self.answered(&given));
        let Some(host) = &mut self.host else { return };
        let mut events = Vec::new();
        loop {
            match host.events.try_recv() {
                Ok(event) => events.push(event),
                Err(TryRecvError::Lagged(_)) => {}
                Err(_) => break,
            }
        }
        let ended = host.ended();
        if !events.is_empty() {
            let snapshot = host.handle.snapshot().clone();
            events.iter().for_each(|event| self.told(event));
            self.check_views(&snapshot);
        }
        if let Some(result) = ended {
            self.note(|| format!("host: the daemon has ended: {result:?}"));
            let was_asked = self.host.as_ref().is_some_and(Host::was_asked_to_end);
            self.check("jobs end", was_asked, || format!("the daemon has ended, and nobody asked it to: {result:?}"));
            self.die("ended");
        }
    }

    pub(super) fn told(&mut self, event: &Event) {
        self.note(|| match event {
            Event::Job(job) => {
                format!(
                    "told: job {} {} {}/{} {}",
                    job.id,
                    job.state,
                    job.layers_done,
                    job.layers_total,
                    job.reason.as_deref().unwrap_or("")
                )
            }
            Event::Layer(layer) => format!("told: job {} layer {} exposed", layer.job, layer.layer),
            Event::Link(link) => format!("told: line {} {}", link.state, link.reason.as_deref().unwrap_or("")),
            Event::Notice { text } => format!("told: {text}"),
            event => format!("told: {event:?}"),
        });
        if let Event::Layer(layer) = event
            && self.plan.character == Character::Honest
        {
            let printed = self.printed(layer.job.parse().unwrap_or(0));
            let holds = printed.is_none_or(|printed| printed.has(layer.layer));
            self.check("operators told the truth", holds, || {
                format!("job {}: layer {} is said to be exposed, and it is not", layer.job, layer.layer)
            });
        }
    }

    /// A layer has light: of a job that was paused, it must be the one under way.
    pub(super) fn check_pause(&mut self, id: ExposureId) {
        let Some(job) = self.truth.printed.get(&id.job).map(|printed| printed.job) else { return };
        let Some(pause) = self.promises.pauses.get_mut(&job) else { return };
        pause.lit.insert(id.layer);
        let (at_us, count) = (pause.at_us, pause.lit.len());
        self.check("orders carried out", count == 1, || {
            format!(
                "job {job}: a pause was accepted at {at_us} µs, and {count} layers had light since, the last is {}",
                id.layer
            )
        });
    }

    pub(super) fn check_views(&mut self, snapshot: &Snapshot) {
        for view in &snapshot.jobs {
            // It rests: the pause was carried out, or is not needed any more.
            if !matches!(view.state, JobState::Queued | JobState::Checking | JobState::Printing | JobState::Pausing) {
                self.promises.pauses.remove(&number(view));
            }
        }
        if self.plan.character != Character::Honest {
            return;
        }
        for view in &snapshot.jobs {
            let Some(printed) = self.printed(number(view)).cloned() else { continue };
            if let Some(last) = view.layers_done.checked_sub(1) {
                self.check("operators told the truth", printed.has(last), || {
                    format!(
                        "job {}: {} layers are said to be done, and layer {last} is not exposed",
                        view.id, view.layers_done
                    )
                });
            }
            if view.state == JobState::Completed {
                let missing = printed.missing(self.plan.kind.parts());
                self.check("none left out", missing.is_none(), || {
                    format!("job {} is completed without layer {missing:?}", view.id)
                });
            }
        }
    }
}
