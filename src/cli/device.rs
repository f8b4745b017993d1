//! `layerctl device`. `tests/operator` shows it.

use clap::Args;

use super::client::Client;
use super::{block_on, print, print_json};
use crate::api::{DeviceInfo, DeviceStateView, DeviceView, LaserInfo, PicturesInfo};
use crate::text::{count_text, mm_text, size_text};

/// Show what the device is, and where light and plate are.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl device                               whether there is light, where the plate is, a fault
  layerctl device --json | jq .state.light_on")]
pub(super) struct DeviceArgs {
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &DeviceArgs) -> anyhow::Result<()> {
    let device: DeviceView = block_on(async { Ok(Client::from_environment().get("/v1/device").await?) })?;
    if args.json {
        return print_json(&device);
    }
    let Some(info) = &device.info else {
        return print("the device has not answered yet; `layerctl status` tells why");
    };
    print_info(info)?;
    if !device.connected {
        print("connected  no; what follows is what it said last, and may have changed since")?;
    }
    if let Some(warning) = &device.stays_lit {
        print(&format!("LIGHT      {warning}"))?;
    }
    if let Some(misfit) = &device.misfit {
        print(&format!("MISFIT     {misfit}"))?;
    }
    device.state.as_ref().map_or(Ok(()), |state| print_state(state, device.connected))
}

fn print_info(info: &DeviceInfo) -> anyhow::Result<()> {
    print(&format!("device     {} ({})", info.name, info.kind))?;
    if let Some(PicturesInfo { width_px, height_px, pixel_um: [x, y] }) = info.pictures {
        print(&format!("picture    {width_px} x {height_px} pixels of {x} x {y} µm"))?;
    }
    if let Some(LaserInfo { field_um: [x, y], max_power_w, buffer_bytes }) = info.laser {
        print(&format!("field      {} x {}, laser up to {max_power_w} W", mm_text(x), mm_text(y)))?;
        print(&format!("buffer     {} of layer data", size_text(buffer_bytes.into())))?;
    }
    print(&format!("encodings  {}", info.encodings.join(", ")))?;
    print(&format!(
        "receives   {} ahead, {} unacknowledged, frames up to {}",
        count_text(info.layer_slots.into(), "layer"),
        size_text(info.window_bytes.into()),
        size_text(info.largest_frame_bytes.into())
    ))?;
    print(&format!("limits     exposure {} ms, plate {}", info.max_exposure_ms, mm_text(info.max_position_um)))
}

fn print_state(state: &DeviceStateView, is_connected: bool) -> anyhow::Result<()> {
    let when = if is_connected { "" } else { ", when last heard of" };
    print(&format!("light      {}{when}", if state.light_on { "ON" } else { "off" }))?;
    let plate = state.position_um.map_or_else(|| "not homed".into(), mm_text);
    print(&format!("plate      {plate}{}", if state.moving { ", moving" } else { "" }))?;
    if let Some(last) = &state.last_exposed {
        print(&format!("exposed    layer {} of job {}", last.layer, last.job))?;
    }
    if let Some(cut) = &state.cut_short {
        print(&format!(
            "cut short  layer {} of job {}, after {} ms",
            cut.exposure.layer, cut.exposure.job, cut.light_ms
        ))?;
    }
    let code = state.fault_code.map_or_else(String::new, |code| format!(" (code {code})"));
    state.fault.as_ref().map_or(Ok(()), |fault| print(&format!("FAULT      {fault}{code}")))
}
