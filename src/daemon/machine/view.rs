//! Converts the daemon's state to the types that the API shows. `GET /v1/status` in `docs/control-api.md` shows the result.

use crate::api::{
    BudgetView, CutShortView, DeviceInfo, DeviceStateView, DeviceView, ExposureView, JobView, LaserInfo, LineView,
    PicturesInfo,
};
use crate::config::Kind;
use crate::daemon::jobs::Jobs;
use crate::device::{DriverEvent, Outcome, PowderOutcome, VatOutcome};
use crate::link::message::{Capabilities, DeviceState, ExposureId, MachineCapabilities};
use crate::link::session::{Hindrance, Statistics};
use crate::stream::MemoryBudget;
use crate::text::{plain_line, short_name};

/// The memory budget.
pub(crate) fn budget(budget: &MemoryBudget) -> BudgetView {
    BudgetView { limit_bytes: budget.limit_bytes(), used_bytes: budget.used_bytes(), peak_bytes: budget.peak_bytes() }
}

/// The line's traffic.
pub(crate) fn line(
    statistics: &Statistics,
    hindrance: Option<Hindrance>,
    reconnects: u64,
    busy_share: Option<f64>,
) -> LineView {
    LineView {
        sent_bytes: statistics.bytes_sent,
        received_bytes: statistics.bytes_received,
        sent_frames: statistics.frames_sent,
        retransmitted_frames: statistics.retransmitted_frames,
        bad_frames: statistics.crc_errors + statistics.malformed_frames,
        unknown_reports: statistics.unknown_reports,
        reconnects,
        round_trip_ms: (statistics.round_trip_us > 0).then(|| statistics.round_trip_us as f64 / 1000.0),
        busy_share,
        hindrance: hindrance.map(|hindrance| hindrance.to_string()),
    }
}

/// Updates the view when a device connects.
pub(crate) fn device_connected(view: &mut DeviceView, capabilities: &Capabilities, state: &DeviceState, jobs: &Jobs) {
    let (kind, vat, powder) = match &capabilities.machine {
        MachineCapabilities::Vat(vat) => (Kind::Dlp, Some(vat), None),
        MachineCapabilities::Powder(powder) => (Kind::Slm, None, Some(powder)),
    };
    view.connected = true;
    view.info = Some(DeviceInfo {
        name: capabilities.name.clone(),
        kind: kind.to_string(),
        pictures: vat.map(|vat| PicturesInfo {
            width_px: vat.width_px,
            height_px: vat.height_px,
            pixel_um: vat.pixel_nm.map(|nm| f64::from(nm) / 1000.0),
        }),
        laser: powder.map(|powder| LaserInfo {
            field_um: powder.field_um,
            max_power_w: f64::from(powder.max_power_mw) / 1000.0,
            buffer_bytes: powder.buffer_bytes,
        }),
        layer_slots: capabilities.layer_slots,
        window_bytes: capabilities.window_bytes,
        largest_frame_bytes: capabilities.largest_frame_bytes,
        encodings: capabilities.encodings.iter().map(|encoding| format!("{encoding:?}")).collect(),
        max_exposure_ms: capabilities.max_exposure_ms,
        max_position_um: capabilities.machine.max_position_um(),
    });
    view.state = Some(state_view(state, jobs));
}

/// Updates the view by an event of the driver; `holder` is the job that has the machine.
pub(crate) fn device_told(view: &mut DeviceView, event: &DriverEvent, jobs: &Jobs, holder: Option<u32>) {
    let state = view.state.get_or_insert_with(DeviceStateView::default);
    match event {
        DriverEvent::StateKnown { state: known, .. } => *state = state_view(known, jobs),
        DriverEvent::ActDone(
            Outcome::Vat(VatOutcome::Arrived { position_um }) | Outcome::Powder(PowderOutcome::Arrived { position_um }),
        ) => {
            state.position_um = Some(*position_um);
            state.moving = false;
        }
        DriverEvent::ActDone(
            Outcome::Vat(VatOutcome::Exposed { layer, .. }) | Outcome::Powder(PowderOutcome::Marked { layer, .. }),
        ) => {
            state.light_on = false;
            state.last_exposed = holder.map(|job| ExposureView { job: job.to_string(), layer: *layer });
        }
        DriverEvent::Fault(fault) => {
            state.fault = fault.as_ref().map(|fault| plain_line(&fault.text));
            state.fault_code = fault.as_ref().map(|fault| fault.code);
        }
        // The next state shows where it stands. Every outcome is listed, so that a new one is not overlooked here.
        DriverEvent::ActDone(
            Outcome::Vat(VatOutcome::Changed { .. })
            | Outcome::Powder(PowderOutcome::Recoated)
            | Outcome::Refused(_)
            | Outcome::TakenBack,
        )
        | DriverEvent::Uploaded { .. }
        | DriverEvent::UploadRefused { .. }
        | DriverEvent::Misbehaved(_) => {}
    }
}

fn state_view(state: &DeviceState, jobs: &Jobs) -> DeviceStateView {
    DeviceStateView {
        light_on: state.light_on,
        position_um: state.position_um,
        moving: state.moving,
        last_exposed: state.last_exposed.map(|id| exposure(id, jobs)),
        cut_short: state.cut_short.map(|(id, light_ms)| CutShortView { exposure: exposure(id, jobs), light_ms }),
        fault: state.fault.as_ref().map(|fault| plain_line(&fault.text)),
        fault_code: state.fault.as_ref().map(|fault| fault.code),
    }
}

fn exposure(id: ExposureId, jobs: &Jobs) -> ExposureView {
    let job = jobs.by_key(id.job).map_or_else(|| format!("{:016x}", id.job), |job| job.view.id.clone());
    ExposureView { job, layer: id.layer }
}

/// One line for `systemctl status`.
pub(crate) fn status_line(job: &JobView) -> String {
    let name = short_name(&job.name);
    format!("job {} ({name}): {}, {} of {} layers done", job.id, job.state, job.layers_done, job.layers_total)
}
