//! A part ready to print: placed on a machine, its memory counted, its layers on demand. [`pipeline`](super) has an example.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use super::{PartError, PrintMemory, Scan, ScannedLayers};
use crate::buildfile::BuildFile;
use crate::config::Recipe;
use crate::device::encoding::{self, Choice, LayerEncoder};
use crate::device::{BYTES_PER_MARK, Passes, ScanClock, ScanTimes};
use crate::layer::Bitmap;
use crate::link::message::Encoding;
use crate::slice::scan::ScanCounts;
use crate::slice::{BodySource, FieldSource, Footing, Inspection, SlicePlan, Slicer, dark_top};
use crate::stream::{Ahead, Charge, MemoryBudget, StreamError};

/// Most layers at the top that are looked at: as many as at the bottom.
const MAX_TOP_LAYERS: u32 = 16;

/// A layer as it goes to the device.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedLayer {
    /// Number of its exposure, as in [`Passes`]; that of the layer in a part of one material.
    pub exposure: u32,
    /// Its encoding.
    pub encoding: Encoding,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// CRC-32 of the decoded rows or vectors.
    pub decoded_crc32: u32,
    /// What marking it means; of scan vectors alone.
    pub scan: Option<ScanReport>,
}

/// How long marking a layer takes, and what became of its regions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanReport {
    /// How long marking takes.
    pub times: ScanTimes,
    /// What became of its regions.
    pub counts: ScanCounts,
}

/// A build file placed on a machine, whose print fits a memory budget. It holds neither the file nor its index.
#[derive(Debug)]
pub struct Part {
    path: PathBuf,
    plan: SlicePlan,
    threads: usize,
    queue_bytes: u64,
    buffer_bytes: u64,
    scan: Option<Scan>,
}

impl Part {
    /// A part whose print, within `limit_bytes`, takes this memory. `scan` says how it becomes scan vectors, if it does.
    pub(super) fn new(
        path: PathBuf,
        plan: SlicePlan,
        scan: Option<Scan>,
        memory: &PrintMemory,
        limit_bytes: u64,
    ) -> Self {
        let (queue_bytes, buffer_bytes) = (memory.queue_bytes(limit_bytes), memory.buffer_bytes(limit_bytes));
        Self { path, plan, threads: memory.threads, queue_bytes, buffer_bytes, scan }
    }

    /// Number of layers.
    pub fn layer_count(&self) -> u32 {
        self.plan.layer_count
    }

    /// The exposures of its layers.
    pub fn passes(&self) -> Passes {
        Passes::single(self.plan.layer_count)
    }

    /// Reads and checks every byte of the file. Blocks. How far patches reach is found out within `limit_bytes`, with one height map
    /// at a time; with `None` it is left out, and [`Part::verify_reach`] does it.
    ///
    /// # Errors
    /// [`PartError::File`] says what is damaged.
    pub fn verify(&self, limit_bytes: Option<u64>) -> Result<(), PartError> {
        let file = BuildFile::open(&self.path)?;
        match limit_bytes {
            Some(limit_bytes) => verify(&file, limit_bytes),
            None => Ok(file.verify_without_reach()?),
        }
    }

    /// As [`Part::verify`], of a part with patches. Of others, nothing is read.
    ///
    /// # Errors
    /// As [`Part::verify`].
    pub fn verify_reach(&self, limit_bytes: u64) -> Result<(), PartError> {
        let file = BuildFile::open(&self.path)?;
        if file.verify_bytes() > 0 { verify(&file, limit_bytes) } else { Ok(()) }
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

    /// Looks at the surfaces of the part in all layers, or in as many as there is `time` for. Calls `told` with each. It takes the memory of a
    /// slicer twice.
    ///
    /// # Errors
    /// [`PartError`] if a layer cannot be computed.
    pub fn inspect(&self, time: Duration, told: impl FnMut(u32)) -> Result<Inspection, PartError> {
        let file = Arc::new(BuildFile::open(&self.path)?);
        Ok(Inspection::of(|| BodySource::of(&file), &self.plan, self.threads, time, told)?)
    }

    /// Number of dark layers at the top, of which 16 are looked at. Takes as much memory as a print.
    ///
    /// # Errors
    /// [`PartError`] if a layer cannot be computed within `limit_bytes`.
    pub fn dark_top_layers(&self, limit_bytes: u64) -> Result<u32, PartError> {
        let first = self.plan.layer_count.saturating_sub(MAX_TOP_LAYERS);
        Ok(dark_top(&mut self.slicer(first, &MemoryBudget::new(limit_bytes))?)?)
    }

    fn slicer(&self, first: u32, budget: &MemoryBudget) -> Result<Slicer, PartError> {
        Ok(Slicer::new(self.bodies()?, self.plan.clone(), self.threads, first, budget)?)
    }

    /// The bodies of the file, opened anew.
    fn bodies(&self) -> Result<Vec<BodySource>, PartError> {
        Ok(BodySource::of(&Arc::new(BuildFile::open(&self.path)?)))
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
        let buffers = budget.charge("the layer and the line's buffers", self.buffer_bytes)?;
        let source = match &self.scan {
            None => {
                let raster = &self.plan.raster;
                let bitmap = Bitmap::new(raster.width_px, raster.height_px, self.plan.depth);
                Source::Pictures { slicer: self.slicer(first, budget)?, bitmap }
            }
            Some(scan) => {
                let bodies = self.bodies()?.into_iter().map(FieldSource::Whole).collect();
                let plan = self.plan.clone();
                let layers = ScannedLayers::new(bodies, plan, &scan.settings, self.threads, first, budget)?;
                Source::Vectors { layers: Box::new(layers), scan: Box::new(scan.clone()) }
            }
        };
        let max_bytes = self.queue_bytes as usize;
        Ok(EncodedLayers { source, encoding, bytes: Vec::new(), max_bytes, budget: budget.clone(), _buffers: buffers })
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

fn verify(file: &BuildFile, limit_bytes: u64) -> Result<(), PartError> {
    let _charge = MemoryBudget::new(limit_bytes).charge("the check of a height map", file.verify_bytes())?;
    Ok(file.verify()?)
}

/// The layers of a part, computed and encoded one after the other.
pub struct EncodedLayers {
    source: Source,
    encoding: Choice,
    bytes: Vec<u8>,
    /// The most bytes of a layer of scan vectors.
    max_bytes: usize,
    budget: MemoryBudget,
    _buffers: Charge,
}

/// Where layers come from. What holds one is overwritten by the next.
enum Source {
    Pictures { slicer: Slicer, bitmap: Bitmap },
    Vectors { layers: Box<ScannedLayers>, scan: Box<Scan> },
}

impl EncodedLayers {
    /// The next layer; `None` after the last.
    fn encode_next(&mut self) -> Result<Option<EncodedLayer>, PartError> {
        let bytes = &mut self.bytes;
        let (layer, encoding, decoded_crc32, scan) = match &mut self.source {
            Source::Pictures { slicer, bitmap } => {
                let Some(layer) = slicer.next_layer(bitmap)? else { return Ok(None) };
                let encoding = encoding::encode_shortest(bitmap, self.encoding, bytes)?;
                (layer, encoding, encoding::picture_crc32(bitmap), None)
            }
            Source::Vectors { layers, scan } => {
                let encoding = self.encoding.encoding;
                let vectors = encoding.vectors().ok_or(PartError::NoVectors(encoding))?;
                bytes.clear();
                // All of it is charged. What is not used takes no real memory.
                bytes.reserve_exact(self.max_bytes);
                let Scan { field_um, lasers, settings, axes, .. } = scan.as_ref();
                let mut encoder = LayerEncoder::new(vectors, *field_um, lasers, &settings.classes(), bytes)?;
                let mut clock = ScanClock::new(lasers, axes.as_ref());
                let next = layers.next_groups(|group| {
                    let moves_bytes = axes.map_or(0, |_| BYTES_PER_MARK * group.mark_count());
                    let moves = self.budget.charge("how long axes take for a layer", moves_bytes)?;
                    clock.add(group);
                    drop(moves);
                    encoder.add(group)?;
                    fits(encoder.written_bytes(), self.max_bytes)
                })?;
                let Some((layer, counts)) = next else { return Ok(None) };
                let sum = encoder.finish()?;
                fits(bytes.len(), self.max_bytes)?;
                (layer, encoding, sum.crc32, Some(ScanReport { times: clock.times(), counts }))
            }
        };
        Ok(Some(EncodedLayer { exposure: layer, encoding, bytes: bytes.clone(), decoded_crc32, scan }))
    }
}

/// Whether a layer, as far as it is written, fits the queue that has to take it.
fn fits(layer_bytes: usize, queue_bytes: usize) -> Result<(), PartError> {
    let (layer_bytes, queue_bytes) = (layer_bytes as u64, queue_bytes as u64);
    if layer_bytes <= queue_bytes {
        Ok(())
    } else {
        Err(StreamError::LayerTooLarge { layer_bytes, queue_bytes }.into())
    }
}

impl Iterator for EncodedLayers {
    type Item = Result<EncodedLayer, PartError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.encode_next().transpose()
    }
}
