//! The job engine against a scripted device under virtual time: the print as it should go, every disturbance at every step.

mod properties;

use layerd::config::Recipe;
use layerd::device::{Act, Outcome};
use layerd::job::{
    Action, Command, Engine, Event, History, JobPlan, JobState, Record, ResumeChoice, ResumeError, StartPoint,
};
use layerd::link::message::{DeviceState, ExposureId, Fault, Refusal, Urgent};
use proptest::prelude::*;

const KEY: u64 = 7;
const LAYERS: u32 = 5;
const CLEAR_UM: i32 = 20_000;
const MAX_POSITION_UM: i32 = 150_000;
/// What an abort says that nobody confirmed.
const LIGHT_UNCONFIRMED: &str = "did not confirm that its light is off";

fn plan() -> JobPlan {
    let recipe = Recipe {
        name: "test".into(),
        layer_height_um: 50.0,
        exposure_ms: 2000,
        bottom_exposure_ms: 20_000,
        bottom_layers: 1,
        transition_layers: 1,
        lift_height_um: 5000,
        lift_speed_um_s: 1000,
        retract_speed_um_s: 3000,
        light_off_delay_ms: 500,
        wait_before_exposure_ms: 500,
        wait_after_exposure_ms: 200,
        wait_after_lift_ms: 300,
        light_pwm: 255,
        antialias: false,
    };
    JobPlan { key: KEY, layer_count: LAYERS, recipe, clear_height_um: f64::from(CLEAR_UM) }
}

fn accepted() -> Record {
    Record::Accepted { key: KEY, layer_count: LAYERS, name: "cube".into() }
}

/// What happens to the world at a given step.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Disturbance {
    /// The line is down for this long.
    LineLost {
        for_us: u64,
    },
    /// The host dies; the daemon starts again and resumes.
    Crash,
    Order(Command),
    Shutdown,
}

/// Engine, device, journal and line, with a clock of their own.
struct World {
    engine: Engine,
    now_us: u64,
    journal: Vec<Record>,
    /// A record being flushed, and until when.
    flushing: Option<(u64, Record)>,
    device: DeviceState,
    /// End of the device's act, and what it comes to.
    device_act: Option<(u64, Act)>,
    /// The act whose outcome the host will hear of.
    awaited: Option<u64>,
    upload: Option<(u64, u32, u8)>,
    upload_us: u64,
    line_up: bool,
    /// Sent without a line; the next session begins with it.
    urgent_waits: Option<Urgent>,
    reconnect_at_us: Option<u64>,
    /// Layers that had their whole light, in order.
    exposed: Vec<u32>,
    acts: Vec<Act>,
    steps: usize,
    disturb_at: Vec<(usize, Disturbance)>,
    aborted: bool,
    journal_full: bool,
    finished: Option<(JobState, String)>,
}

impl World {
    fn new() -> Self {
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
            steps: 0,
            disturb_at: Vec::new(),
            aborted: false,
            journal_full: false,
            finished: None,
        }
    }

    fn disturbed(at: Vec<(usize, Disturbance)>) -> Self {
        Self { disturb_at: at, ..Self::new() }
    }

    /// Runs until the engine is done; false if it rests in a pause.
    fn run(&mut self) -> bool {
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

    fn tell(&mut self, event: Event) {
        self.engine.handle(event, self.now_us);
        self.carry_out();
    }

    fn carry_out(&mut self) {
        while let Some(action) = self.engine.next_action() {
            self.steps += 1;
            match self.disturbance() {
                // Before the action takes effect, or after it.
                Some(disturbance) if self.steps.is_multiple_of(2) => {
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

    fn disturbance(&mut self) -> Option<Disturbance> {
        let place = self.disturb_at.iter().position(|(step, _)| *step <= self.steps)?;
        Some(self.disturb_at.remove(place).1)
    }

    fn disturb(&mut self, disturbance: Disturbance) {
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
        }
    }

    fn drop_line(&mut self, for_us: u64) {
        self.line_up = false;
        self.awaited = None;
        self.upload = None;
        self.reconnect_at_us = Some(self.now_us + for_us);
    }

    /// A new engine from what the journal says.
    fn crash(&mut self) {
        let history = History::replay(&self.journal).expect("the journal is true at every moment");
        let Ok(start) = history.start(ResumeChoice::None) else {
            self.finished = Some((history.state, history.reason));
            return;
        };
        self.drop_line(2_000_000);
        self.flushing = None;
        self.engine = Engine::new(plan(), start);
        self.finished = None;
        self.tell(Event::Ready);
    }

    fn perform(&mut self, action: Action) {
        let may_overtake = matches!(action, Action::Urgent(_) | Action::Notice(_));
        assert!(may_overtake || self.flushing.is_none(), "{action:?} before the journal is on disk");
        match action {
            Action::Journal(_) if self.journal_full => {
                self.engine.handle(Event::JournalFailed("no space left".into()), self.now_us);
            }
            Action::Journal(record) => {
                self.flushing = Some((self.now_us + 5000, record));
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
            Action::Finished { state, reason } => self.finished = Some((state, reason)),
            Action::NeedLayers { .. } | Action::Notice(_) => {}
        }
    }

    fn begin_act(&mut self, number: u64, act: Act) {
        self.acts.push(act);
        if !self.line_up {
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
                let commanded = self.journal.iter().rev().find(|r| !matches!(r, Record::Paused | Record::Resumed));
                assert!(matches!(commanded, Some(Record::Commanded { layer: l, .. }) if *l == layer), "{commanded:?}");
                assert_eq!(self.device.position_um, Some(50 * (layer as i32 + 1)), "layer {layer} at a wrong height");
                assert_eq!(duration_ms, [20_000, 11_000, 2000, 2000, 2000][layer as usize]);
                self.awaited = Some(number);
                let id = ExposureId { job: KEY, layer };
                if self.device.last_exposed.is_some_and(|last| last.job == KEY && last.layer >= layer) {
                    return self.answer(number, Outcome::Refused(Refusal::AlreadyExposed));
                }
                assert!(self.device.slots.contains(&Some(id)), "layer {layer} is not on the device");
                self.device.exposing = Some(id);
                self.device.light_on = true;
                u64::from(duration_ms) * 1000
            }
        };
        self.device.moving = !matches!(act, Act::Expose { .. });
        self.awaited = Some(number);
        self.device_act = Some((self.now_us + duration_us, act));
    }

    fn answer(&mut self, number: u64, outcome: Outcome) {
        self.awaited = None;
        self.engine.handle(Event::ActDone { number, outcome }, self.now_us);
    }

    fn urgent(&mut self, urgent: Urgent) {
        if !self.line_up {
            self.urgent_waits = Some(urgent);
            return;
        }
        if let Some(id) = self.device.exposing.take() {
            self.device.cut_short = Some((id, 1));
            self.device.light_on = false;
            self.device_act = None;
            if let (Urgent::LightOff, Some(number)) = (urgent, self.awaited) {
                self.answer(number, Outcome::Refused(Refusal::CutShort));
            }
        }
        self.engine.handle(Event::UrgentDone, self.now_us);
        if urgent == Urgent::Abort {
            self.device.moving = false;
            self.device_act = None;
            self.device.slots = vec![None, None];
            self.drop_line(500_000);
            self.engine.handle(Event::LineLost("aborted".into()), self.now_us);
        }
    }

    /// Lets time pass to the next thing that happens; false if nothing ever will.
    fn next_event(&mut self) -> bool {
        self.steps += 1;
        if let Some(disturbance) = self.disturbance() {
            self.disturb(disturbance);
            self.carry_out();
            return true;
        }
        let act_us = self.device_act.map(|(at_us, _)| at_us);
        let upload_us = self.upload.map(|(at_us, ..)| at_us);
        let flushed_us = self.flushing.as_ref().map(|(at_us, _)| *at_us);
        let times = [flushed_us, act_us, upload_us, self.reconnect_at_us, self.engine.next_timeout_us()];
        let Some(at_us) = times.iter().flatten().min().copied() else {
            return false;
        };
        self.now_us = self.now_us.max(at_us);
        if flushed_us == Some(at_us) {
            self.journal.extend(self.flushing.take().map(|(_, record)| record));
            self.tell(Event::Journalled);
        } else if act_us == Some(at_us) {
            self.end_act();
        } else if upload_us == Some(at_us) {
            if let Some((_, layer, slot)) = self.upload.take() {
                self.device.slots[usize::from(slot)] = Some(ExposureId { job: KEY, layer });
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

    fn end_act(&mut self) {
        let Some((_, act)) = self.device_act.take() else { return };
        self.device.moving = false;
        let outcome = match act {
            Act::Home => {
                self.device.position_um = Some(0);
                Outcome::Arrived { position_um: 0 }
            }
            Act::Move { position_um, .. } => {
                self.device.position_um = Some(position_um);
                Outcome::Arrived { position_um }
            }
            Act::Expose { layer, duration_ms, .. } => {
                self.exposed.push(layer);
                self.device.light_on = false;
                self.device.last_exposed = self.device.exposing.take();
                for slot in &mut self.device.slots {
                    *slot = slot.filter(|id| id.layer != layer);
                }
                Outcome::Exposed { layer, duration_ms }
            }
        };
        if let Some(number) = self.awaited.take() {
            self.tell(Event::ActDone { number, outcome });
        }
    }

    fn all_exposed_once(&self) -> bool {
        self.exposed == (0..LAYERS).collect::<Vec<_>>()
    }

    fn end(&self) -> (JobState, &str) {
        self.finished.as_ref().map(|(state, reason)| (*state, reason.as_str())).expect("the job ended")
    }
}

#[test]
fn a_print_homes_exposes_every_layer_and_lifts_clear() {
    let mut world = World::new();
    assert!(world.run());
    assert_eq!(world.end(), (JobState::Completed, ""));
    assert!(world.all_exposed_once());
    let moves: Vec<_> = world
        .acts
        .iter()
        .filter_map(|act| if let Act::Move { position_um, .. } = act { Some(*position_um) } else { None })
        .collect();
    assert_eq!(world.acts[0], Act::Home);
    assert_eq!(moves, [50, 5050, 100, 5100, 150, 5150, 200, 5200, 250, CLEAR_UM]);
    let progress = world.engine.progress();
    assert_eq!((progress.late_layers, progress.layers_done, progress.eta_ms), (0, LAYERS, 0));
    let history = History::replay(&world.journal).expect("true");
    assert_eq!((history.state, history.next_layer), (JobState::Completed, LAYERS));
}

#[test]
fn a_late_layer_is_waited_for_counted_and_timed() {
    let mut world = World::new();
    world.upload_us = 30_000_000;
    assert!(world.run());
    assert_eq!(world.end().0, JobState::Completed);
    assert!(world.all_exposed_once());
    let progress = world.engine.progress();
    assert!((3..=4).contains(&progress.late_layers), "{progress:?}");
    assert!(progress.late_ms_total > 30_000, "{progress:?}");
}

/// Steps of an undisturbed print: disturbances fall on each of them.
fn steps_of_a_print() -> usize {
    let mut world = World::new();
    world.run();
    world.steps
}

#[test]
fn a_pause_at_any_step_lifts_clear_and_resume_goes_on_at_the_right_layer() {
    for step in 1..steps_of_a_print() {
        let mut world = World::disturbed(vec![(step, Disturbance::Order(Command::Pause))]);
        if !world.run() {
            assert!(world.device.position_um.is_none_or(|p| p >= CLEAR_UM), "step {step}: not clear");
            assert!(!world.device.light_on);
            world.tell(Event::Command(Command::Resume));
            while world.finished.is_none() {
                assert!(world.next_event(), "step {step}: stuck");
            }
        }
        assert_eq!(world.end().0, JobState::Completed, "step {step}");
        assert!(world.all_exposed_once(), "step {step}: {:?}", world.exposed);
    }
}

#[test]
fn a_stop_at_any_step_ends_after_the_layer_with_the_plate_clear() {
    for step in 1..steps_of_a_print() - 8 {
        let mut world = World::disturbed(vec![(step, Disturbance::Order(Command::Stop))]);
        assert!(world.run());
        let done = world.engine.progress().layers_done;
        assert_eq!(world.end().0, JobState::Stopped, "step {step}");
        assert_eq!(world.exposed, (0..done).collect::<Vec<_>>(), "no layer is left half");
        assert!(world.exposed.is_empty() || world.device.position_um >= Some(CLEAR_UM), "step {step}");
    }
}

#[test]
fn an_abort_at_any_step_puts_the_light_off_first_then_lifts() {
    for step in 1..steps_of_a_print() - 2 {
        let mut world = World::disturbed(vec![(step, Disturbance::Order(Command::Abort))]);
        assert!(world.run());
        assert_eq!(world.end().0, JobState::Aborted, "step {step}: {:?}", world.end());
        assert!(!world.device.light_on);
        assert!(world.device.position_um.is_none_or(|p| p >= CLEAR_UM), "step {step}: not lifted");
        let history = History::replay(&world.journal).expect("true");
        assert_eq!(history.start(ResumeChoice::None), Err(ResumeError::Over(JobState::Aborted)));
    }
}

#[test]
fn a_job_taken_up_after_a_crash_can_be_ended_at_once_dark_and_clear() {
    for (command, state) in [(Command::Stop, JobState::Stopped), (Command::Abort, JobState::Aborted)] {
        for step in 1..steps_of_a_print() - 8 {
            let mut world = World::disturbed(vec![(step, Disturbance::Crash), (step, Disturbance::Order(command))]);
            assert!(world.run());
            assert_eq!(world.end().0, state, "step {step}: {:?}", world.end());
            assert!(!world.device.light_on, "step {step}");
            let bare =
                world.exposed.is_empty() && world.device.last_exposed.is_none() && world.device.cut_short.is_none();
            assert!(bare || world.device.position_um >= Some(CLEAR_UM), "step {step}: {:?}", world.device);
        }
    }
}

#[test]
fn an_abort_of_a_device_that_is_gone_ends_with_a_warning() {
    let mut world = World::disturbed(vec![(60, Disturbance::LineLost { for_us: u64::MAX / 2 })]);
    while world.line_up || world.reconnect_at_us == Some(0) || world.now_us == 0 {
        if world.now_us == 0 {
            world.tell(Event::Ready);
        }
        assert!(world.next_event());
    }
    world.disturb(Disturbance::Order(Command::Abort));
    let lost_at_us = world.now_us;
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Aborted);
    assert!(reason.contains(LIGHT_UNCONFIRMED), "{reason}");
    assert!(world.now_us - lost_at_us < 30_000_000, "it ends soon");
}

#[test]
fn an_abort_whose_line_comes_back_too_late_ends_with_a_warning() {
    let mut world = world_exposing(0);
    world.drop_line(17_000_000);
    world.tell(Event::LineLost("cable".into()));
    world.tell(Event::Command(Command::Abort));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Aborted);
    assert!(reason.contains(LIGHT_UNCONFIRMED), "{reason}");
    assert!(world.device.light_on, "the device ends the bottom layer by itself");
}

#[test]
fn a_shutdown_at_any_step_leaves_a_job_that_can_be_resumed() {
    for step in 1..steps_of_a_print() - 8 {
        let mut world = World::disturbed(vec![(step, Disturbance::Shutdown)]);
        assert!(world.run());
        let (state, reason) = world.end();
        if state == JobState::Failed {
            continue;
        }
        assert_eq!(state, JobState::Interrupted, "step {step}: {reason}");
        assert!(!world.device.light_on, "step {step}");
        let history = History::replay(&world.journal).expect("true");
        let choice = if history.in_doubt.is_some() {
            assert!(matches!(history.start(ResumeChoice::None), Err(ResumeError::InDoubt { .. })));
            ResumeChoice::Repeat
        } else {
            ResumeChoice::None
        };
        world.engine = Engine::new(plan(), history.start(choice).expect("resumable"));
        world.finished = None;
        world.drop_line(0);
        assert!(world.run());
        assert_eq!(world.end().0, JobState::Completed, "step {step}: {:?}", world.end());
        assert!(world.all_exposed_once(), "step {step}: {:?}", world.exposed);
    }
}

#[test]
fn a_line_that_stays_away_interrupts_the_job() {
    let mut world = World::disturbed(vec![(60, Disturbance::LineLost { for_us: u64::MAX / 2 })]);
    assert!(world.run());
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("did not come back within 60 s (cable)"), "{reason}");
}

#[test]
fn an_abort_that_finds_the_plate_moving_stops_it_before_it_lifts() {
    let moving = |world: &World| matches!(world.device_act, Some((_, Act::Move { .. })));
    let mut world = world_exposing(1);
    while !moving(&world) {
        assert!(world.next_event());
    }
    world.drop_line(0);
    world.tell(Event::LineLost("cable".into()));
    world.tell(Event::Command(Command::Abort));
    assert!(moving(&world), "no line, no abort");
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    assert_eq!((world.end().0, world.device.position_um), (JobState::Aborted, Some(CLEAR_UM)));
    let lifts = world.acts.iter().filter(|act| matches!(act, Act::Move { position_um: CLEAR_UM, .. }));
    assert_eq!(lifts.count(), 1, "nothing is commanded that the abort on its way would end: {:?}", world.acts);
}

/// Runs a print up to its layer `layer` being exposed.
fn world_exposing(layer: u32) -> World {
    let mut world = World::new();
    world.tell(Event::Ready);
    while world.device.exposing != Some(ExposureId { job: KEY, layer }) {
        assert!(world.next_event());
    }
    world
}

#[test]
fn a_device_reset_under_light_leaves_the_layer_in_doubt_and_never_homes() {
    let mut world = world_exposing(2);
    world.drop_line(3_000_000);
    world.device_act = None;
    let slots = vec![None, None];
    world.device = DeviceState { boot_id: 2, last_exposed: world.device.last_exposed, slots, ..DeviceState::default() };
    world.tell(Event::LineLost("reset".into()));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("layer 2 is in doubt") && reason.contains("--in-doubt exposed"), "{reason}");
    assert!(world.journal.iter().any(|record| matches!(record, Record::InDoubt { layer: 2, .. })));

    let history = History::replay(&world.journal).expect("true");
    world.engine = Engine::new(plan(), history.start(ResumeChoice::AssumeExposed).expect("decided"));
    world.finished = None;
    world.drop_line(0);
    assert!(world.run());
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("no longer knows where its plate is"), "{reason}");
    assert_eq!(History::replay(&world.journal).expect("true").next_layer, 3);
}

/// What was said of one layer must not settle a later one: it would have light twice, or too little.
#[test]
fn a_word_about_a_layer_in_doubt_holds_for_no_other() {
    for choice in [ResumeChoice::Repeat, ResumeChoice::AssumeExposed] {
        let mut world = world_exposing(0);
        let history = History::replay(&world.journal).expect("true");
        world.engine = Engine::new(plan(), history.start(choice).expect("the device may not know"));
        world.flushing = None;
        world.drop_line(1_000_000);
        world.tell(Event::Ready);
        while world.device.exposing != Some(ExposureId { job: KEY, layer: 2 }) {
            assert!(world.next_event(), "the device knows of layer 0, and the print goes on");
        }
        world.urgent(Urgent::LightOff);
        world.carry_out();
        while world.finished.is_none() {
            assert!(world.next_event());
        }
        assert_eq!((world.end().0, world.exposed.as_slice()), (JobState::Interrupted, [0, 1].as_slice()), "{choice:?}");
        assert!(world.end().1.contains("layer 2 is in doubt: the device ended its light early"), "{}", world.end().1);
    }
    let history = History::replay(&[accepted(), Record::Started { layer: 0 }]).expect("true");
    assert_eq!(history.start(ResumeChoice::Repeat), Err(ResumeError::NoDoubt { next_layer: 0 }));
}

#[test]
fn a_job_whose_device_has_printed_another_since_moves_nothing() {
    let mut world = world_exposing(3);
    world.tell(Event::Shutdown);
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let acts = world.acts.len();
    world.device.last_exposed = Some(ExposureId { job: KEY + 1, layer: 90 });
    world.crash();
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    assert!(world.end().0 == JobState::Interrupted && world.end().1.contains("another job"), "{:?}", world.end());
    assert_eq!(world.acts.len(), acts);
}

/// What the device exposed last may be older than the job as long as it confirmed none of the job's layers.
#[test]
fn a_first_layer_that_the_operator_decided_on_goes_on_with_an_older_jobs_exposure_in_the_device() {
    let records = [
        accepted(),
        Record::Started { layer: 0 },
        Record::Commanded { layer: 0, boot_id: 1 },
        Record::InDoubt { layer: 0, why: "reset".into() },
        Record::Decided { layer: 0, exposed: true },
    ];
    let history = History::replay(&records).expect("true");
    let mut world = World::new();
    world.journal = records.to_vec();
    world.device.last_exposed = Some(ExposureId { job: KEY + 1, layer: 90 });
    world.device.position_um = Some(50);
    world.engine = Engine::new(plan(), history.start(ResumeChoice::None).expect("decided"));
    assert!(world.run());
    assert_eq!((world.end(), world.exposed.as_slice()), ((JobState::Completed, ""), [1, 2, 3, 4].as_slice()));
}

/// A part in the vat keeps the machine until somebody lifted it, or aborts.
#[test]
fn a_stop_that_could_lift_nothing_leaves_the_job_interrupted() {
    let mut world = world_exposing(2);
    world.crash();
    world.tell(Event::Command(Command::Stop));
    world.tell(Event::Shutdown);
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert!(state == JobState::Interrupted && reason.contains("the plate was not lifted"), "{state}: {reason}");
}

/// Cut short and to be repeated, layer 0 hangs on the plate half cured.
#[test]
fn a_device_that_lost_its_position_never_homes_onto_a_layer_that_had_some_light() {
    let records = [
        accepted(),
        Record::Started { layer: 0 },
        Record::Commanded { layer: 0, boot_id: 1 },
        Record::InDoubt { layer: 0, why: "cut short".into() },
        Record::Decided { layer: 0, exposed: false },
    ];
    let history = History::replay(&records).expect("true");
    let mut world = World::new();
    world.journal = records.to_vec();
    world.engine = Engine::new(plan(), history.start(ResumeChoice::None).expect("decided"));
    assert!(world.run());
    assert!(world.end().0 == JobState::Interrupted && world.acts.is_empty(), "{:?} {:?}", world.end(), world.acts);
}

#[test]
fn a_plate_that_cannot_be_lifted_is_told() {
    let mut world = world_exposing(1);
    world.drop_line(3_000_000);
    world.device_act = None;
    world.device = DeviceState { boot_id: 2, slots: vec![None, None], ..DeviceState::default() };
    world.tell(Event::LineLost("reset".into()));
    world.tell(Event::Command(Command::Stop));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert!(state == JobState::Interrupted && reason.contains("the plate was not lifted"), "{state}: {reason}");
    assert!(world.engine.progress().part_in_vat);
}

#[test]
fn a_fault_interrupts_the_job_and_is_named() {
    let mut world = world_exposing(1);
    world.tell(Event::Fault(Some(Fault { code: 9, text: "cover open".into() })));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("fault 9 (cover open)"), "{reason}");
}

#[test]
fn a_full_disk_ends_the_print_dark_and_clear_before_the_next_layer() {
    let mut world = world_exposing(1);
    world.journal_full = true;
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("no space left"), "{reason}");
    assert_eq!((world.exposed.len(), world.device.position_um), (2, Some(CLEAR_UM)));
    let history = History::replay(&world.journal).expect("true");
    assert_eq!((history.state, history.next_layer), (JobState::Interrupted, 1));
    assert!(history.unconfirmed.is_some(), "the device will be asked");
}

#[test]
fn a_disk_that_fills_up_while_the_line_is_lost_still_ends_the_job() {
    let mut world = world_exposing(1);
    world.drop_line(30_000_000);
    world.journal_full = true;
    world.tell(Event::LineLost("cable".into()));
    world.tell(Event::JournalFailed("no space left".into()));
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    assert_eq!((world.end().0, world.device.position_um), (JobState::Interrupted, Some(CLEAR_UM)));
}

#[test]
fn a_part_taller_than_the_travel_is_refused_before_anything_moves() {
    let mut world = World::new();
    world.tell(Event::Ready);
    world.tell(Event::Connected { state: world.device.clone(), max_position_um: 200 });
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Failed);
    assert!(reason.contains("250") && reason.contains("200"), "{reason}");
    assert!(world.acts.is_empty());
}

#[test]
fn a_layer_that_cannot_be_computed_interrupts_the_job_with_the_plate_clear() {
    let mut world = world_exposing(1);
    world.tell(Event::LayerFailed { layer: 3, text: "chunk 4 is corrupt".into() });
    while world.finished.is_none() {
        assert!(world.next_event());
    }
    let (state, reason) = world.end();
    assert_eq!(state, JobState::Interrupted);
    assert!(reason.contains("layer 3") && reason.contains("chunk 4 is corrupt"), "{reason}");
    assert_eq!((world.exposed.as_slice(), world.device.position_um), ([0, 1].as_slice(), Some(CLEAR_UM)));
}

fn any_disturbance() -> impl Strategy<Value = Disturbance> {
    prop_oneof![
        3 => (0u64..40_000_000).prop_map(|for_us| Disturbance::LineLost { for_us }),
        3 => Just(Disturbance::Crash),
        1 => Just(Disturbance::Order(Command::Pause)),
        1 => Just(Disturbance::Order(Command::Resume)),
    ]
}

proptest! {
    #![proptest_config(properties::cases(256))]

    /// Crashes, lost lines and pauses at any steps: every layer once, in order. The world itself asserts that light has a
    /// record before it, that the plate stands right, and that acts never overlap.
    #[test]
    fn every_layer_is_exposed_once_and_in_order(
        mut at in prop::collection::vec((1usize..160, any_disturbance()), 0..8)
    ) {
        at.sort_by_key(|(step, _)| *step);
        let mut world = World::disturbed(at);
        let mut ended = world.run();
        for _ in 0..20 {
            if ended && world.end().0 == JobState::Completed {
                break;
            }
            if ended {
                prop_assert_eq!(world.end().0, JobState::Interrupted, "{:?}", world.end());
                world.crash();
            } else {
                world.tell(Event::Command(Command::Resume));
            }
            ended = world.run();
        }
        prop_assert!(ended && world.all_exposed_once(), "{:?} {:?}", world.exposed, world.finished);
        let history = History::replay(&world.journal).expect("true");
        prop_assert_eq!((history.state, history.next_layer), (JobState::Completed, LAYERS));
    }

    /// Whatever went before, the very next action after an abort puts the light off, and no light follows. Where the device
    /// was out of reach throughout, the job ends with a warning that says so.
    #[test]
    fn an_abort_comes_first_whatever_went_before(
        mut at in prop::collection::vec((1usize..120, any_disturbance()), 0..5),
        abort_at in 1usize..120,
    ) {
        at.retain(|(step, disturbance)| *step < abort_at && *disturbance != Disturbance::Crash);
        at.sort_by_key(|(step, _)| *step);
        at.push((abort_at, Disturbance::Order(Command::Abort)));
        let mut world = World::disturbed(at);
        if world.run() && world.aborted {
            let ended_before = matches!(world.end().0, JobState::Completed | JobState::Interrupted);
            prop_assert!(world.end().0 == JobState::Aborted || ended_before, "{:?}", world.end());
            prop_assert!(!world.device.light_on || world.end().1.contains(LIGHT_UNCONFIRMED), "{:?}", world.end());
        }
    }
}
