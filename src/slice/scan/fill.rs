//! A layer's regions filled by the rules of [`ScanSettings`]: contours, centre lines, points, hatches and skins, in a short order.
//!
//! ```
//! use layerd::layer::{MarkClass, Vectors};
//! use layerd::slice::scan::{Fill, HatchSettings, HatchStrategy, Region, ScanSettings};
//! use layerd::stream::MemoryBudget;
//! let hatch = HatchSettings {
//!     strategy: HatchStrategy::Zigzag,
//!     spacing_um: 60.0,
//!     angle_deg: 0.0,
//!     rotation_deg: 67.0,
//!     end_offset_um: 30.0,
//! };
//! let settings = ScanSettings {
//!     beam_diameter_um: 60.0,
//!     simplify_tolerance_um: 5.0,
//!     contour_count: 1,
//!     contour_offset_um: 30.0,
//!     contour_spacing_um: 60.0,
//!     thin_below_um: 120.0,
//!     contour_only_below_um: 240.0,
//!     point_below_um: 60.0,
//!     shortest_mark_um: 40.0,
//!     hatch: Some(hatch),
//!     up_skin: None,
//!     down_skin: None,
//! };
//! let square = vec![[0.0, 0.0], [1000.0, 0.0], [1000.0, 1000.0], [0.0, 1000.0]];
//! let mut vectors = Vectors::default();
//! let mut fill = Fill::new(settings, 1, &MemoryBudget::new(1 << 20))?;
//! let counts = fill.layer(0, &[Region { outer: square, holes: vec![] }], None, None, &mut vectors)?;
//! assert_eq!((counts.regions, counts.unmarked), (1, 0));
//! let count = |class| vectors.marks().filter(|mark| mark.class == class).count();
//! // Lines at 60, 120 to 900 µm; the border less beam and end offset begins at 60 and ends at 940 µm.
//! assert_eq!((count(MarkClass::Contour), count(MarkClass::Hatch)), (4, 15));
//! # Ok::<(), layerd::slice::scan::FillError>(())
//! ```
//!
//! The memory of a layer is charged to a budget before it is filled, by the size of its regions: work space for the regions that threads
//! fill at the same time, what was found, and the vectors in order. A layer with very many pieces is put in order in several parts, so
//! that the tables of the order are bounded.

use std::time::{Duration, Instant};

use crate::layer::Vectors;
use crate::slice::SliceError;
use crate::slice::workers::Workers;
use crate::stream::{BudgetExceeded, Charge, MemoryBudget};

use super::counts::ScanCounts;
use super::hatch::Cells;
use super::layer_plan::{FillTimes, Filled, LayerPlan};
use super::offset::MAX_FIELD_UM;
use super::path::{distance_um, ring_edges};
use super::pieces::Pieces;
use super::region::Region;
use super::settings::{ScanSettings, SettingsError};
use super::thin::ThinRules;

/// How many regions are filled before their pieces are put together, so that memory does not hold two copies of all.
const BATCH_REGIONS: usize = 256;

/// How many points the borders of a batch have at most, unless it is a single region.
const BATCH_POINTS: usize = 1 << 14;

/// From how many pieces on they are put in order without waiting for more. Their tables take some 50 MB. A layer with more pieces is put in
/// order in several parts, and only the jumps between two parts are longer than they need to be.
const MAX_ORDERED_PIECES: usize = 1 << 16;

/// Memory to fill a region, bytes for each point of its border: edges, pieces of offsets, and the library's segments and graph.
const WORK_BYTES_PER_POINT: u64 = 1500;

/// Most memory of what a region is filled with, bytes for each point of a contour and for each end of a hatch. Its entries in the tables of
/// the order are included.
const FOUND_BYTES_PER_POINT: u64 = 100;
const FOUND_BYTES_PER_END: u64 = 150;

/// Why a layer cannot be filled.
#[derive(Debug, thiserror::Error)]
pub enum FillError {
    /// Settings that contradict each other or are out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A region outside every field.
    #[error(
        "the layer reaches to {at_um} µm; a field reaches from 0 to at most {MAX_FIELD_UM} µm: check where the part is placed"
    )]
    OutsideField {
        /// A coordinate outside, micrometres, or not a number.
        at_um: f64,
    },
    /// The layer is too complex for the memory budget, or the system gives no threads.
    #[error(transparent)]
    Slice(#[from] SliceError),
}

/// Fills layers. The result depends on the layer and the settings alone: not on the number of threads, or the layers before.
pub struct Fill {
    settings: ScanSettings,
    rules: ThinRules,
    workers: Workers,
    budget: MemoryBudget,
    /// What the last layer was charged. It is kept because the vectors are still in use.
    charge: Option<Charge>,
    times: FillTimes,
}

impl Fill {
    /// Checks the settings, and starts `threads` threads, including the calling one. What layers take is charged to `budget`.
    ///
    /// # Errors
    /// [`FillError::Settings`], or [`FillError::Slice`] if the system gives no threads.
    pub fn new(settings: ScanSettings, threads: usize, budget: &MemoryBudget) -> Result<Self, FillError> {
        settings.check()?;
        let rules = ThinRules {
            // Narrower parts have no room for a contour.
            below_um: settings.thin_below_um.max(2.0 * settings.contour_offset_um),
            beam_um: settings.beam_diameter_um,
            contour_um: settings.contour_offset_um,
            point_below_um: settings.point_below_um,
            tolerance_um: settings.simplify_tolerance_um,
        };
        let workers = Workers::new(threads.max(1))?;
        let (budget, times) = (budget.clone(), FillTimes::default());
        Ok(Self { settings, rules, workers, budget, charge: None, times })
    }

    /// Appends the vectors of a layer, counted from 0, in the order in which they are marked. `above` and `below` are the regions of the
    /// layers next to it; if there is none, all of the layer is skin. They change the vectors only if the settings have skins. The memory of
    /// `out` stays charged until the next layer.
    ///
    /// # Errors
    /// [`FillError`]; the vectors are of no use then.
    pub fn layer(
        &mut self,
        layer: u32,
        regions: &[Region],
        above: Option<&[Region]>,
        below: Option<&[Region]>,
        out: &mut Vectors,
    ) -> Result<ScanCounts, FillError> {
        for region in regions.iter().chain(above.into_iter().chain(below).flatten()) {
            check_place(region)?;
        }
        let too_complex = |exceeded| SliceError::TooComplex { layer, exceeded };
        self.charge_layer(regions, above, below, out).map_err(too_complex)?;
        let plan = LayerPlan::new(&self.settings, self.rules, layer, above, below);
        let mut counts = ScanCounts::default();
        let mut all = Pieces::default();
        let mut filled: Vec<Filled> = Vec::new();
        for batch in batches(regions) {
            filled.clear();
            filled.resize_with(batch.len(), Default::default);
            self.workers.each(batch.iter().zip(&mut filled), |(region, filled)| plan.fill(region, filled));
            for of_region in &filled {
                all.append(&of_region.pieces);
                counts += of_region.counts;
                self.times += of_region.times;
            }
            if all.len() >= MAX_ORDERED_PIECES {
                self.times.order += write(&mut all, &plan, out, &mut counts);
            }
        }
        self.times.order += write(&mut all, &plan, out, &mut counts);
        Ok(counts)
    }

    /// Time that the steps took since the start, for benchmarks.
    pub fn times(&self) -> FillTimes {
        self.times
    }

    /// Charges all that a layer takes, so that the message tells how much that is.
    fn charge_layer(
        &mut self,
        regions: &[Region],
        above: Option<&[Region]>,
        below: Option<&[Region]>,
        out: &Vectors,
    ) -> Result<(), BudgetExceeded> {
        let points = |regions: Option<&[Region]>| regions.into_iter().flatten().map(point_count).sum::<u64>();
        // Copies of the regions above and below.
        let mut bytes = if self.settings.has_skins() { 16 * (points(above) + points(below)) } else { 0 };
        let found = regions.iter().map(|region| self.found_bytes(region)).sum::<u64>();
        // Once as found, and once in order.
        bytes += 2 * found + out.memory_bytes() as u64;
        let mut largest: Vec<u64> = regions.iter().map(point_count).collect();
        largest.sort_unstable_by(|a, b| b.cmp(a));
        bytes += WORK_BYTES_PER_POINT * largest.iter().take(self.workers.count()).sum::<u64>();
        self.charge = None;
        self.charge = Some(self.budget.charge("filling the layer with vectors", bytes)?);
        Ok(())
    }

    /// The most that the pieces of a region take, and their part in the tables of the order, bytes.
    fn found_bytes(&self, region: &Region) -> u64 {
        let settings = &self.settings;
        let area_um2 = region.area_um2().max(0.0);
        // No region of this area has room for more contours than a disc.
        let most_contours = 1.0 + (area_um2 / std::f64::consts::PI).sqrt() / settings.contour_spacing_um;
        let inner_contours = 1.0 + settings.contour_only_below_um / 2.0 / settings.contour_spacing_um;
        let contours = most_contours.min(f64::from(settings.contour_count) + inner_contours);
        let mut bytes = FOUND_BYTES_PER_POINT * (point_count(region) as f64 * contours) as u64;
        let length_um: f64 = region.rings().map(|ring| ring_length_um(ring)).sum();
        for hatch in [&settings.hatch, &settings.up_skin, &settings.down_skin].into_iter().flatten() {
            // Each line begins and ends at the border, or at a cell.
            let crossings = length_um / hatch.spacing_um + 2.0;
            let cells =
                Cells::of(hatch.strategy).map_or(0.0, |cells| 2.0 * area_um2 / hatch.spacing_um / cells.pitch_um);
            bytes += FOUND_BYTES_PER_END * (crossings + cells) as u64;
        }
        bytes
    }
}

/// Puts pieces in order, and takes them away. Returns how long that took.
fn write(pieces: &mut Pieces, plan: &LayerPlan<'_>, out: &mut Vectors, counts: &mut ScanCounts) -> Duration {
    let began = Instant::now();
    std::mem::take(pieces).write(&plan.frames, out, counts);
    began.elapsed()
}

/// Neighbouring regions that are filled before their pieces are put together.
fn batches(mut regions: &[Region]) -> impl Iterator<Item = &[Region]> {
    std::iter::from_fn(move || {
        let mut points = 0;
        let fits = |region: &&Region| {
            points += point_count(region) as usize;
            points <= BATCH_POINTS
        };
        let count = regions.iter().take(BATCH_REGIONS).take_while(fits).count().max(1);
        let (batch, rest) = regions.split_at_checked(count)?;
        regions = rest;
        Some(batch)
    })
}

fn point_count(region: &Region) -> u64 {
    region.rings().map(Vec::len).sum::<usize>() as u64
}

fn ring_length_um(ring: &[[f64; 2]]) -> f64 {
    ring_edges(ring).map(|[a, b]| distance_um(a, b)).sum()
}

fn check_place(region: &Region) -> Result<(), FillError> {
    let is_outside = |um: &f64| !(0.0..=MAX_FIELD_UM).contains(um);
    let outside = region.rings().flatten().flatten().copied().find(|um| is_outside(um));
    outside.map_or(Ok(()), |at_um| Err(FillError::OutsideField { at_um }))
}
