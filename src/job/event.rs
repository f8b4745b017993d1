//! Events that go into the engine, and actions that come out. See them used in the example of [`super`].

use serde::Serialize;

use super::{JobState, Limits, Record, Trace};
use crate::device::{Act, Outcome, ScanTimes};
use crate::link::message::{DeviceState, Fault, Refusal, Urgent};

/// What happened outside the engine.
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
        /// From the device's capabilities.
        limits: Limits,
    },
    /// Comes before [`Event::Connected`] for a job without light: the plate is empty, or the operator confirmed that it is.
    PlateClear {
        /// Boot id of the device.
        boot_id: u32,
        /// Unknown exposures that it shows, and that the operator has confirmed.
        traces: Vec<Trace>,
    },
    /// Comes instead of [`Event::Connected`] for a job without light that has begun: a part may hang on this device's plate. The
    /// job is interrupted and nothing is moved.
    PlateUnclear(String),
    /// The session is lost; a new one is being tried.
    LineLost(String),
    /// The device broke the protocol: it did not answer in time, or its answer makes no sense.
    Misbehaved(String),
    /// The device's state. The engine asked with [`Action::QueryState`], or the owner did, twice a second.
    State(DeviceState),
    /// The act of [`Action::Act`] was handed to the line. The device cannot have begun before: its least time counts from here.
    /// Ignored if it is not the running act.
    ActSent {
        /// Number of the act.
        number: u64,
    },
    /// The device has received the act of [`Action::Act`]. Ignored if it is not the running act.
    ActTaken {
        /// Number of the act.
        number: u64,
    },
    /// The layer of [`Action::Upload`] is in its slot, decoded and checked; or so much of it that it can be begun.
    Uploaded {
        /// Which exposure.
        exposure: u32,
        /// How long a laser takes for it; of scan vectors alone.
        times: Option<ScanTimes>,
    },
    /// The device did not take the layer of [`Action::Upload`].
    UploadRefused {
        /// Which exposure.
        exposure: u32,
        /// Why.
        refusal: Refusal,
    },
    /// The slicer cannot compute a layer.
    LayerFailed {
        /// Which exposure.
        exposure: u32,
        /// Why, and what to do.
        text: String,
    },
    /// The act of [`Action::Act`] ended. Ignored if it is not the running act.
    ActDone {
        /// Number of the act.
        number: u64,
        /// How.
        outcome: Outcome,
    },
    /// The device answered the last [`Action::Urgent`] of this kind, and is dark.
    UrgentDone(Urgent),
    /// The device answered the last [`Action::Urgent`] of this kind, and says that its light is still on.
    UrgentFailed(Urgent),
    /// The device has a fault, or its fault is gone (`None`).
    Fault(Option<Fault>),
    /// The record of [`Action::Journal`] is on disk.
    Journalled,
    /// The record of [`Action::Journal`] could not be written.
    JournalFailed(String),
    /// An order of the operator.
    Command(Command),
    /// The daemon is to end (SIGTERM).
    Shutdown,
    /// The time of [`crate::job::Engine::next_timeout_us`] has come.
    Timeout,
}

/// An order that an operator can give to a running job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// End the layer under way, park the machine, wait.
    Pause,
    /// Go on.
    Resume,
    /// End the layer under way, park the machine, end the job.
    Stop,
    /// Switch the light off now, park the machine, end the job.
    Abort,
}

/// What the owner must do. Actions are carried out in the order in which they come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Switch the light off, ahead of everything else. Answer [`Event::UrgentDone`] or [`Event::UrgentFailed`]. After
    /// [`Event::UrgentDone`] for [`Urgent::Abort`] the device needs a new session: open one and report [`Event::Connected`].
    Urgent(Urgent),
    /// End the session for this reason and begin a new one; report [`Event::Connected`]. Acts and uploads of the old session are
    /// void.
    EndSession(String),
    /// Begin a new session for this reason, and report [`Event::Connected`]. An abort wants it: nothing is wrong with the line.
    NewSession(String),
    /// Append to the journal and flush. Answer [`Event::Journalled`] or [`Event::JournalFailed`]. Until then only urgent actions,
    /// ends of sessions and notices come; after 2 s also the act that parks the machine.
    Journal(Record),
    /// Send an act to the device; report [`Event::ActSent`] when it leaves, and answer [`Event::ActDone`]. Never comes while another act runs.
    Act {
        /// Repeated in the answer.
        number: u64,
        /// What.
        act: Act,
    },
    /// Ask the device's state; answer [`Event::State`].
    QueryState,
    /// Compute layers in ascending order, starting with that of this exposure. The uploads that follow ask for each of them once, in order.
    /// Drop a sweep under way.
    NeedLayers {
        /// The first exposure.
        from: u32,
    },
    /// Send a layer as soon as it is computed; answer [`Event::Uploaded`], [`Event::UploadRefused`] or
    /// [`Event::LayerFailed`]. One at a time.
    Upload {
        /// Which exposure.
        exposure: u32,
        /// The device's slot to put it in.
        slot: u8,
    },
    /// A line for the operator.
    Notice(String),
    /// The engine has ended and no action follows. Release everything.
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
    /// Its material under way; `None` if the part is of one.
    pub material: Option<String>,
    /// Exposures confirmed.
    pub exposures_done: u32,
    /// Layers whose exposures are all confirmed.
    pub layers_done: u32,
    /// Layers of the job.
    pub layers_total: u32,
    /// Layers in whose cycle the machine stood still for more than 250 ms. It waited for the layer, for an order to cross the line,
    /// or, with a laser, for the layer's data.
    pub late_layers: u32,
    /// Time the machine stood still for these layers, milliseconds.
    pub late_ms_total: u64,
    /// Whether a layer is being exposed.
    pub exposing: bool,
    /// Time until the last layer is done, milliseconds, at the pace observed; `None` while nothing is printed.
    pub eta_ms: Option<u64>,
    /// Light time that the device reported for the layer confirmed last, milliseconds; `None` if it reported none.
    pub light_ms: Option<u32>,
    /// Layer that had an unknown amount of light.
    pub in_doubt: Option<u32>,
    /// What the job waits for or why it ended, for people; empty if there is nothing to say.
    pub reason: String,
    /// The job may have had light, and the plate is not parked.
    pub part_unparked: bool,
}
