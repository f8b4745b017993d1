//! What `layerctl watch` knows and shows at one moment, and what each key does.

use std::time::Duration;

use ratatui::crossterm::event::KeyCode;
use tokio::time::Instant;

use super::order::{JobThen, Order};
use crate::api::{DeviceView, JobView, Status};
use crate::cli::patience::BY_HAND;
use crate::job::JobState;
use crate::text::short_name;

/// An older reading is not shown as the present: by then three requests in a row had no answer.
const MAX_AGE: Duration = Duration::from_secs(2);

/// How long a note is shown; an older one may no longer be true.
const NOTE_TIME: Duration = Duration::from_secs(10);

/// The daemon's state at one moment.
#[derive(Debug)]
pub(super) struct Reading {
    pub(super) status: Status,
    pub(super) device: DeviceView,
    pub(super) at: Instant,
}

impl Reading {
    fn state_of(&self, id: &str) -> Option<JobState> {
        let Status { active, queue, last, .. } = &self.status;
        active.iter().chain(queue).chain(last).find(|job| job.id == id).map(|job| job.state)
    }
}

/// What is on the screen.
pub(super) struct View {
    pub(super) reading: Reading,
    /// Why there is no newer reading.
    pub(super) silence: Option<String>,
    pub(super) note: String,
    pub(super) noted_at: Instant,
    /// The job the note speaks of, as it was then.
    noted_job: Option<JobThen>,
    pub(super) question: Option<Question>,
}

/// A question that must be answered with `y` before an order is given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Question {
    Abort {
        id: String,
        name: String,
    },
    /// No job holds the machine.
    GoDark,
    Stop {
        id: String,
    },
    PlateEmpty {
        id: String,
        name: String,
    },
}

impl Question {
    /// The question before an abort of the job that holds the machine.
    fn of_abort(active: Option<&JobView>) -> Self {
        active.map_or(Self::GoDark, |JobView { id, name, .. }| Self::Abort { id: id.clone(), name: name.clone() })
    }

    /// The question's text. The question stays with its job, even if that job ends meanwhile.
    pub(super) fn text(&self) -> String {
        match self {
            Self::Abort { id, name } => {
                format!("Abort job {id} now? y aborts it, any other key does not ({})", short_name(name))
            }
            Self::GoDark => "No job holds the machine. Switch the light off anyway? y: yes, any other key: no".into(),
            Self::Stop { id } => format!("End job {id} after this layer, for good? y ends it, any other key does not"),
            // The name comes last: it may be long, and the end is cut off first.
            Self::PlateEmpty { id, name } => format!(
                "Have you looked, and is the plate empty? y confirms it and begins job {id}; any other key does not ({})",
                short_name(name)
            ),
        }
    }

    /// The note if the answer is not `y`.
    fn declined(&self) -> &'static str {
        match self {
            Self::Abort { .. } | Self::GoDark => "not aborted",
            Self::Stop { .. } => "not stopped",
            Self::PlateEmpty { .. } => "not begun",
        }
    }
}

/// News for the screen.
pub(super) enum News {
    Reading(Box<Reading>),
    /// Why the daemon could not be read.
    Silence(String),
    /// The result of an order, and its job.
    Note(String, Option<JobThen>),
}

impl View {
    pub(super) fn new(reading: Reading) -> Self {
        let noted_at = reading.at;
        Self { reading, silence: None, note: String::new(), noted_at, noted_job: None, question: None }
    }

    /// Sets the note.
    pub(super) fn note(&mut self, text: impl Into<String>) {
        (self.note, self.noted_at, self.noted_job) = (text.into(), Instant::now(), None);
    }

    /// The note, while it is young. A note on what to do by hand stays while the daemon does not answer.
    pub(super) fn young_note(&self, now: Instant) -> &str {
        let is_young = now.duration_since(self.noted_at) < NOTE_TIME;
        if is_young || (self.silence.is_some() && self.is_by_hand()) { &self.note } else { "" }
    }

    /// Whether the note says what to do by hand.
    pub(super) fn is_by_hand(&self) -> bool {
        self.note.starts_with(BY_HAND)
    }

    pub(super) fn hear(&mut self, news: News) {
        match news {
            News::Reading(reading) => {
                let changed = self.noted_job.as_ref().is_some_and(|(id, noted)| {
                    let state = reading.state_of(id);
                    // The reading may be older than the note. Then it equals the reading before, and is no change.
                    state != Some(*noted) && state != self.reading.state_of(id)
                });
                if changed || self.silence.is_some() {
                    self.note.clear();
                }
                (self.reading, self.silence) = (*reading, None);
            }
            News::Silence(why) => {
                if self.silence.is_none() && !self.is_by_hand() {
                    self.note.clear();
                }
                self.silence = Some(why);
            }
            News::Note(note, job) => {
                self.note(note);
                self.noted_job = job;
            }
        }
    }

    /// The reading's age, if it is too old to be shown as the present.
    pub(super) fn age(&self, now: Instant) -> Option<Duration> {
        Some(now.duration_since(self.reading.at)).filter(|age| *age > MAX_AGE)
    }

    /// Handles one key; returns the order to give, if any.
    pub(super) fn press(&mut self, key: KeyCode) -> Option<Order> {
        if let Some(question) = self.question.take() {
            if !matches!(key, KeyCode::Char('y' | 'Y')) {
                self.note(question.declined());
                return None;
            }
            return match question {
                // The order would be for a job that took the machine since the question.
                Question::GoDark if self.reading.status.active.is_some() => {
                    self.question = Some(Question::of_abort(self.reading.status.active.as_ref()));
                    None
                }
                Question::GoDark => Some(Order { id: None, order: "abort" }),
                Question::Abort { id, .. } => Some(Order { id: Some(id), order: "abort" }),
                Question::Stop { id } => Some(Order { id: Some(id), order: "stop" }),
                Question::PlateEmpty { id, .. } => Some(Order { id: Some(id), order: "resume" }),
            };
        }
        let active = self.reading.status.active.as_ref().map(|job| job.id.clone());
        let of_abort = Question::of_abort(self.reading.status.active.as_ref());
        let mut ask = |question| {
            self.note.clear();
            self.question = Some(question);
            None
        };
        match (key, active) {
            // Without a job the device is told to go dark all the same.
            (KeyCode::Char('a'), _) => ask(of_abort),
            (KeyCode::Char('s'), Some(id)) => ask(Question::Stop { id }),
            (KeyCode::Char('p'), Some(id)) => Some(Order { id: Some(id), order: "pause" }),
            (KeyCode::Char('r'), Some(id)) => Some(Order { id: Some(id), order: "resume" }),
            (KeyCode::Char('r'), None) if !self.reading.status.queue.is_empty() => {
                let JobView { id, name, .. } = &self.reading.status.queue[0];
                ask(Question::PlateEmpty { id: id.clone(), name: name.clone() })
            }
            (KeyCode::Char('s' | 'p' | 'r'), None) => {
                self.note("no job holds the machine");
                None
            }
            _ => None,
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    const STATUS: &str = r#"{"version": "0.1.0", "machine": "bench",
        "link": {"state": "connected", "path": "/dev/layerd", "device": "sim", "reason": null},
        "active": {"id": "7", "name": "part.layerd", "state": "printing", "recipe": "fine", "layers_done": 3,
            "layers_total": 12, "layer": 3, "eta_s": 95, "late_layers": 2, "late_ms_total": 40, "submitted_ms": 1,
            "started_ms": 2, "ended_ms": null, "reason": null, "in_doubt": null},
        "queue": [{"id": "8", "name": "next.layerd", "state": "queued", "recipe": "fine", "layers_done": 0,
            "layers_total": 5, "layer": null, "eta_s": null, "late_layers": 0, "late_ms_total": 0, "submitted_ms": 1,
            "started_ms": null, "ended_ms": null, "reason": "waits for the end of job 7", "in_doubt": null}],
        "budget": {"limit_bytes": 67108864, "used_bytes": 1048576, "peak_bytes": 2097152},
        "line": {"sent_bytes": 10, "received_bytes": 1, "sent_frames": 4, "retransmitted_frames": 1, "bad_frames": 0,
            "reconnects": 0, "round_trip_ms": null, "busy_share": 0.99}}"#;

    pub(in crate::cli::watch) fn view() -> View {
        let device = r#"{"connected": true, "info": null, "state": {"light_on": true, "position_um": 1250, "moving": false,
            "last_exposed": null, "cut_short": null, "fault": null}}"#;
        View::new(Reading {
            status: serde_json::from_str(STATUS).unwrap(),
            device: serde_json::from_str(device).unwrap(),
            at: Instant::now(),
        })
    }

    fn ordered(id: Option<&str>, order: &'static str) -> Option<Order> {
        Some(Order { id: id.map(Into::into), order })
    }

    #[test]
    fn stop_and_abort_ask_first() {
        for (key, order, declined) in
            [('a', ordered(Some("7"), "abort"), "not aborted"), ('s', ordered(Some("7"), "stop"), "not stopped")]
        {
            let mut view = view();
            assert_eq!(view.press(KeyCode::Char(key)), None);
            // The very key again is no answer: it may be held down.
            assert_eq!(view.press(KeyCode::Char(key)), None);
            assert_eq!((view.question.as_ref(), view.note.as_str()), (None, declined));
            view.press(KeyCode::Char(key));
            let question = view.question.as_ref().unwrap().text();
            assert!(question.contains("job 7 "), "an order that ends a job names it: {question}");
            assert_eq!(view.press(KeyCode::Char('y')), order);
        }
        assert_eq!(view().press(KeyCode::Char('p')), ordered(Some("7"), "pause"));
    }

    #[test]
    fn r_resumes_the_job_at_the_machine_or_asks_whether_the_plate_is_empty() {
        let mut view = view();
        assert_eq!(view.press(KeyCode::Char('r')), ordered(Some("7"), "resume"));
        view.reading.status.active = None;
        assert_eq!(view.press(KeyCode::Char('r')), None);
        let question = view.question.as_ref().unwrap().text();
        assert!(
            question.contains("is the plate empty")
                && question.ends_with("begins job 8; any other key does not (next.layerd)"),
            "{question}"
        );
        assert_eq!(view.press(KeyCode::Char('r')), None);
        assert_eq!(view.note, "not begun");
        view.press(KeyCode::Char('r'));
        assert_eq!(view.press(KeyCode::Char('y')), ordered(Some("8"), "resume"));
        view.reading.status.queue.clear();
        assert_eq!((view.press(KeyCode::Char('r')), view.note.as_str()), (None, "no job holds the machine"));
    }

    #[test]
    fn a_question_stays_with_its_job() {
        let mut view = view();
        view.press(KeyCode::Char('a'));
        // Job 7 ends, and job 8 takes the machine.
        let next = view.reading.status.queue.remove(0);
        view.reading.status.active = Some(next);
        assert!(view.question.as_ref().unwrap().text().starts_with("Abort job 7 now?"));
        assert_eq!(view.press(KeyCode::Char('y')), ordered(Some("7"), "abort"));
        // Without a job: a job that takes the machine is asked about by its number first.
        let next = view.reading.status.active.take();
        view.press(KeyCode::Char('a'));
        view.reading.status.active = next;
        assert_eq!(view.press(KeyCode::Char('y')), None);
        assert!(view.question.as_ref().unwrap().text().starts_with("Abort job 8 now?"));
        assert_eq!(view.press(KeyCode::Char('y')), ordered(Some("8"), "abort"));
    }

    #[test]
    fn without_a_job_an_abort_is_ordered_all_the_same() {
        let mut view = view();
        view.reading.status.active = None;
        assert_eq!(view.press(KeyCode::Char('a')), None);
        let question = view.question.as_ref().unwrap().text();
        assert!(question.starts_with("No job holds the machine"), "{question}");
        assert_eq!(view.press(KeyCode::Char('y')), ordered(None, "abort"));
    }

    #[test]
    fn a_note_goes_when_its_job_changes_or_the_daemon_is_lost_or_back() {
        let reading = |state| {
            let mut reading = self::view().reading;
            if let Some(job) = &mut reading.status.active {
                job.state = state;
            }
            News::Reading(Box::new(reading))
        };
        let mut view = view();
        view.hear(News::Note("job 7 pauses".into(), Some(("7".into(), JobState::Pausing))));
        // Asked before the order was given.
        view.hear(reading(JobState::Printing));
        view.hear(reading(JobState::Pausing));
        view.hear(reading(JobState::Pausing));
        assert_eq!(view.note, "job 7 pauses");
        view.hear(reading(JobState::Paused));
        assert_eq!(view.note, "");
        view.note("not stopped");
        view.hear(News::Silence("no layerd answers".into()));
        assert_eq!(view.note, "");
        view.hear(News::Note(format!("{BY_HAND}: no layerd answers"), None));
        view.hear(News::Silence("no layerd answers".into()));
        assert!(view.young_note(view.noted_at + Duration::from_secs(40)).starts_with(BY_HAND));
        view.hear(reading(JobState::Paused));
        assert_eq!(view.note, "");
    }

    #[test]
    fn a_reading_is_the_present_only_while_it_is_young() {
        let mut view = view();
        let read_at = view.reading.at;
        assert_eq!(view.age(read_at + Duration::from_millis(1900)), None);
        assert_eq!(view.age(read_at + Duration::from_secs(14)), Some(Duration::from_secs(14)));
        view.hear(News::Silence("no layerd answers".into()));
        assert!(view.silence.is_some());
        view.hear(News::Reading(Box::new(self::view().reading)));
        assert!(view.silence.is_none());
        view.note("paused");
        let noted_at = view.noted_at;
        assert_eq!(view.young_note(noted_at + Duration::from_secs(9)), "paused");
        assert_eq!(view.young_note(noted_at + Duration::from_secs(10)), "", "what is old may be true no more");
    }
}
