//! A small vat machine, a quick recipe for it, two leaning struts and a leaning solid with a rough surface.

use std::fmt::Write as _;

use layerd::link::message::{Encoding, MachineCapabilities, VatCapabilities, Vats};
use layerd::pipeline::EncodedLayer;
use layerd_wire::encoding::Decoder;

use super::{LAYER_UM, Source};

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
    let vat =
        VatCapabilities { width_px, height_px, pixel_nm: [20_000, 20_000], max_position_um: 60_000, vats: Vats::ONE };
    (MachineCapabilities::Vat(vat), vec![Encoding::RawBit, Encoding::Group4])
}

/// Two leaning struts, and between them a leaning, rough prism; of 30 layers and of fewer. A strut is 6 layers thick, and its nodes are so
/// many layers apart.
pub(super) fn sources() -> [Source; 3] {
    let strut = |layers| Source::Edges(format!("1 0.15\n0 0 0 0.1 0.07 {}\n", layers_mm(layers)));
    [strut(25), Source::Rough(prism(12), map()), strut(3)]
}

fn layers_mm(layers: i32) -> f64 {
    f64::from(layers * LAYER_UM) / 1000.0
}

/// An OBJ text of a triangular prism of so many layers, with texture coordinates.
fn prism(layers: i32) -> String {
    let mut text = String::new();
    for number in 0..6 {
        let [x, y] = [[-0.3, -0.2], [0.3, -0.1], [0.05, 0.25]][number % 3];
        let (x, y, z) = if number < 3 { (x, y, 0.0) } else { (x + 0.1, y + 0.07, layers_mm(layers)) };
        writeln!(text, "v {x} {y} {z}\nvt {} {}", number % 3, number / 3).expect("a string");
    }
    for [a, b, c] in [[1, 3, 2], [4, 5, 6], [1, 2, 5], [1, 5, 4], [2, 3, 6], [2, 6, 5], [3, 1, 4], [3, 4, 6]] {
        writeln!(text, "f {a}/{a} {b}/{b} {c}/{c}").expect("a string");
    }
    text
}

/// A height map of a few grey values.
fn map() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 4, 4);
    encoder.set_color(png::ColorType::Grayscale);
    let texels = [0, 90, 255, 40, 200, 10, 60, 130, 255, 70, 0, 180, 20, 240, 110, 30];
    encoder.write_header().expect("a head").write_image_data(&texels).expect("texels");
    bytes
}

/// The rows of a layer.
pub(super) fn decoded(layer: &EncodedLayer) -> Vec<u8> {
    let mut decoder = Decoder::new(layer.encoding.picture().expect("a picture"), SIZE_PX[0], SIZE_PX[1]);
    decoder.push(&layer.bytes).expect("decodes");
    decoder.finish().expect("is whole").0
}
