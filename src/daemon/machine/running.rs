//! The job that holds the machine: its engine, and what the engine's actions need. `tests/print.rs` prints with it.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::mpsc;

use crate::config::{Machine, Recipe};
use crate::daemon::background::Background;
use crate::daemon::jobs::opened::Opened;
use crate::daemon::jobs::opened::spool_text;
use crate::device::encoding::Choice;
use crate::device::{DriverEvent, FramedDriver, LightWatch, Outcome, Pass, Passes, ScanTimes, check_fit};
use crate::job::{Action, Command, Engine, Event, JobPlan, Journal, Limits, Record};
use crate::link::message::{Capabilities, DeviceState, Urgent};
use crate::pipeline::{EncodedLayer, Layers, Part};
use crate::stream::{Finished, MemoryBudget, Room};
use crate::system::{spawn_blocking, unix_ms};

/// An action of the engine that the printer's loop must carry out.
#[derive(Debug)]
pub(crate) enum Task {
    /// Send this urgent frame ahead of everything else.
    Urgent(Urgent),
    /// Tell the operator.
    Notice(String),
    /// End the session for this reason, and begin a new one.
    EndSession(String),
    /// Begin a new session, for that reason; nothing is wrong with the line.
    NewSession(String),
    /// The job is over.
    Finished,
}

/// The running job.
pub(crate) struct Running {
    /// Its number.
    pub job: u32,
    /// Its engine.
    pub engine: Engine,
    /// Names its exposures.
    key: u64,
    passes: Passes,
    recipe: Recipe,
    machine: Machine,
    part: Arc<Part>,
    journal: Arc<Mutex<Journal>>,
    background: mpsc::Sender<Background>,
    /// The session's driver; `None` without a session.
    pub driver: Option<FramedDriver>,
    encoding: Option<Choice>,
    layers: Layers,
    /// Exposure and slot that the engine wants uploaded; the layer is not computed yet.
    wanted: Option<(u32, u8)>,
    /// The layer that is being sent.
    sending: Option<Sending>,
    /// The layer before it, if the rest of it follows while it is marked.
    streaming: Option<Sending>,
    act_number: u64,
    /// The urgent frame whose answer the engine waits for, and its number.
    pub urgent: Option<(u32, Urgent)>,
}

/// A layer on its way to the device.
struct Sending {
    /// Its exposure.
    exposure: u32,
    /// How long a laser takes for it.
    times: Option<ScanTimes>,
    /// Its share of the queue.
    _room: Room,
}

impl Running {
    /// A job whose turn has come.
    pub(crate) fn new(
        job: u32,
        opened: Opened,
        light: LightWatch,
        background: mpsc::Sender<Background>,
        now_us: u64,
    ) -> Self {
        let Opened { journal, key, passes, start, recipe, machine, process, part } = opened;
        let plan = JobPlan { key, passes: passes.clone(), time_scale: machine.time_scale(), process };
        let mut engine = Engine::new(plan, start).watching(light);
        engine.handle(Event::Ready, now_us);
        Self {
            job,
            engine,
            key,
            passes,
            recipe,
            machine,
            part,
            journal: Arc::new(Mutex::new(journal)),
            background,
            driver: None,
            encoding: None,
            layers: Layers::default(),
            wanted: None,
            sending: None,
            streaming: None,
            act_number: 0,
            urgent: None,
        }
    }

    /// A session with the device began.
    pub(crate) fn connected(&mut self, capabilities: &Capabilities, state: &DeviceState, now_us: u64) {
        (self.sending, self.streaming) = (None, None);
        self.wanted = None;
        match check_fit(&self.machine, &self.recipe, capabilities) {
            Ok(encoding) => self.encoding = Some(encoding),
            Err(misfit) => return self.engine.handle(Event::Unfit(misfit.to_string()), now_us),
        }
        self.driver = Some(FramedDriver::new(self.key, &capabilities.machine));
        let max_position_um = capabilities.machine.max_position_um();
        let limits = Limits { max_position_um, max_exposure_ms: capabilities.max_exposure_ms };
        self.engine.handle(Event::Connected { state: state.clone(), limits }, now_us);
    }

    /// The session is lost.
    pub(crate) fn line_lost(&mut self, reason: String, now_us: u64) {
        self.session_ended();
        self.engine.handle(Event::LineLost(reason), now_us);
    }

    /// Drops what belonged to the session.
    fn session_ended(&mut self) {
        self.driver = None;
        (self.sending, self.streaming) = (None, None);
        self.wanted = None;
    }

    /// An order of the operator.
    pub(crate) fn command(&mut self, command: Command, now_us: u64) {
        self.engine.handle(Event::Command(command), now_us);
    }

    /// Carries out the engine's actions until one is for the printer's loop; `None` when no action is left.
    pub(crate) fn next_task(&mut self, budget: &MemoryBudget, now_us: u64) -> Option<Task> {
        while let Some(action) = self.engine.next_action() {
            match action {
                Action::Urgent(urgent) => return Some(Task::Urgent(urgent)),
                Action::Notice(text) => return Some(Task::Notice(text)),
                Action::EndSession(why) => {
                    self.session_ended();
                    return Some(Task::EndSession(why));
                }
                Action::NewSession(why) => {
                    self.session_ended();
                    return Some(Task::NewSession(why));
                }
                Action::Finished { .. } => return Some(Task::Finished),
                Action::Journal(record) => self.journal(record),
                Action::Act { number, act } => {
                    self.act_number = number;
                    if let Some(driver) = &mut self.driver
                        && let Err(error) = driver.act(act, now_us)
                    {
                        tracing::error!(%error, ?act, "act refused by the driver");
                    }
                }
                Action::QueryState => {
                    if let Some(driver) = &mut self.driver {
                        driver.query_state(now_us);
                    }
                }
                Action::NeedLayers { from } => {
                    if let Some(encoding) = self.encoding {
                        self.layers.restart(&self.part, from, encoding, budget, spool_text);
                    }
                }
                Action::Upload { exposure, slot } => self.wanted = Some((exposure, slot)),
            }
        }
        None
    }

    /// Appends to the journal in the background; [`Background::Journalled`] reports the result.
    fn journal(&self, record: Record) {
        let (journal, background, job) = (Arc::clone(&self.journal), self.background.clone(), self.job);
        spawn_blocking(move || {
            let mut journal = journal.lock().unwrap_or_else(PoisonError::into_inner);
            let result = journal.append(record, unix_ms()).map_err(|error| error.to_string());
            // Sending fails only when the daemon has ended.
            let _ = background.blocking_send(Background::Journalled { job, result });
        });
    }

    /// Waits for the layer that the engine wants, for ever if it wants none. Cancel-safe.
    pub(crate) async fn wanted_layer(&mut self) -> Result<Finished<EncodedLayer>, String> {
        match self.wanted {
            Some(_) => self.layers.next().await,
            None => std::future::pending().await,
        }
    }

    /// Takes a computed layer: gives it to the driver if it is the one wanted.
    pub(crate) fn computed(&mut self, result: Result<Finished<EncodedLayer>, String>, now_us: u64) {
        let Some((wanted, slot)) = self.wanted else { return };
        let finished = match result {
            Ok(finished) => finished,
            Err(text) => {
                self.wanted = None;
                return self.engine.handle(Event::LayerFailed { exposure: wanted, text }, now_us);
            }
        };
        let EncodedLayer { exposure, encoding, bytes, decoded_crc32, scan } = finished.layer;
        if exposure < wanted {
            // The sweep began earlier; the device holds this layer already.
            return;
        }
        self.wanted = None;
        if exposure > wanted {
            let [found, wanted_text] = [exposure, wanted].map(|exposure| self.passes.text(exposure));
            let text = format!("the sweep came to {found} where {wanted_text} was next");
            return self.engine.handle(Event::LayerFailed { exposure: wanted, text }, now_us);
        }
        let Pass { layer, pass, .. } = self.passes.at(exposure);
        tracing::debug!(
            layer,
            pass,
            bytes = bytes.len(),
            compute_us = finished.compute_time.as_micros(),
            "layer computed"
        );
        if let Some(driver) = &mut self.driver {
            if let Err(error) = driver.upload(layer, pass, slot, encoding, bytes, decoded_crc32) {
                tracing::error!(%error, layer, "upload refused by the driver");
            }
            self.sending = Some(Sending { exposure, times: scan.map(|scan| scan.times), _room: finished.room });
        }
    }

    /// Passes an event of the driver on to the engine.
    pub(crate) fn driver_event(&mut self, event: DriverEvent, now_us: u64) {
        let event = match event {
            DriverEvent::Uploaded { .. } => {
                let Some(sent) = self.sending.take() else { return };
                let Sending { exposure, times, .. } = sent;
                let is_streaming = self.driver.as_ref().is_some_and(FramedDriver::is_streaming);
                self.streaming = Some(sent).filter(|_| is_streaming);
                Event::Uploaded { exposure, times }
            }
            DriverEvent::UploadRefused { refusal, .. } => {
                let Some(Sending { exposure, .. }) = self.sending.take() else { return };
                Event::UploadRefused { exposure, refusal }
            }
            DriverEvent::ActDone(outcome) => Event::ActDone { number: self.act_number, outcome },
            DriverEvent::StateKnown { state, act_taken } => {
                if act_taken {
                    self.engine.handle(Event::ActTaken { number: self.act_number }, now_us);
                }
                Event::State(state)
            }
            DriverEvent::Fault(fault) => Event::Fault(fault),
            DriverEvent::Misbehaved(text) => Event::Misbehaved(text),
        };
        self.engine.handle(event, now_us);
    }

    /// The act was handed to the line.
    pub(crate) fn act_sent(&mut self, now_us: u64) {
        self.engine.handle(Event::ActSent { number: self.act_number }, now_us);
    }

    /// The exposure was taken back before it left the host.
    pub(crate) fn exposure_taken_back(&mut self, now_us: u64) {
        self.engine.handle(Event::ActDone { number: self.act_number, outcome: Outcome::TakenBack }, now_us);
    }

    /// The next deadline of engine and driver.
    pub(crate) fn next_timeout_us(&self) -> Option<u64> {
        let driver = self.driver.as_ref().and_then(FramedDriver::next_timeout_us);
        self.engine.next_timeout_us().into_iter().chain(driver).min()
    }

    /// Ends everything; returns once the memory is given back.
    pub(crate) async fn release(self) {
        drop(self.sending);
        drop(self.streaming);
        drop(self.driver);
        // Closing a file can block on a disk that hangs.
        spawn_blocking(move || drop(self.journal));
        self.layers.stop().await;
    }
}
