//! The pictures of a part as an `.sl1` archive, which Prusa's SL1 and SL1S, PrusaSlicer and UVtools read. `tests/export_sl1.rs` reads it
//! back.
//!
//! It is a zip file of `config.ini`, which the printer reads, `prusaslicer.ini`, which the programs read, and a PNG picture a layer.
//! Its pictures are those that a print sends. Their names sort as the layers do. The zip's list of files stays in memory until the end,
//! some hundred bytes a layer.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::png;
use crate::layer::{Bitmap, Raster};
use crate::output::Output;

/// What an archive says of the print.
#[derive(Clone, Debug, PartialEq)]
pub struct Sl1Print {
    /// Name of the part. Names of pictures begin with it.
    pub name: String,
    /// Name of the machine.
    pub machine: String,
    /// Name of the recipe.
    pub recipe: String,
    /// The machine's grid of pixels.
    pub raster: Raster,
    /// Layer height, micrometres. All layers have it.
    pub layer_height_um: f64,
    /// Exposure of a normal layer, milliseconds.
    pub exposure_ms: u32,
    /// Exposure of the first layer, milliseconds.
    pub first_exposure_ms: u32,
    /// Number of layers until the exposure has fallen to that of a normal layer.
    pub fade_layers: u32,
    /// Number of layers, at most [`Sl1Print::MAX_LAYERS`].
    pub layer_count: u32,
    /// About how long the print takes, seconds.
    pub print_time_s: f64,
}

/// Panels of Prusa's printers, pixels, and the model that their firmware expects.
const PANELS: [([u32; 2], &str); 2] = [([1440, 2560], "SL1"), ([1620, 2560], "SL1S")];

impl Sl1Print {
    /// Most layers: readers expect five digits in the names of pictures, and sort by name.
    pub const MAX_LAYERS: u32 = 100_000;

    /// The model of the printer that the archive is for: known from the panel, else the machine's name. A printer refuses the archives
    /// of others.
    fn model(&self) -> String {
        let size = [self.raster.width_px, self.raster.height_px];
        let panel = PANELS.iter().find(|(panel, _)| *panel == size || [panel[1], panel[0]] == size);
        panel.map_or_else(|| plain(&self.machine), |(_, model)| (*model).into())
    }

    /// What the names of pictures begin with. Readers take a name of digits for a number, and `thumbnail` for a preview.
    fn job_dir(&self) -> String {
        let name = plain(&self.name);
        let is_good = name.starts_with(|first: char| first.is_ascii_alphabetic());
        let is_good = is_good && !name.to_ascii_lowercase().contains("thumbnail");
        if is_good { name } else { format!("part-{}", name.to_ascii_lowercase().replace("thumbnail", "thumb")) }
    }

    /// What the printer reads.
    fn config(&self) -> String {
        let pairs = [
            ("action", "print".into()),
            ("expTime", seconds(self.exposure_ms)),
            ("expTimeFirst", seconds(self.first_exposure_ms)),
            ("expUserProfile", "0".into()),
            ("hollow", "0".into()),
            ("jobDir", self.job_dir()),
            ("layerHeight", millimetres(self.layer_height_um)),
            ("materialName", plain(&self.recipe)),
            ("numFade", self.fade_layers.to_string()),
            ("numFast", self.layer_count.to_string()),
            ("numSlow", "0".into()),
            ("printProfile", plain(&self.recipe)),
            ("printTime", format!("{:.0}", self.print_time_s)),
            ("printerModel", self.model()),
            ("printerProfile", plain(&self.machine)),
            ("printerVariant", "default".into()),
            ("prusaSlicerVersion", concat!("layerd-", env!("CARGO_PKG_VERSION")).into()),
            ("usedMaterial", "0".into()),
        ];
        ini(&pairs)
    }

    /// What programs read.
    fn profile(&self) -> String {
        let Raster { width_px, height_px, mirror, build_height_um, .. } = self.raster;
        let [width, height] = self.raster.area_um().map(millimetres);
        let flag = |is_set: bool| u8::from(is_set).to_string();
        let pairs = [
            ("area_fill", "50".into()),
            ("bed_shape", format!("0x0,{width}x0,{width}x{height},0x{height}")),
            ("display_height", height),
            ("display_mirror_x", flag(mirror.x)),
            // Our first row has the smallest y; theirs, unless it is mirrored, the greatest.
            ("display_mirror_y", flag(!mirror.y)),
            ("display_orientation", "landscape".into()),
            ("display_pixels_x", width_px.to_string()),
            ("display_pixels_y", height_px.to_string()),
            ("display_width", width),
            ("exposure_time", seconds(self.exposure_ms)),
            ("faded_layers", self.fade_layers.to_string()),
            ("gamma_correction", "1".into()),
            // Readers place the layers wrongly if the first is higher than the others.
            ("initial_exposure_time", seconds(self.first_exposure_ms)),
            ("initial_layer_height", millimetres(self.layer_height_um)),
            ("layer_height", millimetres(self.layer_height_um)),
            ("max_print_height", millimetres(build_height_um)),
            ("printer_model", self.model()),
            ("printer_settings_id", plain(&self.machine)),
            ("printer_technology", "SLA".into()),
            ("printer_variant", "default".into()),
            ("sla_archive_format", "SL1".into()),
            ("sla_material_settings_id", plain(&self.recipe)),
            ("sla_print_settings_id", plain(&self.recipe)),
        ];
        ini(&pairs)
    }
}

/// Writes an archive layer by layer.
#[derive(Debug)]
pub struct Sl1Writer {
    output: Output,
    zip: ZipWriter<BufWriter<File>>,
    job_dir: String,
    next_layer: u32,
    layer_count: u32,
}

impl Sl1Writer {
    /// Begins an archive.
    ///
    /// # Errors
    /// Whatever the file system says; and if there are too many layers.
    pub fn create(path: &Path, print: &Sl1Print) -> io::Result<Self> {
        if print.layer_count > Sl1Print::MAX_LAYERS {
            let text =
                format!("an .sl1 has at most {} layers, and here are {}", Sl1Print::MAX_LAYERS, print.layer_count);
            return Err(io::Error::other(text));
        }
        let output = Output::create(path)?;
        let zip = ZipWriter::new(BufWriter::new(output.file().try_clone()?));
        let (job_dir, layer_count) = (print.job_dir(), print.layer_count);
        let mut writer = Self { output, zip, job_dir, next_layer: 0, layer_count };
        writer.entry("config.ini", CompressionMethod::Deflated)?.write_all(print.config().as_bytes())?;
        writer.entry("prusaslicer.ini", CompressionMethod::Deflated)?.write_all(print.profile().as_bytes())?;
        Ok(writer)
    }

    /// Writes the next layer.
    ///
    /// # Errors
    /// Whatever the file system says; and if there are more layers than announced.
    pub fn layer(&mut self, bitmap: &Bitmap) -> io::Result<()> {
        if self.next_layer == self.layer_count {
            return Err(io::Error::other("there are more layers than the archive says"));
        }
        let name = format!("{}{:05}.png", self.job_dir, self.next_layer);
        self.next_layer += 1;
        // A PNG does not become smaller.
        png::encode(&mut self.entry(&name, CompressionMethod::Stored)?, bitmap)
    }

    /// Ends the archive, which appears under its name.
    ///
    /// # Errors
    /// Whatever the file system says; and if layers are missing. Nothing is left behind then.
    pub fn finish(self) -> io::Result<()> {
        if self.next_layer < self.layer_count {
            return Err(io::Error::other("there are fewer layers than the archive says"));
        }
        self.zip.finish().map_err(io_error)?.flush()?;
        self.output.publish()
    }

    fn entry(&mut self, name: &str, method: CompressionMethod) -> io::Result<&mut ZipWriter<BufWriter<File>>> {
        self.zip.start_file(name, SimpleFileOptions::default().compression_method(method)).map_err(io_error)?;
        Ok(&mut self.zip)
    }
}

fn io_error(error: ZipError) -> io::Error {
    match error {
        ZipError::Io(error) => error,
        other => io::Error::other(other),
    }
}

fn ini(pairs: &[(&str, String)]) -> String {
    pairs.iter().map(|(key, value)| format!("{key} = {value}\n")).collect()
}

/// A name of letters that every reader of an ini file, and every file system, takes.
fn plain(name: &str) -> String {
    let is_plain = |letter: &char| letter.is_ascii_alphanumeric() || "-_.".contains(*letter);
    // Long enough for people, and short enough for a file name with its number.
    const MAX_LETTERS: usize = 80;
    name.chars().map(|letter| if is_plain(&letter) { letter } else { '_' }).take(MAX_LETTERS).collect()
}

fn seconds(ms: u32) -> String {
    (f64::from(ms) / 1000.0).to_string()
}

/// Millimetres to a nanometre.
fn millimetres(um: f64) -> String {
    ((um * 1000.0).round() / 1e6).to_string()
}
