//! The control API's types, shared by the server and by `layerctl`. `docs/control-api.md` is written for people;
//! `tests/control_api/` shows it used.
//!
//! A reader must ignore fields it does not know, so that fields can be added; times are Unix milliseconds.

mod body;
mod log;
pub(crate) mod percent;

use serde::{Deserialize, Serialize};

pub(crate) use body::ChannelBody;
pub use log::{LogEntry, LogLine, LogRecord};

use crate::job::JobState;

/// Header of an upload that names the job, percent-encoded; required.
pub const NAME_HEADER: &str = "x-layerd-name";
/// Header of an upload that holds the recipe's TOML text, percent-encoded; without it the daemon's default recipe is used.
pub const RECIPE_HEADER: &str = "x-layerd-recipe";
/// Header of an upload that names the recipe for people, percent-encoded.
pub const RECIPE_NAME_HEADER: &str = "x-layerd-recipe-name";
/// Longest recipe text, before percent-encoding. A recipe has 16 keys; this leaves ample room for comments, and three times
/// it fits the head of a request that the daemon takes.
pub const MAX_RECIPE_BYTES: usize = 16 << 10;
/// Longest name of a job or recipe, bytes.
pub const MAX_NAME_BYTES: usize = 255;

/// Answer of `GET /v1/status`: everything at a glance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Version of the daemon.
    pub version: String,
    /// Name of the machine, from its configuration.
    pub machine: String,
    /// The line to the device.
    pub link: LinkView,
    /// Why the connected device cannot print on this machine with the default recipe, and what to do.
    #[serde(default)]
    pub misfit: Option<String>,
    /// What to do about a device that does not switch its light off. Stays until the device reports dark.
    #[serde(default)]
    pub stays_lit: Option<String>,
    /// The job that holds the machine: it prints, or it is interrupted with its part on the plate.
    pub active: Option<JobView>,
    /// Jobs behind it, the next one first.
    pub queue: Vec<JobView>,
    /// The job that ended last.
    #[serde(default)]
    pub last: Option<JobView>,
    /// The memory budget.
    pub budget: BudgetView,
    /// What the line carried since the daemon started.
    pub line: LineView,
}

/// Answer of `GET /v1/jobs`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JobList {
    /// Every job the daemon remembers, the oldest first.
    pub jobs: Vec<JobView>,
}

/// One job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobView {
    /// The job's id, used in every other request.
    pub id: String,
    /// The build file's name, for people.
    pub name: String,
    /// The job's state.
    pub state: JobState,
    /// The recipe's name, for people.
    pub recipe: String,
    /// Layers exposed and confirmed.
    pub layers_done: u32,
    /// Layers of the whole part; 0 until the job was checked.
    pub layers_total: u32,
    /// The layer under way or next, counted from 0.
    pub layer: Option<u32>,
    /// Expected time to the end, seconds.
    pub eta_s: Option<u64>,
    /// Layers that came late, so that the device waited, dark.
    pub late_layers: u32,
    /// Total of these waits, milliseconds.
    pub late_ms_total: u64,
    /// When it was accepted, Unix milliseconds.
    pub submitted_ms: u64,
    /// When it first took the machine, Unix milliseconds.
    pub started_ms: Option<u64>,
    /// When it ended, Unix milliseconds. An interrupted job may go on and end again.
    pub ended_ms: Option<u64>,
    /// Time from `started_ms` to `ended_ms`, pauses included, seconds; absent until the job is over, and if it never had the machine.
    #[serde(default)]
    pub duration_s: Option<u64>,
    /// About how much resin the part takes, millilitres; absent until that is estimated.
    #[serde(default)]
    pub resin_ml: Option<f64>,
    /// About how much of it the exposed layers take, millilitres.
    #[serde(default)]
    pub resin_done_ml: Option<f64>,
    /// Why it is in this state and what to do; absent if the operator wanted the state.
    pub reason: Option<String>,
    /// Which of its materials is exposed next, or is being exposed; absent if the part is of one, or the job is over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// The layer of which it is unknown whether it was exposed; `resume` then needs `in_doubt`.
    pub in_doubt: Option<u32>,
    /// In the answer to an order: what went wrong, although the order is carried out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

impl JobView {
    /// A queued job of which only the id is known.
    pub fn queued(id: String) -> Self {
        Self {
            id,
            name: String::new(),
            state: JobState::Queued,
            recipe: String::new(),
            layers_done: 0,
            layers_total: 0,
            layer: None,
            eta_s: None,
            late_layers: 0,
            late_ms_total: 0,
            submitted_ms: 0,
            started_ms: None,
            ended_ms: None,
            duration_s: None,
            resin_ml: None,
            resin_done_ml: None,
            reason: None,
            material: None,
            in_doubt: None,
            warning: None,
        }
    }
}

/// Answer of `POST /v1/raise`: the plate moves, or is already clear if both heights are equal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RaiseView {
    /// Where the plate was, micrometres above the bottom of the vat.
    pub from_um: i32,
    /// Where it goes, micrometres.
    pub to_um: i32,
    /// What the operator must know besides: the spool has no note of it yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

/// Answer of `DELETE /v1/jobs/{id}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemovedView {
    /// The job that was removed.
    pub id: String,
    /// Space that became free on the spool's disk, bytes.
    pub freed_bytes: u64,
}

/// The line to the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkView {
    /// Whether the device answers.
    pub state: LinkState,
    /// The port.
    pub path: String,
    /// The device's own name; absent until it has connected.
    pub device: Option<String>,
    /// Why it is not connected.
    pub reason: Option<String>,
}

/// Whether the device answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LinkState {
    /// Not yet; the daemon keeps trying.
    Connecting,
    /// Hello and welcome were exchanged.
    Connected,
    /// The device answered before but no longer does; the daemon keeps trying.
    Lost,
}

impl std::fmt::Display for LinkState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Connecting => "connecting",
            Self::Connected => "connected",
            Self::Lost => "lost",
        })
    }
}

/// The memory budget of the print path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BudgetView {
    /// The limit.
    pub limit_bytes: u64,
    /// Charged now.
    pub used_bytes: u64,
    /// The highest charge so far.
    pub peak_bytes: u64,
}

/// What the line carried since the daemon started.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LineView {
    /// Bytes put on the line, repeats included.
    pub sent_bytes: u64,
    /// Bytes taken from the line.
    pub received_bytes: u64,
    /// Frames put on the line, repeats included.
    pub sent_frames: u64,
    /// Frames sent again.
    pub retransmitted_frames: u64,
    /// Received frames whose checksum or form was wrong.
    pub bad_frames: u64,
    /// Reports of a kind the daemon does not know, which it ignores.
    #[serde(default)]
    pub unknown_reports: u64,
    /// Sessions begun after the first.
    pub reconnects: u64,
    /// Smoothed round trip, milliseconds.
    pub round_trip_ms: Option<f64>,
    /// Share of the time with data to send in which the line was busy, 0 to 1.
    pub busy_share: Option<f64>,
    /// What keeps data from getting through now, though the device is connected, and what to do.
    #[serde(default)]
    pub hindrance: Option<String>,
}

/// Answer of `GET /v1/device`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceView {
    /// Whether the device answers now; if not, the rest is its last known state.
    pub connected: bool,
    /// Why it cannot print on this machine with the default recipe, and what to do.
    #[serde(default)]
    pub misfit: Option<String>,
    /// What to do if the device does not switch its light off. Stays until it reports dark.
    #[serde(default)]
    pub stays_lit: Option<String>,
    /// Its capabilities; absent if it never answered.
    pub info: Option<DeviceInfo>,
    /// Its latest reported state.
    pub state: Option<DeviceStateView>,
}

/// The capabilities that the device reported.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceInfo {
    /// Model and firmware.
    pub name: String,
    /// `dlp`.
    pub kind: String,
    /// What only machines that expose pictures have.
    #[serde(flatten)]
    pub pictures: Option<PicturesInfo>,
    /// What only machines with a laser have.
    #[serde(flatten)]
    pub laser: Option<LaserInfo>,
    /// Layers it can hold.
    pub layer_slots: u8,
    /// Unacknowledged bytes it accepts.
    pub window_bytes: u32,
    /// Largest frame, bytes.
    pub largest_frame_bytes: u16,
    /// Layer encodings it decodes.
    pub encodings: Vec<String>,
    /// Longest exposure it allows, milliseconds.
    pub max_exposure_ms: u32,
    /// The plate's greatest distance from the plane in which layers are exposed, micrometres.
    pub max_position_um: i32,
}

/// The pictures that a device exposes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PicturesInfo {
    /// Pixels in a row.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixel pitch along x and y, micrometres.
    pub pixel_um: [f64; 2],
}

/// The laser of a device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaserInfo {
    /// Size of the field that it reaches, x and y, micrometres.
    pub field_um: [u32; 2],
    /// Its greatest power, watts.
    pub max_power_w: f64,
    /// Size of the buffer for layer data, bytes.
    pub buffer_bytes: u32,
}

/// State of the device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceStateView {
    /// Whether its light is on.
    pub light_on: bool,
    /// Where the plate is, micrometres above the bottom of a vat or below the working plane of a bed of powder; absent before homing.
    pub position_um: Option<i32>,
    /// Whether the plate moves.
    pub moving: bool,
    /// The last exposure that ran its whole time.
    pub last_exposed: Option<ExposureView>,
    /// The last exposure that ended early.
    pub cut_short: Option<CutShortView>,
    /// Its fault, if it has one.
    pub fault: Option<String>,
    /// The device's own number for that fault.
    #[serde(default)]
    pub fault_code: Option<u16>,
}

/// Names an exposure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExposureView {
    /// The job's id, or its key in hexadecimal where the daemon does not know the job.
    pub job: String,
    /// The layer, from 0.
    pub layer: u32,
}

/// An exposure that ended early.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CutShortView {
    /// Which.
    #[serde(flatten)]
    pub exposure: ExposureView,
    /// How long it had light, milliseconds.
    pub light_ms: u32,
}

/// An event of `GET /v1/events`: one JSON object in each `data:` line; `event:` repeats the tag.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Event {
    /// The first event of every stream: the present status.
    Status(Box<Status>),
    /// A job is new or changed.
    Job(Box<JobView>),
    /// A layer was exposed and confirmed; if the part is of several materials, its exposure with one of them.
    Layer(LayerExposed),
    /// The line was lost or is back.
    Link(LinkView),
    /// A text for the operator.
    Notice {
        /// One sentence.
        text: String,
    },
    /// The reader was too slow and missed events: it should read `/v1/status` and `/v1/jobs` again.
    Lagged {
        /// How many events it missed.
        missed: u64,
    },
}

impl Event {
    /// The tag, as it stands in `event:`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Status(_) => "status",
            Self::Job(_) => "job",
            Self::Layer(_) => "layer",
            Self::Link(_) => "link",
            Self::Notice { .. } => "notice",
            Self::Lagged { .. } => "lagged",
        }
    }
}

/// A layer was exposed and confirmed; if the part is of several materials, its exposure with one of them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LayerExposed {
    /// The job's id.
    pub job: String,
    /// The layer, from 0.
    pub layer: u32,
    /// Its material; absent if the part is of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// Time with light as the device reported it, milliseconds; `None` if the device reported the layer as exposed only after a
    /// reconnection, without a time.
    pub exposure_ms: Option<u32>,
    /// How long the machine waited for the layer, dark, milliseconds; waits up to 250 ms count as 0.
    pub late_ms: u64,
}

/// Body of `POST /v1/jobs/{id}/resume`; may be empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResumeBody {
    /// What happened to the layer in doubt.
    pub in_doubt: Option<InDoubt>,
}

/// What happened to the layer in doubt, as the operator found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InDoubt {
    /// It was exposed: go on with the next.
    Exposed,
    /// It was not, or not enough: expose it (again).
    Repeat,
}

/// Body of every answer that is not 2xx.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErrorBody {
    /// What is wrong and what to do.
    pub error: String,
}
