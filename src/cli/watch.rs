//! `layerctl watch`: the print in a terminal. `screen` draws it.

mod screen;

use std::io::IsTerminal;
use std::time::Duration;

use anyhow::bail;
use clap::Args;
use ratatui::crossterm::event::{self, Event as Input, KeyCode, KeyEventKind, KeyModifiers};
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout};

use super::client::{Client, ClientError, start_text};
use super::commands::{absence, answer};
use super::patience::BY_HAND;
use super::{block_on, print_json};
use crate::daemon::api::{DeviceView, JobView, ResumeBody, Status};
use crate::job::JobState;
use crate::text::short_name;

/// What is not read within this time is asked for anew.
const ANSWER_LIMIT: Duration = Duration::from_secs(1);
/// How often the daemon is asked; people read no faster.
const ASK_INTERVAL: Duration = Duration::from_millis(500);
/// How often keys are looked for.
const KEY_INTERVAL: Duration = Duration::from_millis(50);
/// Readings and answers that may wait for the screen; it takes them 20 times a second.
const WAITING_NEWS: usize = 16;
/// What is older is not shown as if it were so now: three questions in a row had no answer.
const LARGEST_AGE: Duration = Duration::from_secs(2);

/// What was noted is shown for so long: what is older may be true no more.
const NOTE_TIME: Duration = Duration::from_secs(10);

/// Follow the print in the terminal; keys pause, resume, stop and abort it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl watch
  layerctl watch --json        every event as a line of JSON, for programs

Keys: p pause, r resume, s stop after this layer, a abort, q leave; the print goes on without you. The keys s and a ask first, and so \
does r where a job waits until you confirm that the plate is empty.

The first line shows light and plate, even where there is little room. While the daemon does not answer, everything is grey, and the \
first line says how old it is.")]
pub(super) struct WatchArgs {
    /// Print every event of the daemon as one JSON object a line, until it ends.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &WatchArgs) -> anyhow::Result<()> {
    let client = Client::from_environment();
    if args.json {
        return block_on(print_events(client));
    }
    if !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        bail!("watch needs a terminal; without one use `layerctl status` or `layerctl watch --json`");
    }
    block_on(async {
        // Asked once before the screen is taken: an error stays readable.
        let view = View::new(read(&client).await?);
        let mut terminal = ratatui::try_init()?;
        let ended = follow(&client, &mut terminal, view).await;
        ratatui::restore();
        ended
    })
}

async fn print_events(client: Client) -> anyhow::Result<()> {
    let mut events = client.events().await?;
    while let Some(event) = events.next().await? {
        print_json(&event)?;
    }
    Ok(())
}

/// What the daemon said at one moment.
#[derive(Debug)]
struct Reading {
    status: Status,
    device: DeviceView,
    at: Instant,
}

impl Reading {
    fn state_of(&self, id: &str) -> Option<JobState> {
        let Status { active, queue, last, .. } = &self.status;
        active.iter().chain(queue).chain(last).find(|job| job.id == id).map(|job| job.state)
    }
}

async fn read(client: &Client) -> Result<Reading, ClientError> {
    let (status, device) = (client.status().await?, client.get("/v1/device").await?);
    Ok(Reading { status, device, at: Instant::now() })
}

/// What is on the screen.
struct View {
    reading: Reading,
    /// Why there is no newer reading.
    silence: Option<String>,
    note: String,
    noted_at: Instant,
    /// The job the note speaks of, as it was then.
    noted_job: Option<JobThen>,
    question: Option<Question>,
}

/// A job's id and state at one moment.
type JobThen = (String, JobState);

/// What must be answered with `y` before it is done.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Question {
    Abort,
    Stop { id: String },
    PlateEmpty { id: String, name: String },
}

impl Question {
    /// The question; an abort is for the job that holds the machine, whichever that is when it is given.
    fn text(&self, status: &Status) -> String {
        match self {
            Self::Abort => match &status.active {
                Some(JobView { id, name, .. }) => {
                    format!("Abort job {id} now? y aborts it, any other key does not ({})", short_name(name))
                }
                None => {
                    "No job holds the machine. Put the light off all the same? y does, any other key does not".into()
                }
            },
            Self::Stop { id } => format!("End job {id} after this layer, for good? y ends it, any other key does not"),
            // The name is at the end: it may be long, and the end is cut off first.
            Self::PlateEmpty { id, name } => format!(
                "Have you looked, and is the plate empty? y confirms it and begins job {id}; any other key does not ({})",
                short_name(name)
            ),
        }
    }

    /// What is noted where the answer is not `y`.
    fn declined(&self) -> &'static str {
        match self {
            Self::Abort => "not aborted",
            Self::Stop { .. } => "not stopped",
            Self::PlateEmpty { .. } => "not begun",
        }
    }
}

/// What comes to the screen from the daemon.
enum News {
    Reading(Box<Reading>),
    /// Why none could be had.
    Silence(String),
    /// What became of an order, and of which job.
    Note(String, Option<JobThen>),
}

impl View {
    fn new(reading: Reading) -> Self {
        let noted_at = reading.at;
        Self { reading, silence: None, note: String::new(), noted_at, noted_job: None, question: None }
    }

    /// Notes what became of a key.
    fn note(&mut self, text: impl Into<String>) {
        (self.note, self.noted_at, self.noted_job) = (text.into(), Instant::now(), None);
    }

    /// The note, while it is young. What to do by hand stays while the daemon does not answer.
    fn young_note(&self, now: Instant) -> &str {
        let is_young = now.duration_since(self.noted_at) < NOTE_TIME;
        if is_young || (self.silence.is_some() && self.is_by_hand()) { &self.note } else { "" }
    }

    /// Whether the note says what to do by hand.
    fn is_by_hand(&self) -> bool {
        self.note.starts_with(BY_HAND)
    }

    fn hear(&mut self, news: News) {
        match news {
            News::Reading(reading) => {
                let changed = self.noted_job.as_ref().is_some_and(|(id, noted)| {
                    let state = reading.state_of(id);
                    // A reading may be older than the note: then nothing has changed between two of them.
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

    /// How old the reading is, where that is too old to be shown as the present.
    fn age(&self, now: Instant) -> Option<Duration> {
        Some(now.duration_since(self.reading.at)).filter(|age| *age > LARGEST_AGE)
    }

    /// One key; gives the order to carry out.
    fn press(&mut self, key: KeyCode) -> Option<Order> {
        if let Some(question) = self.question.take() {
            if !matches!(key, KeyCode::Char('y' | 'Y')) {
                self.note(question.declined());
                return None;
            }
            return Some(match question {
                Question::Abort => Order { id: None, order: "abort" },
                Question::Stop { id } => Order { id: Some(id), order: "stop" },
                Question::PlateEmpty { id, .. } => Order { id: Some(id), order: "resume" },
            });
        }
        let active = self.reading.status.active.as_ref().map(|job| job.id.clone());
        let mut ask = |question| {
            self.note.clear();
            self.question = Some(question);
            None
        };
        match (key, active) {
            // Without a job the device is told to go dark all the same.
            (KeyCode::Char('a'), _) => ask(Question::Abort),
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

/// An order to a job; without an id to the one that holds the machine.
#[derive(Debug, PartialEq, Eq)]
struct Order {
    id: Option<String>,
    order: &'static str,
}

impl Order {
    /// Gives it and says what became of it.
    async fn give(self, client: &Client) -> (String, Option<JobThen>) {
        let given = match (self.id, self.order) {
            (None, _) => client.abort_active().await,
            (Some(id), "resume") => client.resume(&id, ResumeBody::default()).await,
            (Some(id), order) => client.order(&id, order).await,
        };
        match given {
            Ok(job) => {
                let absence = absence(client, &job).await;
                (taken(self.order, &job, absence.as_deref()), Some((job.id, job.state)))
            }
            Err(error) => (not_taken(self.order, &error), None),
        }
    }
}

/// What became of an order that was taken, and what went wrong although it is carried out.
fn taken(order: &str, job: &JobView, absence: Option<&str>) -> String {
    let answer = answer(order, job, absence);
    job.warning.as_ref().map_or_else(|| answer.clone(), |warning| format!("{answer}. WARNING: {warning}"))
}

/// Why an order was not taken, in few words: there may be little room. Where nobody took an abort, with what to do by hand first.
fn not_taken(order: &str, error: &ClientError) -> String {
    let why = match error {
        ClientError::Refused { status: 404 | 409, .. } => return error.to_string(),
        ClientError::Silent { waited_s, .. } => {
            format!("layerd did not answer within {waited_s} s; it may still carry the order out if it goes on")
        }
        ClientError::NoDaemon { .. } => "no layerd answers, so the order was not given".into(),
        error => error.to_string(),
    };
    if order == "abort" { format!("{BY_HAND}: {why}") } else { why }
}

/// Asks the daemon again and again; ends with the screen.
async fn ask(client: Client, news: mpsc::Sender<News>) {
    loop {
        let heard = match timeout(ANSWER_LIMIT, read(&client)).await {
            Ok(Ok(reading)) => News::Reading(Box::new(reading)),
            // Without the socket's path, for which there may be no room.
            Ok(Err(ClientError::NoDaemon { socket, .. })) => {
                News::Silence(format!("no layerd answers: {}", start_text(&socket)))
            }
            Ok(Err(error)) => News::Silence(error.to_string()),
            Err(_) => News::Silence("the daemon does not answer".into()),
        };
        if news.send(heard).await.is_err() {
            return;
        }
        tokio::time::sleep(ASK_INTERVAL).await;
    }
}

async fn follow(client: &Client, terminal: &mut ratatui::DefaultTerminal, mut view: View) -> anyhow::Result<()> {
    let (sender, mut news) = mpsc::channel(WAITING_NEWS);
    let notes = sender.clone();
    // Nothing may be written over the screen; a full queue has something newer to say.
    let client = client.clone().telling(move |text| drop(notes.try_send(News::Note(text.into(), None))));
    // Questions and orders run beside the screen: a daemon that does not answer must not keep the keys from working.
    tokio::spawn(ask(client.clone().telling(|_| {}), sender.clone()));
    loop {
        while let Ok(heard) = news.try_recv() {
            view.hear(heard);
        }
        terminal.draw(|frame| screen::draw(frame, &view, Instant::now()))?;
        tokio::time::sleep(KEY_INTERVAL).await;
        while event::poll(Duration::ZERO)? {
            let Input::Key(key) = event::read()? else { continue };
            if key.kind != KeyEventKind::Press {
                continue;
            }
            let interrupt = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            if interrupt || (key.code == KeyCode::Char('q') && view.question.is_none()) {
                return Ok(());
            }
            if let Some(order) = view.press(key.code) {
                view.note(format!("{} ordered", order.order));
                let (client, sender) = (client.clone(), sender.clone());
                tokio::spawn(async move {
                    // Without a receiver the screen has ended.
                    let (text, job) = order.give(&client).await;
                    let _ = sender.send(News::Note(text, job)).await;
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) const STATUS: &str = r#"{"version": "0.1.0", "machine": "bench",
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

    pub(super) fn view() -> View {
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
    fn an_order_that_is_not_on_disk_says_so() {
        let mut job = view().reading.status.active.unwrap();
        job.state = JobState::Aborting;
        assert!(!taken("abort", &job, None).contains("WARNING"));
        job.warning = Some("the order is carried out, but its record could not be written".into());
        let text = taken("abort", &job, None);
        assert!(
            text.contains("job 7 (part.layerd) is being aborted") && text.contains("WARNING: the order is carried out"),
            "{text}"
        );
    }

    #[test]
    fn stop_and_abort_ask_first() {
        for (key, order, declined) in
            [('a', ordered(None, "abort"), "not aborted"), ('s', ordered(Some("7"), "stop"), "not stopped")]
        {
            let mut view = view();
            assert_eq!(view.press(KeyCode::Char(key)), None);
            // The very key again is no answer: it may be held down.
            assert_eq!(view.press(KeyCode::Char(key)), None);
            assert_eq!((view.question.as_ref(), view.note.as_str()), (None, declined));
            view.press(KeyCode::Char(key));
            let question = view.question.as_ref().unwrap().text(&view.reading.status);
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
        let question = view.question.as_ref().unwrap().text(&view.reading.status);
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

    #[tokio::test]
    async fn an_abort_that_nobody_takes_says_what_to_do_by_hand() {
        let client = Client::new("/nonexistent/control.sock");
        let (told, _) = Order { id: None, order: "abort" }.give(&client).await;
        assert!(told.starts_with(BY_HAND) && !told.contains("control.sock"), "{told}");
        assert!(
            told.starts_with("If there is light or the plate moves, switch the printer off at the mains"),
            "{told}"
        );
    }

    #[test]
    fn without_a_job_an_abort_is_ordered_all_the_same() {
        let mut view = view();
        view.reading.status.active = None;
        assert_eq!(view.press(KeyCode::Char('a')), None);
        let question = view.question.as_ref().unwrap().text(&view.reading.status);
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
