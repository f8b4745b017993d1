//! A build file on a machine's raster. [`pipeline`](super) has an example.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Part, PartError, PrintMemory, Scan, ScannedLayers};
use crate::buildfile::{BuildFile, Header};
use crate::config::{Machine, Recipe};
use crate::layer::{Depth, Raster};
use crate::slice::scan::Contours;
use crate::slice::{BodySource, FieldSource, MaskSlicer, MaskSources, SlicePlan, Slicer};
use crate::stream::MemoryBudget;

/// Memory for the crossings and regions of three layers outside a print, bytes: ten million crossings of the grid, which is more than
/// the largest lattices have in a layer.
const MAX_LAYER_BYTES: u64 = 512 << 20;

/// The pixels and the height of a layer, as machine and recipe say.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolution {
    /// The machine's grid of pixels.
    pub raster: Raster,
    /// Bits a pixel, of a layer of pixels.
    pub depth: Depth,
    /// Layer height, micrometres.
    pub layer_height_um: f64,
    /// How layers become scan vectors; `None` if they are pictures.
    pub scan: Option<Scan>,
}

impl Resolution {
    /// That of a recipe on a machine.
    pub fn of(machine: &Machine, recipe: &Recipe) -> Self {
        let depth = match recipe {
            Recipe::Dlp(recipe) => recipe.depth(),
            Recipe::Slm(_) => Depth::Bit,
        };
        let (raster, layer_height_um) = (machine.raster(), recipe.layer_height_um());
        let scan = match (machine, recipe) {
            (Machine::Slm(machine), Recipe::Slm(recipe)) => Some(Scan::of(machine, recipe)),
            _ => None,
        };
        Self { raster, depth, layer_height_um, scan }
    }
}

/// A build file placed on a machine. It holds the file's index in memory, which no budget counts: a print keeps a [`Part`].
#[derive(Debug)]
pub struct Placed {
    path: PathBuf,
    file: Arc<BuildFile>,
    plan: SlicePlan,
    scan: Option<Scan>,
}

impl Placed {
    /// Opens a build file and checks that it fits the machine, from its header and index alone.
    ///
    /// # Errors
    /// [`PartError::File`], or [`PartError::Plan`] if it does not fit.
    pub fn open(path: &Path, resolution: &Resolution) -> Result<Self, PartError> {
        let file = Arc::new(BuildFile::open(path)?);
        let Resolution { raster, depth, layer_height_um, ref scan } = *resolution;
        let plan = SlicePlan::new(file.header(), raster, depth, layer_height_um)?;
        Ok(Self { path: path.into(), file, plan, scan: scan.clone() })
    }

    /// The file's header.
    pub fn header(&self) -> &Header {
        self.file.header()
    }

    /// The most struts that one layer cuts, at most.
    pub fn peak_active(&self) -> u64 {
        self.file.peak_active()
    }

    /// The pixels and planes of its layers.
    pub fn plan(&self) -> &SlicePlan {
        &self.plan
    }

    /// Memory of a print with as many of `max_threads` threads as `limit_bytes` allow.
    pub fn memory(&self, max_threads: usize, limit_bytes: u64) -> PrintMemory {
        PrintMemory::within(&self.file, &self.plan, self.scan.is_some(), max_threads, limit_bytes)
    }

    /// The part, to be printed with at most `max_threads` threads within `limit_bytes`.
    ///
    /// # Errors
    /// [`PartError::Memory`] if the budget is too small, or [`PartError::Materials`].
    pub fn fit(self, max_threads: usize, limit_bytes: u64) -> Result<Part, PartError> {
        self.check_materials()?;
        let memory = self.memory(max_threads, limit_bytes);
        let need_bytes = memory.need_bytes();
        if need_bytes > limit_bytes {
            return Err(PartError::Memory { need_bytes, limit_bytes });
        }
        Ok(Part::new(self.path, self.plan, self.scan, &memory, limit_bytes))
    }

    /// Whether a machine can print its materials.
    ///
    /// # Errors
    /// [`PartError::Materials`] if there are several.
    pub fn check_materials(&self) -> Result<(), PartError> {
        match &self.header().materials {
            Some(materials) if materials.names.len() > 1 => Err(PartError::Materials(materials.names.clone())),
            _ => Ok(()),
        }
    }

    /// The layers from `first` on as scan vectors, outside a print; `None` if they are pictures. Of `material` alone, if one is given, by its place
    /// in the list of the file.
    ///
    /// # Errors
    /// [`PartError`] if the settings contradict each other, or the first layers cannot be computed.
    pub fn scanned(
        &self,
        material: Option<u8>,
        threads: usize,
        first: u32,
    ) -> Result<Option<ScannedLayers>, PartError> {
        let Some(Scan { settings, .. }) = &self.scan else { return Ok(None) };
        let bodies = match material {
            Some(material) => FieldSource::of_material(&self.file, material)?,
            None => BodySource::of(&self.file).into_iter().map(FieldSource::Whole).collect(),
        };
        let fixed_bytes = Contours::memory_bytes_of_sources(&bodies, &self.plan, threads);
        let budget = MemoryBudget::new(fixed_bytes.saturating_add(MAX_LAYER_BYTES));
        ScannedLayers::new(bodies, self.plan.clone(), settings, threads, first, &budget).map(Some)
    }

    /// As [`Placed::slicer`], of masks, one for each material.
    ///
    /// # Errors
    /// [`PartError::Slice`].
    pub fn mask_slicer(self, threads: usize, first: u32) -> Result<MaskSlicer, PartError> {
        let sources = MaskSources::of(&self.file);
        let budget = MemoryBudget::new(MaskSlicer::memory_bytes(&sources, &self.plan, threads));
        Ok(MaskSlicer::new(sources, self.plan, threads, first, &budget)?)
    }

    /// A slicer outside a print, which begins with layer `first`; its memory budget is its own estimate.
    ///
    /// # Errors
    /// [`PartError::Slice`].
    pub fn slicer(self, threads: usize, first: u32) -> Result<Slicer, PartError> {
        let bodies = BodySource::of(&self.file);
        let budget = MemoryBudget::new(Slicer::memory_bytes(&bodies, &self.plan, threads));
        Ok(Slicer::new(bodies, self.plan, threads, first, &budget)?)
    }
}
