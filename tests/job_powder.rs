//! Jobs on a laser machine: how plate, recoater and laser follow each other, and how a layer that was marked in part goes on.

use std::path::Path;

use layerd::config::Recipe;
use layerd::device::{Act, Outcome, Passes, PowderAct, PowderOutcome, ScanTimes};
use layerd::job::{
    Action, Engine, Event, History, JobPlan, JobState, Limits, PowderPlan, Process, Record, ResumeChoice, StartPoint,
};
use layerd::link::message::{DeviceState, ExposureId, PowderState, Refusal, Urgent};

const KEY: u64 = 7;
const LAYERS: u32 = 3;
const TIMES: ScanTimes = ScanTimes { vectors: 100, laser_ms: 8_000, mark_ms: 10_000 };
const SECOND_US: u64 = 1_000_000;

fn plan() -> JobPlan {
    let text = "name = \"test\"\nkind = \"slm\"\nlayer_height_um = 100.0\nlaser_power_w = 100.0\nmark_speed_mm_s = 100.0\n\
                jump_speed_mm_s = 1000.0\nhatch_strategy = \"zigzag\"\nhatch_spacing_um = 60.0\nplate_speed_um_s = 100\n";
    let Recipe::Slm(recipe) = Recipe::parse(Path::new("test.toml"), text).expect("a recipe") else {
        panic!("a recipe for a laser machine")
    };
    let process = Process::Powder(PowderPlan { recipe, recoat_ms: 4_000 });
    JobPlan { key: KEY, passes: Passes::single(LAYERS), time_scale: 1.0, process }
}

fn id(layer: u32) -> ExposureId {
    ExposureId::first_pass(KEY, layer)
}

/// An engine, a device that obeys, a line, and a journal.
struct World {
    engine: Engine,
    now_us: u64,
    device: DeviceState,
    journal: Vec<Record>,
    acts: Vec<PowderAct>,
    end: Option<(JobState, String)>,
    /// What the device answers to the act with this number, instead of what is right.
    lie: Option<(usize, Outcome)>,
    /// The act with this number is not answered.
    mute: Option<usize>,
    times: ScanTimes,
    /// Orders to switch the light off.
    light_offs: usize,
}

impl World {
    fn new() -> Self {
        let accepted = Record::Accepted { key: KEY, layer_count: LAYERS, name: "part".into() };
        let powder = Some(PowderState::default());
        let device = DeviceState { boot_id: 1, slots: vec![None, None], powder, ..DeviceState::default() };
        Self::resumed(StartPoint::default(), device, vec![accepted])
    }

    fn resumed(start: StartPoint, device: DeviceState, journal: Vec<Record>) -> Self {
        let engine = Engine::new(plan(), start);
        Self {
            engine,
            now_us: 0,
            device,
            journal,
            acts: Vec::new(),
            end: None,
            lie: None,
            mute: None,
            times: TIMES,
            light_offs: 0,
        }
    }

    fn connect(&mut self) {
        let limits = Limits { max_position_um: 50_000, max_exposure_ms: 3_600_000 };
        self.tell(Event::Connected { state: self.device.clone(), limits });
    }

    /// Runs until nothing is left to do, or the device is mute.
    fn run(&mut self) -> &mut Self {
        self.engine.handle(Event::Ready, self.now_us);
        self.connect();
        self
    }

    fn tell(&mut self, event: Event) {
        let mut events = vec![event];
        while !events.is_empty() {
            for event in std::mem::take(&mut events) {
                self.engine.handle(event, self.now_us);
            }
            while let Some(action) = self.engine.next_action() {
                match action {
                    Action::Journal(record) => {
                        self.journal.push(record);
                        events.push(Event::Journalled);
                    }
                    Action::QueryState => events.push(Event::State(self.device.clone())),
                    Action::Upload { exposure: layer, slot } => {
                        self.device.slots[usize::from(slot)] = Some(id(layer));
                        events.push(Event::Uploaded { exposure: layer, times: Some(self.times) });
                    }
                    Action::Act { number, act: Act::Powder(act) } => events.extend(self.act(number, act)),
                    Action::Finished { state, reason } => self.end = Some((state, reason)),
                    Action::Urgent(Urgent::LightOff) => {
                        self.light_offs += 1;
                        events.push(Event::UrgentDone(Urgent::LightOff));
                    }
                    Action::Notice(_) | Action::NeedLayers { .. } | Action::EndSession(_) => {}
                    other => panic!("{other:?}"),
                }
            }
            let is_mute = self.mute.is_some_and(|mute| self.acts.len() > mute);
            if let Some(due_us) = self.engine.next_timeout_us().filter(|_| events.is_empty() && !is_mute) {
                // A wait of the cycle. The device answers all acts at once.
                self.now_us = due_us.max(self.now_us);
                events.push(Event::Timeout);
            }
        }
    }

    /// The device carries out an act, in the time that it takes.
    fn act(&mut self, number: u64, act: PowderAct) -> Vec<Event> {
        let index = self.acts.len();
        self.acts.push(act);
        if self.mute == Some(index) {
            return vec![Event::ActSent { number }];
        }
        self.engine.handle(Event::ActSent { number }, self.now_us);
        let outcome = match self.lie.filter(|(lied, _)| *lied == index) {
            Some((_, refused @ Outcome::Refused(_))) => refused,
            lie => {
                let (seconds, outcome) = self.carry_out(act);
                self.now_us += seconds * SECOND_US;
                lie.map_or(outcome, |(_, lie)| lie)
            }
        };
        vec![Event::ActDone { number, outcome }]
    }

    fn carry_out(&mut self, act: PowderAct) -> (u64, Outcome) {
        let powder = self.device.powder.get_or_insert_default();
        match act {
            PowderAct::Home => {
                self.device.position_um = Some(0);
                powder.recoated = false;
                (5, Outcome::Powder(PowderOutcome::Arrived { position_um: 0 }))
            }
            PowderAct::Move { position_um, .. } => {
                assert!(self.device.position_um.is_some_and(|at_um| at_um < position_um), "the plate only goes down");
                self.device.position_um = Some(position_um);
                powder.recoated = false;
                (1, Outcome::Powder(PowderOutcome::Arrived { position_um }))
            }
            PowderAct::Recoat => {
                powder.recoated = true;
                (4, Outcome::Powder(PowderOutcome::Recoated))
            }
            PowderAct::Mark { layer, from_vector, .. } => {
                assert!(powder.recoated && self.device.position_um == Some(100 * (layer as i32 + 1)));
                self.device.last_exposed = Some(id(layer));
                self.device.cut_short = None;
                let laser_ms = TIMES.laser_ms * (TIMES.vectors - from_vector) / TIMES.vectors;
                let (vectors, starved_ms) = (TIMES.vectors, 0);
                (10, Outcome::Powder(PowderOutcome::Marked { layer, vectors, laser_ms, starved_ms }))
            }
        }
    }

    fn ended(&self) -> (JobState, &str) {
        self.end.as_ref().map(|(state, reason)| (*state, reason.as_str())).expect("an end")
    }

    /// The first vectors of the marks, with their layers.
    fn marks(&self) -> Vec<(u32, u32)> {
        let mark = |act: &PowderAct| match act {
            PowderAct::Mark { layer, from_vector, .. } => Some((*layer, *from_vector)),
            _ => None,
        };
        self.acts.iter().filter_map(mark).collect()
    }
}

/// A world whose line is lost in the middle of layer 1; the device stopped at this vector.
fn cut_at(next_vector: u32, broken: bool) -> World {
    let mut world = World { mute: Some(6), ..World::new() };
    world.run();
    assert_eq!(world.marks(), [(0, 0), (1, 0)], "{:?}", world.acts);
    world.mute = None;
    world.device.cut_short = Some((id(1), 3_000));
    world.device.slots = vec![None, None];
    world.device.powder = Some(PowderState { next_vector, broken, recoated: true });
    // A device that was cut short answers nothing more in the old session.
    world.engine.handle(Event::LineLost("unplugged".into()), world.now_us);
    world
}

#[test]
fn a_print_lowers_recoats_and_marks_each_layer() {
    let mut world = World::new();
    world.run();
    assert_eq!(world.ended(), (JobState::Completed, ""));
    let layer = |layer: u32| {
        let position_um = 100 * (layer as i32 + 1);
        let mark = PowderAct::Mark { layer, from_vector: 0, most_ms: 16_000 };
        [PowderAct::Move { position_um, speed_um_s: 100 }, PowderAct::Recoat, mark]
    };
    let acts: Vec<_> = [PowderAct::Home].into_iter().chain((0..LAYERS).flat_map(layer)).collect();
    assert_eq!(world.acts, acts);
}

#[test]
fn a_layer_marked_in_part_goes_on_with_the_next_vector_and_is_not_recoated_again() {
    let mut world = cut_at(40, false);
    world.connect();
    assert_eq!(world.ended(), (JobState::Completed, ""));
    assert_eq!(world.marks(), [(0, 0), (1, 0), (1, 40), (2, 0)]);
    assert!(world.journal.contains(&Record::PartlyMarked { exposure: 1, next_vector: 40 }));
    let recoats = world.acts.iter().filter(|act| matches!(act, PowderAct::Recoat)).count();
    assert_eq!(recoats, 3, "one a layer");
    History::replay(&world.journal).expect("a journal that is true");
}

#[test]
fn a_device_that_no_longer_knows_its_powder_recoats_before_it_goes_on() {
    let mut world = cut_at(40, false);
    world.device.boot_id = 2;
    world.device.powder = Some(PowderState { next_vector: 40, broken: false, recoated: false });
    world.connect();
    assert_eq!(world.ended(), (JobState::Completed, ""));
    assert_eq!(world.marks(), [(0, 0), (1, 0), (1, 40), (2, 0)]);
    assert_eq!(world.acts.iter().filter(|act| matches!(act, PowderAct::Recoat)).count(), 4);
}

#[test]
fn another_process_goes_on_where_the_journal_and_the_device_say() {
    let world = cut_at(40, false);
    let start = History::replay(&world.journal).expect("a journal").start(ResumeChoice::None).expect("no doubt");
    assert_eq!((start.next_exposure, start.from_vector), (1, 0));
    let mut next = World::resumed(start, world.device.clone(), world.journal.clone());
    next.run();
    assert_eq!((next.ended(), next.marks()), ((JobState::Completed, ""), vec![(1, 40), (2, 0)]));

    // And once more, when it was recorded, and not commanded again.
    let recorded = Record::PartlyMarked { exposure: 1, next_vector: 40 };
    let journal: Vec<_> = world.journal.iter().cloned().chain([recorded]).collect();
    let start = History::replay(&journal).expect("a journal").start(ResumeChoice::None).expect("no doubt");
    assert_eq!((start.next_exposure, start.from_vector, start.unconfirmed), (1, 40, None));
    let mut next = World::resumed(start, world.device.clone(), journal);
    next.run();
    assert_eq!((next.ended(), next.marks()), ((JobState::Completed, ""), vec![(1, 40), (2, 0)]));
}

#[test]
fn a_vector_marked_in_part_is_for_the_operator_to_decide() {
    let mut world = cut_at(40, true);
    world.connect();
    let (state, _) = world.ended();
    assert_eq!(state, JobState::Interrupted);
    let history = History::replay(&world.journal).expect("a journal");
    assert!(history.in_doubt.as_ref().is_some_and(|why| why.contains("within vector 40")), "{history:?}");
    for (choice, marks) in [(ResumeChoice::Repeat, vec![(1, 40), (2, 0)]), (ResumeChoice::AssumeExposed, vec![(2, 0)])]
    {
        let start = history.start(choice).expect("decided");
        let mut next = World::resumed(start, world.device.clone(), world.journal.clone());
        next.run();
        History::replay(&next.journal).expect("a journal that is true");
        let goes_on = Record::PartlyMarked { exposure: 1, next_vector: 40 };
        assert_eq!(next.journal.contains(&goes_on), choice == ResumeChoice::Repeat);
        assert_eq!((next.ended(), next.marks()), ((JobState::Completed, ""), marks), "{choice:?}");
    }
}

#[test]
fn a_device_that_goes_back_or_beyond_the_layer_is_not_believed() {
    for next_vector in [100, 5000] {
        let mut world = cut_at(next_vector, false);
        world.connect();
        assert_eq!(world.ended().0, JobState::Interrupted);
        let history = History::replay(&world.journal).expect("a journal");
        assert!(history.in_doubt.is_some_and(|why| why.contains(&next_vector.to_string())));
    }
    let mut world = cut_at(40, false);
    world.mute = Some(world.acts.len());
    world.connect();
    assert_eq!(world.marks().last(), Some(&(1, 40)));
    world.device.powder = Some(PowderState { next_vector: 10, broken: false, recoated: true });
    world.device.cut_short = Some((id(1), 3_000));
    world.mute = None;
    world.engine.handle(Event::LineLost("unplugged".into()), world.now_us);
    world.connect();
    assert_eq!(world.ended().0, JobState::Interrupted, "vectors 10 to 39 were marked already");
}

#[test]
fn the_plate_is_never_raised_nor_homed_with_a_part() {
    let mut world = cut_at(40, false);
    world.device.position_um = None;
    world.connect();
    let (state, reason) = world.ended();
    assert!(state == JobState::Interrupted && reason.contains("would raise the part"), "{reason}");

    let mut world = cut_at(40, false);
    world.device.position_um = Some(900);
    world.connect();
    let (state, reason) = world.ended();
    assert!(state == JobState::Interrupted && reason.contains("must not be raised"), "{reason}");
    assert_eq!(world.marks(), [(0, 0), (1, 0)]);
}

#[test]
fn what_the_device_reports_is_compared_with_what_was_commanded() {
    let marked =
        |vectors, laser_ms| Outcome::Powder(PowderOutcome::Marked { layer: 0, vectors, laser_ms, starved_ms: 0 });
    let lies = [
        (1, Outcome::Powder(PowderOutcome::Arrived { position_um: 180 }), "0.180 mm deep instead of 0.100 mm"),
        (2, Outcome::Powder(PowderOutcome::Arrived { position_um: 100 }), "does not fit the act"),
        (3, marked(99, 8_000), "does not fit the act"),
        (3, marked(100, 7_000), "7000 ms of light"),
        (3, marked(100, 9_000), "9000 ms of light"),
        (1, Outcome::Refused(Refusal::BadMove), "outside its travel"),
        (2, Outcome::Refused(Refusal::CutShort), "interlock"),
        (3, Outcome::Refused(Refusal::NotRecoated), "no powder was spread"),
    ];
    for (act, lie, text) in lies {
        let mut world = World { lie: Some((act, lie)), ..World::new() };
        world.run();
        let (state, reason) = world.ended();
        let history = History::replay(&world.journal).expect("a journal");
        let told = format!("{reason} {}", history.in_doubt.unwrap_or_default());
        assert!(state != JobState::Completed && told.contains(text), "{lie:?}: {state} {told}");
        assert!(world.marks().len() <= 1, "{lie:?}: nothing is marked after it");
    }
}

#[test]
fn a_daemon_that_ends_lets_the_laser_stop_at_the_end_of_its_vector() {
    let mut world = World { mute: Some(3), ..World::new() };
    world.times.mark_ms = 100_000;
    world.run();
    world.tell(Event::Shutdown);
    // No order to switch the light off, which would leave a vector marked in part.
    assert_eq!((world.ended().0, world.light_offs), (JobState::Interrupted, 0));
    let history = History::replay(&world.journal).expect("a journal");
    assert!(history.unconfirmed.is_some() && history.in_doubt.is_none());

    // A short layer is awaited.
    let mut world = World { mute: Some(3), ..World::new() };
    world.run();
    world.tell(Event::Shutdown);
    assert!(world.end.is_none() && world.light_offs == 0);
}

/// The line was lost while powder was spread for layer 0. In the next session the device refuses to recoat, because it is busy.
fn busy_after_a_lost_line() -> World {
    let mut world = World { mute: Some(2), lie: Some((3, Outcome::Refused(Refusal::Busy))), ..World::new() };
    world.run();
    world.engine.handle(Event::LineLost("unplugged".into()), world.now_us);
    world.connect();
    world
}

#[test]
fn a_recoater_that_still_works_for_the_session_before_is_waited_for() {
    let mut world = busy_after_a_lost_line();
    assert_eq!(world.acts[2..], [PowderAct::Recoat; 2], "it is refused: the first still runs");
    for is_recoated in [false, false, true] {
        assert!(world.end.is_none() && world.marks().is_empty(), "{:?}", world.end);
        world.device.powder = Some(PowderState { recoated: is_recoated, ..PowderState::default() });
        world.tell(Event::State(world.device.clone()));
        world.now_us += SECOND_US / 2;
        if is_recoated {
            world.mute = None;
        }
        world.tell(Event::Timeout);
    }
    assert_eq!(world.ended(), (JobState::Completed, ""));
    let recoats = world.acts.iter().filter(|act| matches!(act, PowderAct::Recoat)).count();
    assert_eq!((recoats, world.marks().len()), (LAYERS as usize + 1, LAYERS as usize));
}

#[test]
fn a_device_that_stays_busy_is_not_waited_for_without_end() {
    let mut world = busy_after_a_lost_line();
    world.lie = Some((4, Outcome::Refused(Refusal::Busy)));
    world.mute = None;
    world.now_us += SECOND_US / 2;
    world.tell(Event::Timeout);
    let (state, reason) = world.ended();
    assert!(state != JobState::Completed && reason.contains("busy with something"), "{state} {reason}");
    assert!(world.acts.len() == 5 && world.now_us < 60 * SECOND_US, "{:?}", world.acts);
}

#[test]
fn a_layer_without_powder_interrupts_the_job_until_the_recoater_was_looked_at() {
    let mut world = World { lie: Some((3, Outcome::Refused(Refusal::NotRecoated))), ..World::new() };
    world.run();
    let (state, reason) = world.ended();
    assert!(state == JobState::Interrupted && reason.contains("no powder was spread"), "{state} {reason}");
    world.device.powder = Some(PowderState::default());
    let start = History::replay(&world.journal).expect("a journal").start(ResumeChoice::None).expect("no doubt");
    let mut next = World::resumed(start, world.device.clone(), world.journal.clone());
    next.run();
    assert_eq!((next.ended(), next.marks()), ((JobState::Completed, ""), vec![(0, 0), (1, 0), (2, 0)]));
}

#[test]
fn no_layer_is_marked_after_an_end_that_came_while_powder_was_spread() {
    let recoating = || {
        let mut world = World { mute: Some(2), ..World::new() };
        world.run();
        assert_eq!(world.acts.last(), Some(&PowderAct::Recoat));
        world
    };
    let recoated = |mut world: World| {
        world.mute = None;
        world.now_us += 4 * SECOND_US;
        world.tell(Event::ActDone { number: 3, outcome: Outcome::Powder(PowderOutcome::Recoated) });
        assert!(world.marks().is_empty(), "{:?}", world.acts);
        world.end.expect("an end")
    };
    let mut pushed = recoating();
    pushed.device.position_um = Some(160);
    pushed.tell(Event::State(pushed.device.clone()));
    let (state, reason) = recoated(pushed);
    assert!(state != JobState::Completed && reason.contains("0.160 mm deep; it was left 0.100 mm"), "{state} {reason}");

    let mut stopped = recoating();
    stopped.tell(Event::Command(layerd::job::Command::Stop));
    assert_eq!(recoated(stopped).0, JobState::Stopped);
}

#[test]
fn a_pause_leaves_the_part_where_it_is() {
    let mut world = World { mute: Some(3), ..World::new() };
    world.run();
    world.tell(Event::Command(layerd::job::Command::Pause));
    world.mute = Some(4);
    let before = world.acts.len();
    world.device.last_exposed = Some(id(0));
    let outcome = Outcome::Powder(PowderOutcome::Marked { layer: 0, vectors: 100, laser_ms: 8_000, starved_ms: 0 });
    world.now_us += 10 * SECOND_US;
    world.tell(Event::ActDone { number: 4, outcome });
    assert_eq!(world.engine.progress().state, JobState::Paused);
    assert_eq!(world.acts.len(), before, "nothing moves");
}
