//! A move of the plate that `layerctl raise` ordered. `tests/plate.rs` and `tests/hostile/plate.rs` try it.

use crate::api::RaiseView;
use crate::daemon::handle::Reply;
use crate::deadline::Deadline;
use crate::link::message::DeviceState;

/// A move of the plate that is ordered.
#[derive(Debug)]
pub(crate) struct Raise {
    /// From where to where.
    pub view: RaiseView,
    /// How far it is.
    pub stage: Stage,
    /// End of the stage's wait.
    pub deadline: Deadline,
}

impl Raise {
    /// The order to move was handed to the line.
    pub(crate) fn sent(&mut self, now_us: u64) {
        if let Stage::Moving { sent_us, .. } = &mut self.stage {
            *sent_us = Some(now_us);
        }
    }

    /// Time since the order was handed to the line, microseconds, if the move cannot have ended yet; else `None`.
    pub(crate) fn too_soon_us(&self, now_us: u64) -> Option<u64> {
        let Stage::Moving { least_us, sent_us } = self.stage else { return None };
        let took_us = sent_us.map_or(0, |sent_us| now_us.saturating_sub(sent_us));
        (took_us < least_us).then_some(took_us)
    }
}

/// How far a move is.
#[derive(Debug)]
pub(crate) enum Stage {
    /// The spool's note is being written; the move begins once it is on disk. These wait for the answer, at most one for each
    /// connection.
    Noting(Vec<Reply>),
    /// The device moves.
    Moving {
        /// Least time that the move takes, microseconds of the host's clock.
        least_us: u64,
        /// When the order was handed to the line; `None` before that.
        sent_us: Option<u64>,
    },
}

/// The plate's present height, micrometres, or why it must not move.
pub(crate) fn raised_from(state: &DeviceState) -> Result<i32, String> {
    if let Some(fault) = &state.fault {
        return Err(format!("the device has a fault and moves nothing: {}", fault.text));
    }
    if state.light_on || state.exposing.is_some() {
        return Err("there is light, and the plate must not move: `layerctl abort` switches it off".into());
    }
    if state.moving {
        return Err("the plate moves already: try again once it rests".into());
    }
    state.position_um.ok_or_else(|| {
        "the device does not know where its plate is, and only homing would tell it, which goes down. Raise the plate by \
         hand or at the machine"
            .into()
    })
}
