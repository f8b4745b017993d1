//! The log of a simulated device: `acts.jsonl`, and a PNG of every exposed or melted layer. [`run`](fn@super::run) writes it.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::layer::Bitmap;
use crate::layer::export::write_png;
use crate::link::message::ExposureId;

/// One line of `acts.jsonl`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ActRecord {
    /// Device clock, milliseconds since its start.
    pub t_ms: u64,
    /// What happened: `exposed`, `light_on`, `light_off`, `moved`, `refused`, `urgent`, `fault`, `reset`, `host_silent`, `hello`; in a
    /// machine with several vats `change`, `changed` and `change_stopped` as well, in a
    /// powder machine `marked`, `laser_on`, `laser_off` and `recoated` as well.
    pub event: &'static str,
    /// Key of the job.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub job: Option<u64>,
    /// Layer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub layer: Option<u32>,
    /// Number of the exposure within the layer, if it is not the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pass: Option<u8>,
    /// The vat that is in place, or that is to be, if there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vat: Option<u8>,
    /// How long the light was on, milliseconds: of a laser, in this act of marking.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_ms: Option<u32>,
    /// Plate above the bottom of the vat, or below the working plane, micrometres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_um: Option<i32>,
    /// Vectors of a layer that was marked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vectors: Option<u32>,
    /// First vector of an act of marking.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_vector: Option<u32>,
    /// First vector that is not marked whole, where an act of marking ended early.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_vector: Option<u32>,
    /// How long the laser waited, off, for layer data, milliseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub starved_ms: Option<u32>,
    /// Why, or what exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// The directory acts and layers are written to.
#[derive(Debug)]
pub struct ActLog {
    directory: PathBuf,
    acts: File,
}

impl ActLog {
    /// Creates the directory and an empty `acts.jsonl`.
    ///
    /// # Errors
    /// What the file system says, with the path.
    pub fn create(directory: &Path) -> io::Result<Self> {
        let named = |error| at(directory, &error);
        std::fs::create_dir_all(directory).map_err(named)?;
        let acts = File::create(directory.join("acts.jsonl")).map_err(named)?;
        Ok(Self { directory: directory.into(), acts })
    }

    /// Appends one act. It is in the file when this returns.
    ///
    /// # Errors
    /// What the file system says, with the path.
    pub fn append(&mut self, record: &ActRecord) -> io::Result<()> {
        let mut line = serde_json::to_vec(record)?;
        line.push(b'\n');
        // One write per line, so that a reader never sees half a line.
        self.acts.write_all(&line).map_err(|error| at(&self.directory, &error))
    }

    /// Writes what was exposed or melted of a layer as `layer_000000.png`, and later passes as `layer_000000_pass_1.png` and so on.
    ///
    /// # Errors
    /// What the file system says, with the path.
    pub fn picture(&self, id: ExposureId, picture: &Bitmap) -> io::Result<()> {
        let ExposureId { layer, pass, .. } = id;
        let of_pass = if pass == 0 { String::new() } else { format!("_pass_{pass}") };
        let path = self.directory.join(format!("layer_{layer:06}{of_pass}.png"));
        write_png(&path, picture).map_err(|error| at(&path, &error))
    }
}

fn at(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("cannot write {}: {error}", path.display()))
}
