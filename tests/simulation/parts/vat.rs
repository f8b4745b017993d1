//! A small vat machine, a quick recipe for it, and leaning struts.

use layerd::link::message::{Encoding, MachineCapabilities, VatCapabilities};
use layerd::pipeline::EncodedLayer;
use layerd_wire::encoding::Decoder;

use super::LAYER_UM;

/// Pixels of a row, and rows.
const SIZE_PX: [u32; 2] = [64, 48];
/// The height at which a part is clear of the resin.
pub(crate) const CLEAR_UM: i32 = 20_000;
/// The daemon's memory budget.
pub(super) const BUDGET: &str = "8MiB";

pub(super) fn machine_text(confirms_plate: bool) -> String {
    let [width_px, height_px] = SIZE_PX;
    format!(
        "name = \"simulated\"\nkind = \"dlp\"\nwidth_px = {width_px}\nheight_px = {height_px}\npixel_um = [20.0, 20.0]\n\
         build_height_um = 60000.0\nclear_height_um = {CLEAR_UM}.0\nconfirm_plate = {confirms_plate}\n"
    )
}

pub(super) fn recipe_text() -> String {
    format!(
        "name = \"quick\"\nlayer_height_um = {LAYER_UM}.0\nexposure_ms = 300\nbottom_exposure_ms = 6000\nbottom_layers = 1\n\
         transition_layers = 1\nlift_height_um = 2000\nlift_speed_um_s = 20000\nretract_speed_um_s = 20000\n\
         light_off_delay_ms = 10\nwait_before_exposure_ms = 20\n"
    )
}

pub(super) fn capabilities() -> (MachineCapabilities, Vec<Encoding>) {
    let [width_px, height_px] = SIZE_PX;
    let vat = VatCapabilities { width_px, height_px, pixel_nm: [20_000, 20_000], max_position_um: 60_000 };
    (MachineCapabilities::Vat(vat), vec![Encoding::RawBit, Encoding::Group4])
}

/// Three parts of a leaning strut, of 30 layers and of fewer. A strut is 6 layers thick, and its nodes are so many layers apart.
pub(super) fn sources() -> [String; 3] {
    [25, 7, 3].map(|layers| {
        let top_mm = f64::from(layers) * f64::from(LAYER_UM) / 1000.0;
        format!("1 0.15\n0 0 0 0.1 0.07 {top_mm}\n")
    })
}

/// The rows of a layer.
pub(super) fn decoded(layer: &EncodedLayer) -> Vec<u8> {
    let mut decoder = Decoder::new(layer.encoding.picture().expect("a picture"), SIZE_PX[0], SIZE_PX[1]);
    decoder.push(&layer.bytes).expect("decodes");
    decoder.finish().expect("is whole").0
}
