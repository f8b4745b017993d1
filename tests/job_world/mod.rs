//! A scripted device, a line, a journal and a clock around a job's engine.
#![allow(dead_code, reason = "each test file uses its part")]

mod device;
mod disturbance;

pub(crate) use device::Lies;
pub(crate) use disturbance::Disturbance;

use std::path::Path;

use layerd::config::Recipe;
use layerd::device::{Act, Passes, VatAct};
use layerd::job::{Action, Engine, Event, JobPlan, JobState, Limits, Process, Record, StartPoint, VatPlan};
use layerd::link::message::{DeviceState, ExposureId, Urgent};

/// One second, microseconds.
pub(crate) const SECOND_US: u64 = 1_000_000;
pub(crate) const KEY: u64 = 7;
pub(crate) const LAYERS: u32 = 5;
pub(crate) const CLEAR_UM: i32 = 20_000;
pub(crate) const MAX_POSITION_UM: i32 = 150_000;

/// The device's limits.
pub(crate) fn limits(max_position_um: i32) -> Limits {
    Limits { max_position_um, max_exposure_ms: 120_000 }
}

pub(crate) fn plan() -> JobPlan {
    let text = "name = \"test\"\nlayer_height_um = 50.0\nexposure_ms = 2000\nbottom_exposure_ms = 20000\nbottom_layers = 1\n\
                transition_layers = 1\nlift_height_um = 5000\nlift_speed_um_s = 1000\nretract_speed_um_s = 3000\n\
                light_off_delay_ms = 500\nwait_before_exposure_ms = 500\nwait_after_exposure_ms = 200\nwait_after_lift_ms = 300\n";
    let Recipe::Dlp(recipe) = Recipe::parse(Path::new("test.toml"), text).expect("a recipe") else {
        panic!("a recipe for a vat machine")
    };
    let process = Process::Vat(VatPlan { recipe, clear_height_um: f64::from(CLEAR_UM) });
    JobPlan { key: KEY, passes: Passes::single(LAYERS), time_scale: 1.0, process }
}

pub(crate) fn accepted() -> Record {
    Record::Accepted { key: KEY, layer_count: LAYERS, name: "cube".into() }
}

/// Engine, device, journal and line, with a clock of their own.
pub(crate) struct World {
    pub(crate) engine: Engine,
    pub(crate) now_us: u64,
    pub(crate) journal: Vec<Record>,
    /// A record being flushed, and until when.
    pub(crate) flushing: Option<(u64, Record)>,
    pub(crate) device: DeviceState,
    /// End of the device's act, and what it comes to.
    pub(crate) device_act: Option<(u64, Act)>,
    /// The act whose outcome the host will hear of.
    pub(crate) awaited: Option<u64>,
    pub(crate) upload: Option<(u64, u32, u8)>,
    pub(crate) upload_us: u64,
    pub(crate) line_up: bool,
    /// Sent without a line; the next session begins with it.
    pub(crate) urgent_waits: Option<Urgent>,
    pub(crate) reconnect_at_us: Option<u64>,
    /// Layers that had their whole light, in order.
    pub(crate) exposed: Vec<u32>,
    pub(crate) acts: Vec<Act>,
    pub(crate) lies: Lies,
    /// The next act's end is not told.
    pub(crate) mute_once: bool,
    /// When its light goes off by itself.
    pub(crate) dark_at_us: Option<u64>,
    /// Urgent orders that reached the device, and when.
    pub(crate) urgents: Vec<(u64, Urgent)>,
    pub(crate) notices: Vec<String>,
    pub(crate) steps: usize,
    pub(crate) disturb_at: Vec<(usize, Disturbance)>,
    pub(crate) aborted: bool,
    pub(crate) journal_full: bool,
    /// How long the line holds an act back before it leaves the host.
    pub(crate) line_holds_us: u64,
    /// An act that the line holds back, and until when.
    pub(crate) held: Option<(u64, u64, Act)>,
    /// How long the disk takes for a record.
    pub(crate) flush_us: u64,
    pub(crate) finished: Option<(JobState, String)>,
}

impl World {
    pub(crate) fn new() -> Self {
        let device = DeviceState { boot_id: 1, slots: vec![None, None], ..DeviceState::default() };
        Self {
            engine: Engine::new(plan(), StartPoint::default()),
            now_us: 0,
            journal: vec![accepted()],
            flushing: None,
            device,
            device_act: None,
            awaited: None,
            upload: None,
            upload_us: 300_000,
            line_up: false,
            urgent_waits: None,
            reconnect_at_us: Some(0),
            exposed: Vec::new(),
            acts: Vec::new(),
            lies: Lies::default(),
            mute_once: false,
            dark_at_us: None,
            urgents: Vec::new(),
            notices: Vec::new(),
            steps: 0,
            disturb_at: Vec::new(),
            aborted: false,
            journal_full: false,
            line_holds_us: 0,
            held: None,
            flush_us: 5000,
            finished: None,
        }
    }

    /// A world whose device's clock, and nothing else, is said to run so much faster.
    pub(crate) fn scaled(time_scale: f64) -> Self {
        let plan = JobPlan { time_scale, ..plan() };
        Self { engine: Engine::new(plan, StartPoint::default()), ..Self::new() }
    }

    pub(crate) fn disturbed(at: Vec<(usize, Disturbance)>) -> Self {
        Self { disturb_at: at, ..Self::new() }
    }

    /// Runs until the engine is done; false if it rests in a pause.
    pub(crate) fn run(&mut self) -> bool {
        self.tell(Event::Ready);
        while self.finished.is_none() {
            if !self.next_event() {
                assert_eq!(self.engine.state(), JobState::Paused, "only a pause may wait for ever");
                return false;
            }
            assert!(self.steps < 3000, "the job does not end: {:?}", self.engine.progress());
        }
        true
    }

    pub(crate) fn tell(&mut self, event: Event) {
        self.engine.handle(event, self.now_us);
        self.carry_out();
        // The daemon asks twice a second; here the engine hears at every moment how the device is.
        if self.line_up && self.finished.is_none() {
            self.engine.handle(Event::State(self.device.clone()), self.now_us);
            self.carry_out();
        }
    }

    pub(crate) fn carry_out(&mut self) {
        while let Some(action) = self.engine.next_action() {
            self.steps += 1;
            match self.disturbance() {
                // Before the action takes effect, or after it.
                Some(disturbance)
                    if self.steps.is_multiple_of(2) && !matches!(disturbance, Disturbance::Standstill { .. }) =>
                {
                    self.disturb(disturbance);
                    if matches!(disturbance, Disturbance::Crash) {
                        return;
                    }
                    self.perform(action);
                }
                Some(disturbance) => {
                    self.perform(action);
                    self.disturb(disturbance);
                }
                None => self.perform(action),
            }
        }
    }

    pub(crate) fn perform(&mut self, action: Action) {
        let may_overtake =
            matches!(action, Action::Urgent(_) | Action::EndSession(_) | Action::NewSession(_) | Action::Notice(_));
        let clears = matches!(action, Action::Act { act: Act::Vat(VatAct::Move { position_um: CLEAR_UM, .. }), .. });
        let waited =
            self.flushing.as_ref().is_none_or(|(until_us, _)| self.now_us + self.flush_us >= until_us + 2_000_000);
        assert!(
            may_overtake || self.flushing.is_none() || (clears && waited),
            "{action:?} before the journal is on disk"
        );
        match action {
            Action::Journal(_) if self.journal_full => {
                self.engine.handle(Event::JournalFailed("no space left".into()), self.now_us);
            }
            Action::Journal(record) => {
                self.flushing = Some((self.now_us + self.flush_us, record));
            }
            Action::Act { number, act } => self.begin_act(number, act),
            Action::QueryState => {
                if self.line_up {
                    self.engine.handle(Event::State(self.device.clone()), self.now_us);
                }
            }
            Action::Upload { exposure: layer, slot } => {
                if self.line_up {
                    assert!(self.upload.is_none(), "one upload at a time");
                    assert!(layer < LAYERS);
                    self.device.slots[usize::from(slot)] = None;
                    self.upload = Some((self.now_us + self.upload_us, layer, slot));
                }
            }
            Action::Urgent(urgent) => self.urgent(urgent),
            Action::EndSession(_) => self.drop_line(100_000),
            Action::NewSession(_) => self.drop_line(1000),
            Action::Finished { state, reason } => self.finished = Some((state, reason)),
            Action::Notice(text) => self.notices.push(text),
            Action::NeedLayers { .. } => {}
        }
    }

    /// Runs until the engine is done.
    pub(crate) fn finish(&mut self) {
        while self.finished.is_none() {
            assert!(self.next_event(), "the job does not end: {:?}", self.engine.progress());
            assert!(self.steps < 3000, "the job does not end: {:?}", self.engine.progress());
        }
    }

    /// Lets time pass to the next thing that happens; false if nothing ever will.
    pub(crate) fn next_event(&mut self) -> bool {
        self.steps += 1;
        if let Some(disturbance) = self.disturbance() {
            self.disturb(disturbance);
            self.carry_out();
            return true;
        }
        let act_us = self.device_act.map(|(at_us, _)| at_us);
        let upload_us = self.upload.map(|(at_us, ..)| at_us);
        let held_us = self.held.map(|(at_us, ..)| at_us);
        let flushed_us = self.flushing.as_ref().map(|(at_us, _)| *at_us);
        let device_us = [act_us, upload_us, held_us, self.dark_at_us];
        let host_us = [flushed_us, self.reconnect_at_us, self.engine.next_timeout_us()];
        let times = device_us.into_iter().chain(host_us);
        let Some(at_us) = times.flatten().min() else {
            return false;
        };
        self.now_us = self.now_us.max(at_us);
        if flushed_us == Some(at_us) {
            self.journal.extend(self.flushing.take().map(|(_, record)| record));
            self.tell(Event::Journalled);
        } else if self.dark_at_us == Some(at_us) {
            self.dark_at_us = None;
            self.device.light_on = false;
            self.device.cut_short = self.device.exposing.take().map(|id| (id, 1));
        } else if held_us == Some(at_us) {
            if let Some((_, number, act)) = self.held.take() {
                self.receive_act(number, act);
                self.carry_out();
            }
        } else if act_us == Some(at_us) {
            self.end_act();
        } else if upload_us == Some(at_us) {
            if let Some((_, layer, slot)) = self.upload.take() {
                self.device.slots[usize::from(slot)] = Some(ExposureId::first_pass(KEY, layer));
                self.tell(Event::Uploaded { exposure: layer, times: None });
            }
        } else if self.reconnect_at_us == Some(at_us) {
            self.reconnect_at_us = None;
            self.line_up = true;
            self.tell(Event::Connected { state: self.device.clone(), limits: limits(MAX_POSITION_UM) });
            if let Some(urgent) = self.urgent_waits.take() {
                self.urgent(urgent);
                self.carry_out();
            }
        } else {
            self.tell(Event::Timeout);
        }
        true
    }

    pub(crate) fn all_exposed_once(&self) -> bool {
        self.exposed == (0..LAYERS).collect::<Vec<_>>()
    }

    pub(crate) fn end(&self) -> (JobState, &str) {
        self.finished.as_ref().map(|(state, reason)| (*state, reason.as_str())).expect("the job ended")
    }
}

/// Runs a print up to its layer `layer` being exposed.
pub(crate) fn world_exposing(layer: u32) -> World {
    let mut world = World::new();
    world.tell(Event::Ready);
    while world.device.exposing != Some(ExposureId::first_pass(KEY, layer)) {
        assert!(world.next_event());
    }
    world
}

/// Steps of an undisturbed print: disturbances fall on each of them.
pub(crate) fn steps_of_a_print() -> usize {
    let mut world = World::new();
    world.run();
    world.steps
}
