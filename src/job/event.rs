//! What the engine is told and what it asks for.

use serde::Serialize;

use super::{JobState, Record, Trace};
use crate::device::{Act, Outcome};
use crate::link::message::{DeviceState, Fault, Refusal, Urgent};

/// News for the engine.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Preflight passed: part, recipe and machine fit, the slicer can start.
    Ready,
    /// Preflight failed; the text says what does not fit and what to do.
    Unfit(String),
    /// A session with the device began, the first or a new one. Acts and uploads of an earlier session are void.
    Connected {
        /// From the welcome of this session.
        state: DeviceState,
        /// Highest plate position of the device ([`crate::link::message::Capabilities::max_position_um`]).
        max_position_um: i32,
    },
    /// Before [`Event::Connected`], for a job without light: nothing hangs on this device's plate, or the operator knows of it.
    PlateClear {
        /// The start of the device.
        boot_id: u32,
        /// What it shows of exposures that only the operator knows of.
        traces: Vec<Trace>,
    },
    /// In place of [`Event::Connected`], for a job without light that has begun: something may hang on this device's plate. The
    /// job is interrupted; nothing is moved.
    PlateUnclear(String),
    /// The session is lost; a new one is being tried.
    LineLost(String),
    /// The device broke the protocol: it did not answer in time, or its answer makes no sense.
    Misbehaved(String),
    /// The device's state: asked for with [`Action::QueryState`], or by the owner, who asks twice a second.
    State(DeviceState),
    /// The device is known to have the act of [`Action::Act`]. Acts that are not the running one are ignored.
    ActTaken {
        /// Number of the act.
        number: u64,
    },
    /// The layer of [`Action::Upload`] is in its slot, decoded and checked.
    Uploaded {
        /// Which.
        layer: u32,
    },
    /// The device did not take the layer of [`Action::Upload`].
    UploadRefused {
        /// Which.
        layer: u32,
        /// Why.
        refusal: Refusal,
    },
    /// The slicer cannot compute a layer.
    LayerFailed {
        /// Which.
        layer: u32,
        /// Why, and what to do.
        text: String,
    },
    /// The act of [`Action::Act`] ended. An outcome of an act that is not the running one is ignored.
    ActDone {
        /// Number of the act.
        number: u64,
        /// How.
        outcome: Outcome,
    },
    /// The device acknowledged the last [`Action::Urgent`].
    UrgentDone,
    /// The device carried out the last [`Action::Urgent`] and says that its light is still on.
    UrgentFailed(String),
    /// The device has a fault, or is rid of it.
    Fault(Option<Fault>),
    /// The record of [`Action::Journal`] is on disk.
    Journalled,
    /// The record of [`Action::Journal`] could not be written.
    JournalFailed(String),
    /// The operator wants something.
    Command(Command),
    /// The daemon is to end (SIGTERM).
    Shutdown,
    /// The time of [`crate::job::Engine::next_timeout_us`] has come.
    Timeout,
}

/// What an operator can want of a running job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// After the layer under way: plate clear, wait.
    Pause,
    /// Go on.
    Resume,
    /// After the layer under way: plate clear, end.
    Stop,
    /// Light off now, then plate clear, end.
    Abort,
}

/// What the engine wants done. Actions are to be carried out in the order they are given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Put the light off; ahead of everything else. Answer [`Event::UrgentDone`] or [`Event::UrgentFailed`]. After
    /// [`Urgent::Abort`] the device wants a new session: open one and report [`Event::Connected`].
    Urgent(Urgent),
    /// End the session, for that reason, and begin a new one; report [`Event::Connected`]. Acts and uploads of the session are
    /// void.
    EndSession(String),
    /// Append to the journal and flush. Answer [`Event::Journalled`] or [`Event::JournalFailed`]; until then only urgent
    /// actions, ends of sessions and notices are given; after 2 s also the move that lifts the plate clear.
    Journal(Record),
    /// Have the device do something; answer [`Event::ActDone`]. Never given while another act runs.
    Act {
        /// Repeated in the answer.
        number: u64,
        /// What.
        act: Act,
    },
    /// Ask the device's state; answer [`Event::State`].
    QueryState,
    /// Compute layers from this one on, in ascending order: the uploads that follow ask for each once, from here on.
    /// A sweep under way for other layers can be dropped.
    NeedLayers {
        /// The first.
        from: u32,
    },
    /// Send a layer as soon as it is computed; answer [`Event::Uploaded`], [`Event::UploadRefused`] or
    /// [`Event::LayerFailed`]. One at a time.
    Upload {
        /// Which.
        layer: u32,
        /// The device's slot to put it in.
        slot: u8,
    },
    /// A line for the operator.
    Notice(String),
    /// The engine is done; nothing follows. Release everything.
    Finished {
        /// The job's last state.
        state: JobState,
        /// Why, and what to do.
        reason: String,
    },
}

/// Where a job stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Progress {
    /// The job's state.
    pub state: JobState,
    /// The layer under way, or the next.
    pub layer: u32,
    /// Layers exposed and confirmed.
    pub layers_done: u32,
    /// Layers of the job.
    pub layers_total: u32,
    /// Layers during whose cycle the machine stood still for more than 250 ms, waiting for the layer or for an order to cross
    /// the line.
    pub late_layers: u32,
    /// Time the machine stood still for these layers, milliseconds.
    pub late_ms_total: u64,
    /// Whether a layer is being exposed.
    pub exposing: bool,
    /// Time until the last layer is done, milliseconds, at the pace observed; `None` while nothing is printed.
    pub eta_ms: Option<u64>,
    /// Time with light of the layer confirmed last, as the device reported it, milliseconds; `None` where it reported none.
    pub light_ms: Option<u32>,
    /// Layer of which nobody can tell how much light it had.
    pub in_doubt: Option<u32>,
    /// What the job is waiting for or why it ended, for people; empty where there is nothing to say.
    pub reason: String,
    /// Light may have fallen, and the plate is not parked.
    pub part_in_vat: bool,
}
