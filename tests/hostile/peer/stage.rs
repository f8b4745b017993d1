//! One hostile device, the daemon, and what both say: the bench of a print that goes wrong.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use layerd::api::{Event, LayerExposed};
use layerd::cli::client::Client;
use layerd::link::message::{Request, Urgent};
use serde_json::Value;
use tokio::sync::oneshot;

use super::{Controls, Entry, Peer, Script, Seen, lock, soon};
use crate::support::{Bench, Setup};

/// Commanded light of every layer.
pub const EXPOSURE_MS: u32 = 300;
/// Layer height.
pub const LAYER_UM: i32 = 200;
/// Lift between two layers.
pub const LIFT_UM: i32 = 3_000;
/// `clear_height_um` of the bench's machine: where the plate is parked.
pub const CLEAR_UM: i32 = 30_000;
/// Fast enough that moves take no time worth speaking of.
const PLATE_SPEED_UM_S: u32 = 200_000;
/// Five layers.
const PART: [&str; 8] = ["generate", "bcc", "--struts", "60", "--box", "6,6,1", "-o", "part.layerd"];
/// A busy machine takes its time; what the daemon must do within seconds it once left undone for minutes.
pub const PATIENCE: Duration = Duration::from_secs(40);
/// An act that was on its way when the order to be dark left may still arrive within this time.
const ON_ITS_WAY_MS: u64 = 100;

/// Everything of one print with a hostile device.
pub struct Stage {
    news: News,
    peer: Option<Peer>,
    pub bench: Bench,
}

impl Stage {
    /// A daemon that waits for its device.
    pub fn without_device() -> Self {
        let mut bench = Bench::prepare(Setup {
            layer_height_um: f64::from(LAYER_UM),
            exposure_ms: EXPOSURE_MS,
            plate_speed_um_s: PLATE_SPEED_UM_S,
            time_scale: 1,
            ..Setup::default()
        });
        bench.ok(&PART);
        bench.start_daemon();
        let news = News::listen(bench.path("control.sock"));
        Self { news, peer: None, bench }
    }

    /// A daemon and its device.
    pub fn with(script: Script) -> Self {
        let mut stage = Self::without_device();
        stage.connect(script);
        stage
    }

    /// Switches the device on.
    pub fn connect(&mut self, script: Script) {
        self.peer = Some(Peer::start(&self.bench.path("device"), script));
        let connected = || self.bench.json(&["status"])["link"]["state"] == "connected";
        assert!(soon(PATIENCE, connected), "the device was not greeted");
    }

    /// Kills the daemon and starts another.
    pub fn restart_daemon(&mut self) {
        self.bench.kill_daemon();
        self.bench.start_daemon();
        self.news = News::listen(self.bench.path("control.sock"));
    }

    /// Begins to print the part; the job's number.
    pub fn print(&self) -> u64 {
        self.bench.start_job("part.layerd")
    }

    /// The job once it has ended or waits for the operator.
    pub fn ended(&self, id: u64) -> Value {
        self.wait_for(id, &["completed", "interrupted", "failed", "stopped", "aborted"])
    }

    /// The job once it is in one of these states, which it must be before the test loses patience.
    pub fn wait_for(&self, id: u64, states: &[&str]) -> Value {
        // The news first: asking takes a process each time.
        let is_there = || {
            self.news_of(id).is_some_and(|state| states.contains(&state.as_str()))
                && states.iter().any(|state| self.bench.job(id)["state"] == *state)
        };
        assert!(soon(PATIENCE, is_there), "not {states:?}: {}\n{}", self.bench.job(id), self.story());
        self.bench.job(id)
    }

    /// What was told last of a job's state.
    fn news_of(&self, id: u64) -> Option<String> {
        let id = id.to_string();
        let state = |event: &Event| match event {
            Event::Job(job) if job.id == id => Some(job.state.to_string()),
            Event::Status(status) => {
                let job = status.active.iter().chain(&status.queue).find(|job| job.id == id)?;
                Some(job.state.to_string())
            }
            _ => None,
        };
        lock(&self.news.events).iter().rev().find_map(state)
    }

    /// Lets an interrupted job go on to its end with a layer in doubt, if there is one, taken for `doubt`.
    pub fn complete(&self, job: &Value, doubt: &str) {
        let id = job["id"].as_str().expect("an id").to_owned();
        match job["in_doubt"].is_null() {
            true => self.bench.ok(&["resume", &id]),
            false => self.bench.ok(&["resume", &id, "--in-doubt", doubt]),
        };
        let job = self.ended(id.parse().expect("a number"));
        assert_eq!(job["state"], "completed", "{job}\n{}", self.story());
        self.assert_each_layer_lit_once(&job);
    }

    pub fn assert_each_layer_lit_once(&self, job: &Value) {
        let layers = job["layers_total"].as_u64().expect("layers_total") as u32;
        assert_eq!(self.lit_layers(), (0..layers).collect::<Vec<_>>(), "{}", self.story());
    }

    pub fn control(&self, change: impl FnOnce(&mut Controls)) {
        self.peer().control(change);
    }

    fn peer(&self) -> &Peer {
        self.peer.as_ref().expect("the device is there")
    }

    /// What the device saw.
    pub fn log(&self) -> Vec<Entry> {
        self.peer().log()
    }

    /// What the device saw, for a person.
    pub fn story(&self) -> String {
        let lines = self.log().into_iter().filter(|entry| entry.seen != Seen::Asked(Request::State));
        lines.map(|Entry { at_ms, seen }| format!("{at_ms:6} ms {seen:?}\n")).collect()
    }

    /// Waits until the device has seen this so often.
    pub fn wait_until_seen(&self, what: &str, times: usize, is: impl Fn(&Seen) -> bool) {
        let seen = || self.log().iter().filter(|entry| is(&entry.seen)).count() >= times;
        assert!(soon(PATIENCE, seen), "the device waited in vain for {what}\n{}", self.story());
    }

    /// Layers that had light, in the device's order.
    pub fn lit_layers(&self) -> Vec<u32> {
        let lit = |entry: Entry| if let Seen::Lit(layer) = entry.seen { Some(layer) } else { None };
        self.log().into_iter().filter_map(lit).collect()
    }

    /// Every time with light: from when, and until when.
    pub fn lights_ms(&self) -> Vec<(u64, Option<u64>)> {
        let mut lights = Vec::new();
        for entry in self.log() {
            match (entry.seen, lights.last_mut()) {
                (Seen::Light(true), _) => lights.push((entry.at_ms, None)),
                (Seen::Light(false), Some((_, until @ None))) => *until = Some(entry.at_ms),
                _ => {}
            }
        }
        lights
    }

    /// The longest time with light; light that is still on counts as without end.
    pub fn longest_light_ms(&self) -> u64 {
        let length = |(from, until): (u64, Option<u64>)| until.map_or(u64::MAX, |until| until - from);
        self.lights_ms().into_iter().map(length).max().unwrap_or(0)
    }

    /// Where the plate came to rest.
    pub fn plate_um(&self) -> Option<i32> {
        let arrived =
            |entry: &Entry| if let Seen::Arrived(position_um) = entry.seen { Some(position_um) } else { None };
        self.log().iter().rev().find_map(arrived)
    }

    /// Texts of notices so far.
    pub fn notices(&self) -> Vec<String> {
        let text = |event: &Event| if let Event::Notice { text } = event { Some(text.clone()) } else { None };
        lock(&self.news.events).iter().filter_map(text).collect()
    }

    /// The operator was told something with all these words in one notice, or is told so soon.
    pub fn assert_noticed(&self, words: &[&str]) {
        let has_all = |text: &String| words.iter().all(|word| text.to_lowercase().contains(word));
        let told = || self.notices().iter().any(has_all);
        assert!(soon(Duration::from_secs(5), told), "no notice with {words:?}: {:#?}", self.notices());
    }

    /// News of layers so far.
    pub fn layers(&self) -> Vec<LayerExposed> {
        let layer = |event: &Event| if let Event::Layer(layer) = event { Some(layer.clone()) } else { None };
        lock(&self.news.events).iter().filter_map(layer).collect()
    }

    /// Waits for an order to be dark after `since_ms`; when it came.
    pub fn dark_order_ms(&self, since_ms: u64) -> u64 {
        let order = |entry: &Entry| entry.at_ms >= since_ms && matches!(entry.seen, Seen::Urgent(_, Urgent::LightOff));
        assert!(soon(PATIENCE, || self.log().iter().any(order)), "no order to be dark\n{}", self.story());
        self.log().iter().find(|entry| order(entry)).expect("just seen").at_ms
    }

    /// There is no light any more, or soon there is none.
    pub fn assert_goes_dark(&self) {
        let is_dark = || self.lights_ms().iter().all(|(_, until)| until.is_some());
        assert!(soon(PATIENCE, is_dark), "still lit\n{}", self.story());
    }

    /// Waits until the device has been asked after the last light whether it is dark.
    pub fn wait_until_said_dark(&self) {
        let says_dark = || {
            let log = self.log();
            let lit = log.iter().rposition(|entry| matches!(entry.seen, Seen::Light(true)));
            let asked = |entry: &&Entry| entry.seen == Seen::Asked(Request::State);
            let rest = log[lit.unwrap_or(0)..].iter().skip_while(|entry| entry.seen != Seen::Light(false));
            // The answer to the first may still be on its way.
            rest.filter(asked).count() >= 2
        };
        assert!(soon(PATIENCE, says_dark), "nobody asks\n{}", self.story());
    }

    /// The first entry after the script lied that is so.
    pub fn after_lie(&self, is: impl Fn(&Seen) -> bool) -> Option<Entry> {
        let log = self.log();
        let lie = log.iter().position(|entry| entry.seen == Seen::Lied).expect("the script lied");
        log[lie..].iter().find(|entry| is(&entry.seen)).cloned()
    }

    /// From each order to be dark until the device says that it is, nothing is commanded that moves or shines.
    pub fn assert_nothing_commanded_before_dark(&self) {
        let log = self.log();
        let is_act = |seen: &Seen| matches!(seen, Seen::Asked(Request::Vat(_)));
        for (place, order) in log.iter().enumerate() {
            if !matches!(order.seen, Seen::Urgent(_, Urgent::LightOff)) {
                continue;
            }
            let lit = log[place..].iter().take_while(|entry| entry.seen != Seen::SaidLight(false));
            let acts: Vec<_> =
                lit.filter(|entry| is_act(&entry.seen) && entry.at_ms > order.at_ms + ON_ITS_WAY_MS).collect();
            assert!(acts.is_empty(), "{acts:?}\n{}", self.story());
        }
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        if std::thread::panicking() && self.peer.is_some() {
            eprintln!("--- device\n{}--- notices\n{:#?}", self.story(), self.notices());
        }
    }
}

/// What the daemon tells everybody, from the beginning.
struct News {
    events: Arc<Mutex<Vec<Event>>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl News {
    /// Returns once nothing can be missed.
    fn listen(socket: PathBuf) -> Self {
        let events = Arc::new(Mutex::new(Vec::new()));
        let (stop, stopped) = oneshot::channel();
        let kept = Arc::clone(&events);
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                let listen = async {
                    let mut stream = Client::new(socket).events().await.expect("a stream");
                    // It ends with the daemon.
                    while let Ok(Some(event)) = stream.next().await {
                        lock(&kept).push(event);
                    }
                };
                tokio::select! {
                    () = listen => {}
                    _ = stopped => {}
                }
            });
        });
        assert!(soon(PATIENCE, || !lock(&events).is_empty()), "the first event");
        Self { events, stop: Some(stop), thread: Some(thread) }
    }
}

impl Drop for News {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Tries all cases at a time, each on a stage of its own: most of their time is waiting. A failure names its case.
pub fn side_by_side<T: Sync>(cases: &[(&str, T)], run: impl Fn(&T) + Sync) {
    let run = &run;
    let failed: Vec<_> = std::thread::scope(|scope| {
        let threads = cases.iter().map(|(name, case)| {
            let thread = std::thread::Builder::new().name((*name).to_owned());
            (*name, thread.spawn_scoped(scope, move || run(case)).expect("a thread"))
        });
        // All begin before the first is waited for.
        let threads: Vec<_> = threads.collect();
        threads.into_iter().filter_map(|(name, thread)| thread.join().err().map(|_| name)).collect()
    });
    assert!(failed.is_empty(), "failed: {failed:?}; see above");
}
