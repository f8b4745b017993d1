//! What the engine keeps track of: the part, the line, the device's memory, the act under way, the abort, failures in a
//! row. See it used all over `job/engine/`.

use crate::link::message::ExposureId;

/// What the machine may have made of the job so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum PartState {
    /// Nothing: there was no light.
    Absent,
    /// There may have been light.
    Possible,
    /// The device has confirmed a layer.
    Confirmed,
}

impl PartState {
    pub(super) fn new(touched: bool, confirmed: bool) -> Self {
        match (touched, confirmed) {
            (_, true) => Self::Confirmed,
            (true, false) => Self::Possible,
            (false, false) => Self::Absent,
        }
    }

    /// Whether there may be a part, so that moves may harm it.
    pub(super) fn is_possible(self) -> bool {
        self != Self::Absent
    }
}

/// The line to the device.
#[derive(Debug, Default)]
pub(super) struct LineState {
    pub(super) session: Session,
    /// What keeps data from getting through, as reported by the line.
    pub(super) hindrance: Option<String>,
    /// Why the last session was lost; empty if none was.
    pub(super) loss: String,
}

/// Whether there is a session with the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Session {
    /// There was none in this run.
    #[default]
    Never,
    /// The last one is lost.
    Lost,
    Up,
}

impl LineState {
    pub(super) fn is_up(&self) -> bool {
        self.session == Session::Up
    }

    /// The session is gone, if there was one.
    pub(super) fn drop_session(&mut self) {
        if self.session == Session::Up {
            self.session = Session::Lost;
        }
    }

    /// Adds to `text` what keeps data from getting through: a device that does not answer may not have been reached.
    pub(super) fn with_cause(&self, text: &str) -> String {
        self.hindrance.as_ref().map_or(text.to_owned(), |hindrance| format!("{text}; {hindrance}"))
    }
}

/// What the device names as the job's layer that it exposed last. That never goes back.
#[derive(Debug, Default)]
pub(super) enum Memory {
    /// It has named none.
    #[default]
    Empty,
    /// The last one that it named.
    Exposed(ExposureId),
    /// It named an earlier one after a later one; describes it.
    WentBack(String),
}

/// An exposure of the job. It need not be one that the job has.
pub(super) fn id_text(id: ExposureId) -> String {
    match id.pass {
        0 => format!("layer {}", id.layer),
        pass => format!("exposure {pass} of layer {}", id.layer),
    }
}

impl Memory {
    /// Takes in the exposure of the job that a state names. Returns whether the memory has gone back just now.
    pub(super) fn compare(&mut self, told: ExposureId) -> bool {
        let before = match self {
            Self::Empty => told,
            Self::Exposed(before) => *before,
            Self::WentBack(_) => return false,
        };
        if told >= before {
            *self = Self::Exposed(told);
            return false;
        }
        *self = Self::WentBack(format!(
            "the device named {} of this job as exposed last, and now it names {}: it was reset, or what \
             it says is wrong",
            id_text(before),
            id_text(told)
        ));
        true
    }

    /// The description, if the memory has gone back.
    pub(super) fn went_back(&self) -> Option<&str> {
        match self {
            Self::WentBack(text) => Some(text),
            Self::Empty | Self::Exposed(_) => None,
        }
    }
}

/// The last act, under way or ended.
#[derive(Debug, Default)]
pub(super) struct ActWatch {
    /// Number of the last act.
    pub(super) number: u64,
    /// Number of the act under way.
    pub(super) running: Option<u64>,
    /// When the act under way was decided; `None` once the device is known to have it.
    pub(super) decided_us: Option<u64>,
    /// When the last act was handed to the line; `None` before that.
    left_us: Option<u64>,
    /// Least time that act can take, microseconds of the host's clock; 0 if unknown.
    least_us: u64,
}

impl ActWatch {
    /// Begins an act, and returns its number.
    pub(super) fn begin(&mut self, least_us: u64, now_us: u64) -> u64 {
        let number = self.number + 1;
        *self = Self { number, running: Some(number), decided_us: Some(now_us), left_us: None, least_us };
        number
    }

    /// The act was handed to the line.
    pub(super) fn handed_to_line(&mut self, number: u64, now_us: u64) {
        if self.running == Some(number) {
            self.left_us = Some(now_us);
        }
    }

    /// Time since the last act was handed to the line, microseconds, if that act cannot have ended yet; else `None`.
    pub(super) fn too_soon_us(&self, now_us: u64) -> Option<u64> {
        let took_us = self.left_us.map_or(0, |left_us| now_us.saturating_sub(left_us));
        (took_us < self.least_us).then_some(took_us)
    }
}

/// The abort that was sent last.
#[derive(Debug, Default)]
pub(super) struct AbortOrder {
    /// Sessions in which it was tried.
    pub(super) sessions: u32,
    /// When it was sent in the present session.
    pub(super) sent_us: u64,
    /// The device has answered it.
    pub(super) answered: bool,
    /// The device is known to be dark.
    pub(super) is_dark: bool,
}

/// Failures of line and device. A printed layer resets those in a row.
#[derive(Debug, Default)]
pub(super) struct Failures {
    /// Lost lines.
    pub(super) losses_in_a_row: u32,
    /// Protocol errors.
    pub(super) misbehaviours_in_a_row: u32,
    /// Layers still to print until all protocol errors of the job are made up for.
    pub(super) layers_of_misbehaviour: u32,
}

impl Failures {
    /// A layer was printed.
    pub(super) fn layer_printed(&mut self) {
        (self.losses_in_a_row, self.misbehaviours_in_a_row) = (0, 0);
        self.layers_of_misbehaviour = self.layers_of_misbehaviour.saturating_sub(1);
    }
}
