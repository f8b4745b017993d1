//! A small laser machine, quick recipes for it, lying struts and a solid. The machine's buffer is smaller than the larger layers, which
//! therefore stream.

use layerd::link::message::{Encoding, MachineCapabilities, PowderCapabilities};
use layerd::pipeline::EncodedLayer;
use layerd_wire::encoding::VectorDecoder;

use super::{LAYER_UM, Scanned, Source};

/// Sides of the laser's field, micrometres.
const FIELD_UM: [u32; 2] = [2_400, 2_400];
/// Bytes of layer data that the machine keeps: the least that the protocol allows.
const BUFFER_BYTES: u32 = 1024;
/// The daemon's memory budget.
pub(super) const BUDGET: &str = "32MiB";

/// How the recipe fills areas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Filling {
    /// One contour, and hatches that go to and fro.
    Zigzag,
    /// Two contours, small squares, and skins with parameters of their own.
    Chessboard,
}

pub(super) fn machine_text(confirms_plate: bool) -> String {
    let [width_um, depth_um] = FIELD_UM;
    format!(
        "name = \"simulated\"\nkind = \"slm\"\nfield_um = [{width_um}.0, {depth_um}.0]\ngrid_um = 60.0\n\
         build_height_um = 20000.0\nbeam_diameter_um = 40.0\nmax_power_w = 200.0\nlayer_height_range_um = [20.0, 100.0]\n\
         recoat_ms = 4000\nconfirm_plate = {confirms_plate}\n"
    )
}

pub(super) fn recipe_text(filling: Filling) -> String {
    let common = format!(
        "name = \"quick\"\nkind = \"slm\"\nlayer_height_um = {LAYER_UM}.0\nlaser_power_w = 100.0\nmark_speed_mm_s = 14.0\n\
         jump_speed_mm_s = 1000.0\njump_delay_us = 200\nmark_delay_us = 100\npolygon_delay_us = 50\nplate_speed_um_s = 1000\n\
         wait_after_recoat_ms = 50\n"
    );
    let own = match filling {
        Filling::Zigzag => "hatch_strategy = \"zigzag\"\nhatch_spacing_um = 40.0\nsimplify_tolerance_um = 0.5\n",
        Filling::Chessboard => {
            "contour_count = 2\nhatch_strategy = \"chessboard\"\nhatch_spacing_um = 36.0\nisland_um = 220.0\nisland_overlap_um = 20.0\n\
             [contour]\nmark_speed_mm_s = 20.0\n[up_skin]\nlaser_power_w = 80.0\n[down_skin]\nhatch_spacing_um = 80.0\n"
        }
    };
    common + own
}

pub(super) fn capabilities(filling: Filling) -> (MachineCapabilities, Vec<Encoding>) {
    let powder = PowderCapabilities {
        field_um: FIELD_UM,
        max_power_mw: 200_000,
        layer_height_um: [20, 100],
        max_position_um: 20_000,
        buffer_bytes: BUFFER_BYTES,
    };
    let mut encodings = vec![Encoding::Vectors];
    encodings.extend((filling == Filling::Zigzag).then_some(Encoding::VectorsCoded));
    (MachineCapabilities::Powder(powder), encodings)
}

/// Lying struts: a grid of two levels and 8 layers, and one level of 5 layers. And a wedge of 4 layers.
pub(super) fn sources() -> [Source; 3] {
    let struts = |radius_mm: f64, struts: &[[f64; 6]]| {
        let mut text = format!("{} {radius_mm}\n", struts.len());
        for ends in struts {
            let numbers: Vec<_> = ends.iter().map(f64::to_string).collect();
            text += &format!("{}\n", numbers.join(" "));
        }
        Source::Edges(text)
    };
    let row = |y_mm: f64, z_mm: f64| [0.0, y_mm, z_mm, 1.5, y_mm, z_mm];
    let column = |x_mm: f64, z_mm: f64| [x_mm, 0.0, z_mm, x_mm, 1.5, z_mm];
    [
        struts(
            0.11,
            &[
                row(0.0, 0.0),
                row(0.5, 0.0),
                row(1.0, 0.0),
                row(1.5, 0.0),
                column(0.0, 0.2),
                column(0.75, 0.2),
                column(1.5, 0.2),
            ],
        ),
        struts(0.12, &[row(0.0, 0.0), row(0.4, 0.0), row(0.8, 0.0), row(1.2, 0.0)]),
        Source::Solid(wedge()),
    ]
}

/// An STL text of a block whose upper side slopes from 4 layers to 3.
fn wedge() -> String {
    let height_mm = |layers: i32| f64::from(layers * LAYER_UM) / 1000.0;
    let corner = |number: usize| {
        let (x, y) = (number & 1, number >> 1 & 1);
        let z = if number < 4 { 0.0 } else { height_mm(if x == 0 { 4 } else { 3 }) };
        format!("vertex {} {} {z}\n", x as f64 * 0.9, y as f64 * 0.5)
    };
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = sides.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
    let facets = triangles
        .map(|corners| format!("facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n", corners.map(corner).concat()));
    format!("solid wedge\n{}endsolid\n", facets.collect::<String>())
}

/// The vectors of a layer.
pub(super) fn decoded(layer: &EncodedLayer) -> Scanned {
    let encoded_bytes = layer.bytes.len() as u32;
    let encoding = layer.encoding.vectors().expect("of vectors");
    let mut decoder = VectorDecoder::new(encoding, FIELD_UM, encoded_bytes);
    let (mut bytes, mut vectors) = (layer.bytes.as_slice(), Vec::new());
    while let Some(vector) = decoder.next(&mut bytes).expect("decodes") {
        vectors.push((vector, *decoder.parameters(vector.class).expect("parameters")));
    }
    decoder.finish().expect("is whole");
    let times = layer.scan.expect("a scanned layer").times;
    Scanned { vectors, times, encoded_bytes, crc32: layer.decoded_crc32 }
}
