//! A scripted device, a line, a journal and a clock around a job's engine.
#![allow(dead_code, reason = "each test file uses its part")]

use std::path::Path;

use layerd::config::Recipe;
use layerd::device::{Act, Outcome};
use layerd::job::{
    Action, Command, EndOrder, Engine, Event, History, JobPlan, JobState, Record, ResumeChoice, StartPoint,
};
use layerd::link::message::{DeviceState, ExposureId, Refusal, Urgent};

pub(crate) const KEY: u64 = 7;
pub(crate) const LAYERS: u32 = 5;
pub(crate) const CLEAR_UM: i32 = 20_000;
pub(crate) const MAX_POSITION_UM: i32 = 150_000;

pub(crate) fn plan() -> JobPlan {
    let text = "name = \"test\"\nlayer_height_um = 50.0\nexposure_ms = 2000\nbottom_exposure_ms = 20000\nbottom_layers = 1\n\
                transition_layers = 1\nlift_height_um = 5000\nlift_speed_um_s = 1000\nretract_speed_um_s = 3000\n\
                light_off_delay_ms = 500\nwait_before_exposure_ms = 500\nwait_after_exposure_ms = 200\nwait_after_lift_ms = 300\n";
    let Recipe::Dlp(recipe) = Recipe::parse(Path::new("test.toml"), text).expect("a recipe");
    JobPlan { key: KEY, layer_count: LAYERS, recipe, clear_height_um: f64::from(CLEAR_UM), time_scale: 1.0 }
}

pub(crate) fn accepted() -> Record {
    Record::Accepted { key: KEY, layer_count: LAYERS, name: "cube".into() }
}

/// What happens to the world at a given step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Disturbance {
    /// The line is down for this long.
    LineLost {
        for_us: u64,
    },
    /// The host dies; the daemon starts again and resumes.
    Crash,
    Order(Command),
    Shutdown,
    /// The device does its next act, or the one under way, and says nothing of it.
    Mute,
    /// The host stands still for this long; its timers are the first to run after that.
    Standstill {
        for_us: u64,
    },
}

/// What the device does otherwise than it was told.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lies {
    /// Exposures are reported with this time, milliseconds.
    pub(crate) light_ms: Option<u32>,
    /// Where a move to this height ends, micrometres.
    pub(crate) misplaced: Option<(i32, i32)>,
    /// Its light goes on only by itself, and off by nobody's order.
    pub(crate) stays_lit: bool,
    /// It tells of no act that it is done.
    pub(crate) mute: bool,
    /// It takes no act at all.
    pub(crate) deaf: bool,
    /// It says that it is done after a tenth of the time.
    pub(crate) hasty: bool,
    /// So many aborts, one a session, it neither obeys nor answers.
    pub(crate) unheard_aborts: u32,
    /// It answers aborts with its light on, and does nothing else; a light-off it obeys.
    pub(crate) deaf_to_aborts: bool,
    /// It obeys an abort, answers with its light on, and is dark after this time.
    pub(crate) dark_after_us: Option<u64>,
    /// It exposes this layer and then says that it refused it, for this reason; with `true` its state names the layer as cut short,
    /// and never as being exposed.
    pub(crate) refuses_lit: Option<(u32, Refusal, bool)>,
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

    pub(crate) fn disturbance(&mut self) -> Option<Disturbance> {
        let place = self.disturb_at.iter().position(|(step, _)| *step <= self.steps)?;
        Some(self.disturb_at.remove(place).1)
    }

    pub(crate) fn disturb(&mut self, disturbance: Disturbance) {
        match disturbance {
            Disturbance::LineLost { for_us } => {
                self.drop_line(for_us);
                self.engine.handle(Event::LineLost("cable".into()), self.now_us);
            }
            Disturbance::Crash => self.crash(),
            Disturbance::Order(command) => {
                self.engine.handle(Event::Command(command), self.now_us);
                if command == Command::Abort {
                    self.aborted = true;
                    let action = self.engine.next_action();
                    assert_eq!(action, Some(Action::Urgent(Urgent::Abort)), "light off before anything else");
                    self.perform(Action::Urgent(Urgent::Abort));
                }
            }
            Disturbance::Shutdown => self.engine.handle(Event::Shutdown, self.now_us),
            Disturbance::Mute => self.mute_once = true,
            Disturbance::Standstill { for_us } => {
                self.now_us += for_us;
                let is_over = self.device_act.is_some_and(|(at_us, _)| at_us <= self.now_us);
                let unread = if is_over { self.end_device_act() } else { None };
                self.engine.handle(Event::Timeout, self.now_us);
                if let Some(event) = unread {
                    self.engine.handle(event, self.now_us);
                }
            }
        }
    }

    pub(crate) fn drop_line(&mut self, for_us: u64) {
        self.line_up = false;
        self.awaited = None;
        self.upload = None;
        self.reconnect_at_us = Some(self.now_us + for_us);
    }

    /// A new engine from what the journal says.
    pub(crate) fn crash(&mut self) {
        let history = History::replay(&self.journal).expect("the journal is true at every moment");
        // As the daemon does: what was ordered to end is taken up for that alone.
        let (start, end) = match history.ordered {
            Some(EndOrder::Stop) => (history.start_to_end().ok(), Some(Command::Stop)),
            Some(EndOrder::Abort) => (history.start_to_end().ok(), Some(Command::Abort)),
            None => (history.start(ResumeChoice::None).ok(), None),
        };
        let Some(start) = start else {
            self.finished = Some((history.state, history.reason));
            return;
        };
        self.drop_line(2_000_000);
        self.flushing = None;
        self.engine = Engine::new(plan(), start);
        self.finished = None;
        self.tell(Event::Ready);
        if let Some(command) = end {
            self.tell(Event::Command(command));
        }
    }

    pub(crate) fn perform(&mut self, action: Action) {
        let may_overtake =
            matches!(action, Action::Urgent(_) | Action::EndSession(_) | Action::NewSession(_) | Action::Notice(_));
        let clears = matches!(action, Action::Act { act: Act::Move { position_um: CLEAR_UM, .. }, .. });
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
            Action::Upload { layer, slot } => {
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

    pub(crate) fn begin_act(&mut self, number: u64, act: Act) {
        self.acts.push(act);
        if !self.line_up || self.lies.deaf {
            return;
        }
        assert!(self.awaited.is_none() && self.device_act.is_none(), "two acts at once: {act:?}");
        let position_um = self.device.position_um.unwrap_or(0);
        let duration_us = match act {
            Act::Home => {
                assert!(self.exposed.is_empty(), "homing with a part on the plate");
                3_000_000
            }
            Act::Move { position_um: to_um, speed_um_s } => {
                assert!((0..=MAX_POSITION_UM).contains(&to_um));
                u64::from(to_um.abs_diff(position_um)) * 1_000_000 / u64::from(speed_um_s)
            }
            Act::Expose { layer, duration_ms, .. } => {
                assert!(!self.aborted, "light after an abort");
                let commanded = self
                    .journal
                    .iter()
                    .rev()
                    .find(|r| !matches!(r, Record::Paused | Record::Resumed | Record::Ordered(_)));
                assert!(matches!(commanded, Some(Record::Commanded { layer: l, .. }) if *l == layer), "{commanded:?}");
                let (at_um, target_um) = (self.device.position_um, 50 * (layer as i32 + 1));
                assert!(at_um.is_some_and(|at_um| at_um.abs_diff(target_um) <= 25), "layer {layer} at {at_um:?} µm");
                assert_eq!(duration_ms, [20_000, 11_000, 2000, 2000, 2000][layer as usize]);
                self.awaited = Some(number);
                let id = ExposureId::first_pass(KEY, layer);
                if self.device.last_exposed.is_some_and(|last| last.job == KEY && last.layer >= layer) {
                    return self.answer(number, Outcome::Refused(Refusal::AlreadyExposed));
                }
                assert!(self.device.slots.contains(&Some(id)), "layer {layer} is not on the device");
                let hidden = self.lies.refuses_lit.is_some_and(|(lied, _, hidden)| hidden && lied == layer);
                self.device.exposing = Some(id).filter(|_| !hidden);
                self.device.light_on = !hidden;
                u64::from(duration_ms) * 1000
            }
        };
        self.device.moving = !matches!(act, Act::Expose { .. });
        assert!(!self.device.moving || !self.device.light_on, "a move under light: {act:?}");
        self.awaited = Some(number);
        let duration_us = if self.lies.hasty { duration_us / 10 } else { duration_us };
        self.device_act = Some((self.now_us + duration_us, act));
        self.engine.handle(Event::ActTaken { number }, self.now_us);
    }

    pub(crate) fn answer(&mut self, number: u64, outcome: Outcome) {
        self.awaited = None;
        self.engine.handle(Event::ActDone { number, outcome }, self.now_us);
    }

    pub(crate) fn urgent(&mut self, urgent: Urgent) {
        if !self.line_up {
            self.urgent_waits = Some(urgent);
            return;
        }
        self.urgents.push((self.now_us, urgent));
        if urgent == Urgent::Abort && self.lies.unheard_aborts > 0 {
            self.lies.unheard_aborts -= 1;
            // The host repeats it, and the device knows its number until the next session.
            self.urgent_waits = Some(urgent);
            return;
        }
        if self.urgent_waits == Some(Urgent::Abort) && urgent == Urgent::LightOff {
            return;
        }
        if urgent == Urgent::Abort
            && self.device.light_on
            && let Some(after_us) = self.lies.dark_after_us
        {
            (self.dark_at_us, self.device_act) = (Some(self.now_us + after_us), None);
            return self.engine.handle(Event::UrgentFailed(urgent), self.now_us);
        }
        if urgent == Urgent::Abort && self.lies.deaf_to_aborts && self.device.light_on {
            return self.engine.handle(Event::UrgentFailed(urgent), self.now_us);
        }
        if self.lies.stays_lit {
            return self.engine.handle(Event::UrgentFailed(urgent), self.now_us);
        }
        self.device.light_on = false;
        if let Some(id) = self.device.exposing.take() {
            self.device.cut_short = Some((id, 1));
            let cut = self.device_act.take_if(|(_, act)| matches!(act, Act::Expose { .. }));
            if let (Some(_), Urgent::LightOff, Some(number)) = (cut, urgent, self.awaited) {
                self.answer(number, Outcome::Refused(Refusal::CutShort));
            }
        }
        self.engine.handle(Event::UrgentDone(urgent), self.now_us);
        if urgent == Urgent::Abort {
            self.device.moving = false;
            self.device_act = None;
            self.device.slots = vec![None, None];
            self.drop_line(500_000);
            self.engine.handle(Event::LineLost("aborted".into()), self.now_us);
        }
    }

    /// Runs until the engine is done.
    pub(crate) fn finish(&mut self) {
        while self.finished.is_none() {
            assert!(self.next_event(), "the job does not end: {:?}", self.engine.progress());
            assert!(self.steps < 3000, "the job does not end: {:?}", self.engine.progress());
        }
    }

    /// Goes on after an end that can be resumed, with a device that is honest again.
    pub(crate) fn resume(&mut self, choice: ResumeChoice) {
        self.lies = Lies::default();
        let history = History::replay(&self.journal).expect("the journal is true");
        self.engine = Engine::new(plan(), history.start(choice).expect("resumable"));
        self.finished = None;
        self.drop_line(100_000);
        self.tell(Event::Ready);
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
        let flushed_us = self.flushing.as_ref().map(|(at_us, _)| *at_us);
        let times =
            [flushed_us, act_us, upload_us, self.reconnect_at_us, self.dark_at_us, self.engine.next_timeout_us()];
        let Some(at_us) = times.iter().flatten().min().copied() else {
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
        } else if act_us == Some(at_us) {
            self.end_act();
        } else if upload_us == Some(at_us) {
            if let Some((_, layer, slot)) = self.upload.take() {
                self.device.slots[usize::from(slot)] = Some(ExposureId::first_pass(KEY, layer));
                self.tell(Event::Uploaded { layer });
            }
        } else if self.reconnect_at_us == Some(at_us) {
            self.reconnect_at_us = None;
            self.line_up = true;
            self.tell(Event::Connected { state: self.device.clone(), max_position_um: MAX_POSITION_UM });
            if let Some(urgent) = self.urgent_waits.take() {
                self.urgent(urgent);
                self.carry_out();
            }
        } else {
            self.tell(Event::Timeout);
        }
        true
    }

    pub(crate) fn end_act(&mut self) {
        if let Some(event) = self.end_device_act() {
            self.tell(event);
        }
    }

    /// The device's act ends; what it says of that, if the host is to hear of it.
    fn end_device_act(&mut self) -> Option<Event> {
        let (_, act) = self.device_act.take()?;
        self.device.moving = false;
        let outcome = match act {
            Act::Home => {
                self.device.position_um = Some(0);
                Outcome::Arrived { position_um: 0 }
            }
            Act::Move { position_um, .. } => {
                let ends_at = self.lies.misplaced.filter(|(to_um, _)| *to_um == position_um);
                let position_um = ends_at.map_or(position_um, |(_, ends_at_um)| ends_at_um);
                self.device.position_um = Some(position_um);
                Outcome::Arrived { position_um }
            }
            Act::Expose { layer, .. } if self.lies.refuses_lit.is_some_and(|(lied, ..)| lied == layer) => {
                let (_, refusal, hidden) = self.lies.refuses_lit?;
                self.exposed.push(layer);
                self.device.light_on = false;
                self.device.exposing = None;
                self.device.cut_short = hidden.then_some((ExposureId::first_pass(KEY, layer), 400));
                Outcome::Refused(refusal)
            }
            Act::Expose { layer, duration_ms, .. } => {
                self.exposed.push(layer);
                self.device.light_on = false;
                self.device.last_exposed = self.device.exposing.take();
                for slot in &mut self.device.slots {
                    *slot = slot.filter(|id| id.layer != layer);
                }
                Outcome::Exposed { layer, duration_ms: self.lies.light_ms.unwrap_or(duration_ms) }
            }
        };
        let is_told = !self.lies.mute && !std::mem::take(&mut self.mute_once);
        let number = self.awaited.take().filter(|_| is_told)?;
        Some(Event::ActDone { number, outcome })
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
