//! A part ready to print: placed on a machine, its memory counted, its layers on demand. [`pipeline`](super) has an example.

use std::path::PathBuf;
use std::sync::Arc;

use super::{PartError, PrintMemory};
use crate::buildfile::BuildFile;
use crate::config::Recipe;
use crate::device::encoding::{self, Choice};
use crate::layer::{Bitmap, Layer};
use crate::link::message::Encoding;
use crate::slice::{BodySource, Footing, SlicePlan, Slicer};
use crate::stream::{Ahead, Charge, MemoryBudget};

/// A layer as it goes to the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodedLayer {
    /// Its number.
    pub layer: u32,
    /// Its encoding.
    pub encoding: Encoding,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// CRC-32 of the decoded rows.
    pub decoded_crc32: u32,
}

/// A build file placed on a machine, whose print fits a memory budget. It holds neither the file nor its index.
#[derive(Debug)]
pub struct Part {
    path: PathBuf,
    plan: SlicePlan,
    threads: usize,
    queue_bytes: u64,
    buffer_bytes: u64,
}

impl Part {
    /// A part whose print, within `limit_bytes`, takes this memory.
    pub(super) fn new(path: PathBuf, plan: SlicePlan, memory: &PrintMemory, limit_bytes: u64) -> Self {
        let queue_bytes = memory.queue_bytes(limit_bytes);
        let PrintMemory { threads, buffer_bytes, .. } = *memory;
        Self { path, plan, threads, queue_bytes, buffer_bytes }
    }

    /// Number of layers.
    pub fn layer_count(&self) -> u32 {
        self.plan.layer_count
    }

    /// Computes the bottom layers: would the part hold to the plate? Needs as much memory as a print, so none may be under way.
    ///
    /// # Errors
    /// [`PartError`] if a layer cannot be computed within `limit_bytes`.
    pub fn footing(&self, recipe: &Recipe, limit_bytes: u64) -> Result<Footing, PartError> {
        let bottom_layers = match recipe {
            Recipe::Dlp(recipe) => recipe.bottom_layers,
            Recipe::Slm(_) => 1,
        };
        let mut slicer = self.slicer(0, &MemoryBudget::new(limit_bytes))?;
        Ok(Footing::of(&mut slicer, bottom_layers)?)
    }

    fn slicer(&self, first: u32, budget: &MemoryBudget) -> Result<Slicer, PartError> {
        let file = BuildFile::open(&self.path)?;
        Ok(Slicer::new(BodySource::of(&Arc::new(file)), self.plan.clone(), self.threads, first, budget)?)
    }

    /// Computes the layers from `first` on, written in `encoding`, each when it is asked for. What that takes is charged to `budget`.
    ///
    /// # Errors
    /// [`PartError`] if the file cannot be opened or the budget has no room.
    pub fn encoded_layers(
        &self,
        first: u32,
        encoding: Choice,
        budget: &MemoryBudget,
    ) -> Result<EncodedLayers, PartError> {
        let buffers = budget.charge("the picture and the line's buffers", self.buffer_bytes)?;
        let slicer = self.slicer(first, budget)?;
        let raster = &self.plan.raster;
        let layer = Bitmap::new(raster.width_px, raster.height_px, self.plan.depth).into();
        Ok(EncodedLayers { slicer, layer, encoding, bytes: Vec::new(), _buffers: buffers })
    }

    /// Starts computing layers ahead, from `first` on. `explain` puts an error into words.
    ///
    /// # Errors
    /// As [`Part::encoded_layers`].
    pub(super) fn ahead(
        &self,
        first: u32,
        encoding: Choice,
        budget: &MemoryBudget,
        explain: fn(&PartError) -> String,
    ) -> Result<Ahead<EncodedLayer>, PartError> {
        let mut layers = self.encoded_layers(first, encoding, budget)?;
        let produce = move || {
            let layer = layers.next().transpose().map_err(|error| explain(&error))?;
            Ok(layer.map(|layer| {
                let bytes = layer.bytes.len() as u64;
                (layer, bytes)
            }))
        };
        Ok(Ahead::start(budget, self.queue_bytes, produce)?)
    }
}

/// The layers of a part, computed and encoded one after the other.
pub struct EncodedLayers {
    slicer: Slicer,
    /// Overwritten by each layer.
    layer: Layer,
    encoding: Choice,
    bytes: Vec<u8>,
    _buffers: Charge,
}

impl Iterator for EncodedLayers {
    type Item = Result<EncodedLayer, PartError>;

    fn next(&mut self) -> Option<Self::Item> {
        let Layer::Bitmap(bitmap) = &mut self.layer;
        let layer = match self.slicer.next_layer(bitmap) {
            Ok(layer) => layer?,
            Err(error) => return Some(Err(error.into())),
        };
        let encoded = encoding::encode_layer(&self.layer, self.encoding, &mut self.bytes);
        Some(encoded.map_err(PartError::from).map(|(encoding, decoded_crc32)| EncodedLayer {
            layer,
            encoding,
            bytes: self.bytes.clone(),
            decoded_crc32,
        }))
    }
}
