//! The part of `layerctl demo --displaced`: a ring of few triangles, as OBJ, and a height map that makes it rough. `cli/demo.rs` packs both.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::Context;

/// Faces around the ring and around its tube. They are curved, so that so few are enough.
const AROUND: u32 = 24;
const ACROSS: u32 = 10;

/// Width and height of the map, texels.
const MAP_SIZE: [u32; 2] = [1536, 256];

/// Writes a ring that lies flat: the radius of its middle line, and that of its tube, millimetres.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn write_ring(path: &Path, [large, small]: [f64; 2]) -> anyhow::Result<()> {
    let mut text = String::from("# a ring, written by `layerctl demo --displaced`\n");
    for (along, over) in (0..=AROUND).flat_map(|along| (0..=ACROSS).map(move |over| (along, over))) {
        let [u, v] = [f64::from(along) / f64::from(AROUND), f64::from(over) / f64::from(ACROSS)];
        // The last corners are the first again, with other texture coordinates.
        let [azimuth, around] = [along % AROUND, over % ACROSS];
        let (sin, cos) = (TAU * f64::from(azimuth) / f64::from(AROUND)).sin_cos();
        let (up, out) = (TAU * f64::from(around) / f64::from(ACROSS)).sin_cos();
        let radius = large + small * out;
        writeln!(text, "v {} {} {}", radius * cos, radius * sin, small * up)?;
        writeln!(text, "vn {} {} {up}\nvt {u} {v}", out * cos, out * sin)?;
    }
    let number = |along: u32, over: u32| along * (ACROSS + 1) + over + 1;
    for (along, over) in (0..AROUND).flat_map(|along| (0..ACROSS).map(move |over| (along, over))) {
        let corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[a, b]| number(along + a, over + b));
        let words = corners.map(|corner| format!("{corner}/{corner}/{corner}"));
        writeln!(text, "f {}", words.join(" "))?;
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes a map of a weave: bands that run over and under each other.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn write_weave(path: &Path) -> anyhow::Result<()> {
    let [width, height] = MAP_SIZE;
    let texel = |column: u32, row: u32| {
        // Bands along both directions; which of them lies above changes from crossing to crossing.
        let [u, v] = [f64::from(column) / f64::from(width) * 36.0, f64::from(row) / f64::from(height) * 6.0];
        let is_even = (u.floor() + v.floor()) as i64 % 2 == 0;
        let [across, along] = if is_even { [u.fract(), v.fract()] } else { [v.fract(), u.fract()] };
        let bulge = |at: f64| (at * TAU / 2.0).sin();
        (bulge(across).powf(0.4) * (0.35 + 0.65 * bulge(along)) * 255.0).round() as u8
    };
    let texels: Vec<u8> = (0..height).flat_map(|row| (0..width).map(move |column| texel(column, row))).collect();
    let file = std::fs::File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&texels));
    written.with_context(|| format!("cannot write {}", path.display()))
}
