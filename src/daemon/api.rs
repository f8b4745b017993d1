//! The control API's types, shared by the server and by `layerctl`. `docs/control-api.md` is written for people.
//!
//! A reader must ignore fields it does not know, so that fields can be added; times are Unix milliseconds.

use serde::{Deserialize, Serialize};

use crate::job::JobState;

/// Header of an upload that names the job, percent-encoded; required.
pub const NAME_HEADER: &str = "x-layerd-name";
/// Header of an upload that holds the recipe's TOML text, percent-encoded; without it the daemon's default recipe is used.
pub const RECIPE_HEADER: &str = "x-layerd-recipe";
/// Header of an upload that names the recipe for people, percent-encoded.
pub const RECIPE_NAME_HEADER: &str = "x-layerd-recipe-name";
/// Longest recipe text, before percent-encoding. A recipe has 16 keys; this leaves ample room for comments, and three times
/// it fits the header limit of [`super::server`].
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
    /// The device does not put its light off: what to do. Stays until the device reports dark.
    #[serde(default)]
    pub stays_lit: Option<String>,
    /// The job that holds the machine: it prints, or is interrupted and its part is on the plate.
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
    /// Names the job in every other call.
    pub id: String,
    /// For people: the build file's name.
    pub name: String,
    /// Where it is in its life.
    pub state: JobState,
    /// For people: the recipe's name.
    pub recipe: String,
    /// Layers exposed and confirmed.
    pub layers_done: u32,
    /// Layers of the whole part; 0 until the job was checked.
    pub layers_total: u32,
    /// The layer under way or next, from 0, as in its file's name.
    pub layer: Option<u32>,
    /// Expected time to the end, seconds.
    pub eta_s: Option<u64>,
    /// Layers the device had to wait for, dark.
    pub late_layers: u32,
    /// How long it waited for them in all, milliseconds.
    pub late_ms_total: u64,
    /// When it was accepted, Unix milliseconds.
    pub submitted_ms: u64,
    /// When it first took the machine, Unix milliseconds.
    pub started_ms: Option<u64>,
    /// When it ended, Unix milliseconds.
    pub ended_ms: Option<u64>,
    /// Why it is in this state, where that is not the operator's wish: what happened and what to do.
    pub reason: Option<String>,
    /// The layer of which nobody knows whether it was exposed; `resume` then needs `in_doubt`.
    pub in_doubt: Option<u32>,
    /// In the answer to an order: what went wrong although it is carried out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

/// Answer of `POST /v1/raise`: the plate is on its way, or there already where both are equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RaiseView {
    /// Where the plate was, micrometres above the bottom of the vat.
    pub from_um: i32,
    /// Where it goes, micrometres.
    pub to_um: i32,
}

/// Answer of `DELETE /v1/jobs/{id}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemovedView {
    /// The job that was removed.
    pub id: String,
    /// Room that this made on the spool's disk, bytes.
    pub freed_bytes: u64,
}

/// The line to the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkView {
    /// Whether the device answers.
    pub state: LinkState,
    /// The port.
    pub path: String,
    /// The device's own name, once it said so.
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
    /// It answered before and does no more; the daemon keeps trying.
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
    /// The ceiling.
    pub limit_bytes: u64,
    /// Charged now.
    pub used_bytes: u64,
    /// The most ever charged at once.
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
    /// Whether the device answers now; if not, the rest is what it said last.
    pub connected: bool,
    /// Why it cannot print on this machine with the default recipe, and what to do.
    #[serde(default)]
    pub misfit: Option<String>,
    /// It does not put its light off: what to do. Stays until it reports dark.
    #[serde(default)]
    pub stays_lit: Option<String>,
    /// What it is and can do; absent where it never answered.
    pub info: Option<DeviceInfo>,
    /// What it was doing when it last said so.
    pub state: Option<DeviceStateView>,
}

/// What the device said it is and can do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceInfo {
    /// Model and firmware.
    pub name: String,
    /// `dlp` or `slm`.
    pub kind: String,
    /// Pixels a row.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixel pitch along x and y, micrometres.
    pub pixel_um: [f64; 2],
    /// Layers it can hold.
    pub layer_slots: u8,
    /// Unacknowledged bytes it takes.
    pub window_bytes: u32,
    /// Largest frame, bytes.
    pub largest_frame_bytes: u16,
    /// What it decodes.
    pub encodings: Vec<String>,
    /// Longest exposure it allows, milliseconds.
    pub max_exposure_ms: u32,
    /// Highest plate position, micrometres.
    pub max_position_um: i32,
}

/// What the device is doing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceStateView {
    /// Whether there is light.
    pub light_on: bool,
    /// Plate height above the bottom of the vat, micrometres; absent before homing.
    pub position_um: Option<i32>,
    /// Whether the plate moves.
    pub moving: bool,
    /// The last exposure that ran its whole time.
    pub last_exposed: Option<ExposureView>,
    /// The last exposure that ended early.
    pub cut_short: Option<CutShortView>,
    /// What keeps it from working.
    pub fault: Option<String>,
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

/// What `GET /v1/events` tells, one JSON object in each `data:` line; `event:` repeats the tag.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Event {
    /// The first event of every stream: where things stand.
    Status(Box<Status>),
    /// A job is new or changed.
    Job(Box<JobView>),
    /// A layer was exposed and confirmed.
    Layer(LayerExposed),
    /// The line was lost or is back.
    Link(LinkView),
    /// Something the operator should read.
    Notice {
        /// One sentence.
        text: String,
    },
    /// The reader was too slow and missed events: read `/v1/status` and `/v1/jobs` again.
    Lagged {
        /// How many are missing.
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

/// A layer was exposed and confirmed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LayerExposed {
    /// The job's id.
    pub job: String,
    /// The layer, from 0.
    pub layer: u32,
    /// How long there was light, as the device reported it, milliseconds; `None` where it named the layer as exposed after a
    /// reconnection, without a time.
    pub exposure_ms: Option<u32>,
    /// How long the machine stood still for the layer, dark, milliseconds; 0 up to 250 ms.
    pub late_ms: u64,
}

/// Body of `POST /v1/jobs/{id}/resume`; may be empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResumeBody {
    /// What the operator says of the layer in doubt.
    pub in_doubt: Option<InDoubt>,
}

/// What the operator says of a layer of which nobody knows whether it was exposed.
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
