//! A layer's regions filled by the rules of [`ScanSettings`]: contours, centre lines, points, hatches and skins, in a short order.
//!
//! ```
//! use layerd::layer::{MarkClass, Vectors};
//! use layerd::slice::scan::{Fill, HatchSettings, HatchStrategy, Neighbours, Region, ScanSettings};
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
//! let counts = fill.layer(0, &[Region { outer: square, holes: vec![] }], Neighbours::default(), &mut vectors)?;
//! assert_eq!((counts.regions, counts.unmarked), (1, 0));
//! let count = |class| vectors.marks().filter(|mark| mark.class == class).count();
//! // Lines at 60, 120 to 900 µm; the border less beam and end offset begins at 60 and ends at 940 µm.
//! assert_eq!((count(MarkClass::Contour), count(MarkClass::Hatch)), (4, 15));
//! # Ok::<(), layerd::slice::scan::FillError>(())
//! ```
//!
//! Regions are filled in groups of neighbours. The memory of each group is charged to a budget before it is taken: work space for the regions
//! that threads fill at the same time, what was found, the tables of the order, and the vectors in order, which are handed on before the next
//! group is filled. So a layer takes no more than its largest group, and a large region is a group by itself. Groups depend on the regions
//! and the settings alone, not on the budget: a layer that fits has the same vectors in any budget.

use std::sync::{Mutex, PoisonError};

use crate::layer::Vectors;
use crate::slice::SliceError;
use crate::slice::workers::Workers;
use crate::stream::{BudgetExceeded, Charge, MemoryBudget};

use super::counts::ScanCounts;
use super::layer_plan::{FillTimes, Filled, LayerPlan};
use super::memory::Room;
use super::offset::MAX_FIELD_UM;
use super::pen::{MAX_ORDERED, Pen, weight};
use super::pieces::{self, Pieces};
use super::region::Region;
use super::settings::{HatchSettings, ScanSettings, SettingsError};
use super::skin::Cover;
use super::thin::ThinRules;

/// How many regions are filled before their pieces are put together, so that memory does not hold two copies of all.
const BATCH_REGIONS: usize = 256;

/// The most that these regions are filled with, bytes, unless it is a single region.
const BATCH_BYTES: u64 = 4 << 20;

/// The most that a region may take to be filled at the same time as others, bytes. A larger region is filled by itself.
const SMALL_REGION_BYTES: u64 = 2 << 20;

/// Memory of a group's pieces above which it is put in order without waiting for more regions, bytes.
const MAX_GROUP_BYTES: u64 = 2 << 20;

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

/// Fills layers. The result depends on the layer and the settings alone: not on the number of threads, the budget, or the layers before.
pub struct Fill {
    settings: ScanSettings,
    rules: ThinRules,
    workers: Workers,
    budget: MemoryBudget,
    /// The charge for the vectors of the last layer, which are still in use.
    whole: Option<Charge>,
    times: FillTimes,
}

/// The regions next to a layer's; `None` at the first or the last layer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Neighbours<'a> {
    /// Those of the layer above.
    pub above: Option<&'a [Region]>,
    /// Those of the layer below.
    pub below: Option<&'a [Region]>,
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
        Ok(Self { settings, rules, workers, budget, whole: None, times })
    }

    /// Appends the vectors of a layer, counted from 0, in the order in which they are marked. If a neighbour is missing, all of the layer is
    /// skin. Neighbours change the vectors only if the settings have skins. The memory of `out` is charged until the next layer; a print
    /// takes [`Fill::groups`] instead.
    ///
    /// # Errors
    /// [`FillError`]; the vectors are of no use then.
    pub fn layer(
        &mut self,
        layer: u32,
        regions: &[Region],
        neighbours: Neighbours<'_>,
        out: &mut Vectors,
    ) -> Result<ScanCounts, FillError> {
        let budget = self.budget.clone();
        let mut whole = None;
        let counts = self.groups(layer, regions, neighbours, |group| {
            // The list may double, and the old one is there until its vectors are in the new.
            let bytes = 3 * (out.memory_bytes() + group.memory_bytes()) as u64;
            drop(whole.take());
            let charge = budget.charge("the vectors of a layer", bytes);
            whole = Some(charge.map_err(|exceeded| SliceError::TooComplex { layer, exceeded })?);
            out.append(group);
            Ok(())
        });
        if let Some(charge) = &mut whole {
            charge.reduce_to(out.memory_bytes() as u64);
        }
        self.whole = whole;
        counts
    }

    /// As [`Fill::layer`], but hands the vectors on in groups, in the order in which they are marked.
    ///
    /// # Errors
    /// [`FillError`], or that of `take`; what was handed on is of no use then.
    pub fn groups<E: From<FillError>>(
        &mut self,
        layer: u32,
        regions: &[Region],
        neighbours: Neighbours<'_>,
        mut take: impl FnMut(&Vectors) -> Result<(), E>,
    ) -> Result<ScanCounts, E> {
        self.whole = None;
        let too_complex = |exceeded| FillError::from(SliceError::TooComplex { layer, exceeded });
        let Neighbours { above, below } = neighbours;
        for region in regions.iter().chain(above.into_iter().chain(below).flatten()) {
            check_place(region)?;
        }
        let _covers = self.charge_covers(neighbours).map_err(too_complex)?;
        let plan = LayerPlan::new(&self.settings, self.rules, layer, above, below);
        let mut pen = Pen::new(layer, &plan.frames, &self.budget);
        let mut counts = ScanCounts::default();
        let mut group = Group::default();
        let mut rest = regions;
        while !rest.is_empty() {
            let (batch, work) = self.next_batch(&plan, &mut rest).map_err(too_complex)?;
            let mut filled = self.fill_batch(&plan, batch).map_err(too_complex)?;
            drop(work);
            let found_bytes = filled.iter_mut().map(Filled::settle).sum();
            let charge = self.budget.charge("the pieces of a layer", found_bytes).map_err(too_complex)?;
            for of_region in &filled {
                counts += of_region.counts;
                self.times += of_region.times;
            }
            if !group.has_room(&filled) {
                group.write(&mut pen, &mut counts, &mut take)?;
            }
            group.add(filled, charge, &self.budget).map_err(too_complex)?;
            if group.pieces.memory_bytes() > MAX_GROUP_BYTES {
                group.write(&mut pen, &mut counts, &mut take)?;
            }
        }
        group.write(&mut pen, &mut counts, &mut take)?;
        self.times.order += pen.time;
        Ok(counts)
    }

    /// Time that the steps took since the start, for benchmarks.
    pub fn times(&self) -> FillTimes {
        self.times
    }

    /// Fills regions, some at a time.
    fn fill_batch(&self, plan: &LayerPlan<'_>, batch: &[Region]) -> Result<Vec<Filled>, BudgetExceeded> {
        let room = if batch.len() == 1 { Room::Of(&self.budget) } else { Room::Charged };
        let mut filled: Vec<Filled> = Vec::with_capacity(batch.len());
        filled.resize_with(batch.len(), Default::default);
        let outcome = Mutex::new(Ok(()));
        self.workers.each(batch.iter().zip(&mut filled), |(region, filled)| {
            if let Err(exceeded) = plan.fill(region, room, filled) {
                *outcome.lock().unwrap_or_else(PoisonError::into_inner) = Err(exceeded);
            }
        });
        outcome.into_inner().unwrap_or_else(PoisonError::into_inner)?;
        Ok(filled)
    }

    /// Charges the index of the layers above and below.
    fn charge_covers(&self, neighbours: Neighbours<'_>) -> Result<Charge, BudgetExceeded> {
        let of = |skin: &Option<HatchSettings>, regions: Option<&[Region]>| {
            skin.as_ref().map_or(0, |_| Cover::bytes(regions.unwrap_or_default()))
        };
        let bytes = of(&self.settings.down_skin, neighbours.below) + of(&self.settings.up_skin, neighbours.above);
        self.budget.charge("the regions above and below the layer", bytes)
    }

    /// Takes neighbouring regions that are filled before their pieces are put together, and charges what that takes.
    fn next_batch<'r>(
        &self,
        plan: &LayerPlan<'_>,
        rest: &mut &'r [Region],
    ) -> Result<(&'r [Region], Charge), BudgetExceeded> {
        let mut work: Vec<u64> = Vec::with_capacity(BATCH_REGIONS);
        let mut bytes = (BATCH_REGIONS * (size_of::<Filled>() + size_of::<u64>())) as u64;
        let mut found_bytes = 0;
        for region in rest.iter().take(BATCH_REGIONS) {
            let memory = plan.memory(region);
            found_bytes += memory.found_bytes();
            let is_large = memory.all_bytes() > SMALL_REGION_BYTES;
            if is_large && work.is_empty() {
                let (batch, others) = rest.split_at(1);
                *rest = others;
                bytes += memory.areas_bytes + memory.contours_bytes;
                return Ok((batch, self.budget.charge("filling a region with vectors", bytes)?));
            }
            if is_large || found_bytes > BATCH_BYTES {
                found_bytes -= memory.found_bytes();
                break;
            }
            work.push(memory.work_bytes());
        }
        let (batch, others) = rest.split_at(work.len());
        *rest = others;
        work.sort_unstable_by(|a, b| b.cmp(a));
        bytes += work.iter().take(self.workers.count()).sum::<u64>() + found_bytes;
        Ok((batch, self.budget.charge("filling regions with vectors", bytes)?))
    }
}

/// Pieces of neighbouring regions that are put in order together.
#[derive(Default)]
struct Group {
    pieces: Pieces,
    charge: Option<Charge>,
}

impl Group {
    /// Whether it can be put in order at once with what these regions are filled with.
    fn has_room(&self, filled: &[Filled]) -> bool {
        let weight_of = |pieces: &Pieces| weight(pieces.way_count(), pieces.all().len());
        let added: usize = filled.iter().map(|filled| weight_of(&filled.pieces)).sum();
        weight_of(&self.pieces) + added <= MAX_ORDERED
    }

    /// Adds what regions are filled with, and what it was charged.
    fn add(&mut self, mut filled: Vec<Filled>, charge: Charge, budget: &MemoryBudget) -> Result<(), BudgetExceeded> {
        if let (true, [one]) = (self.pieces.all().is_empty(), filled.as_mut_slice()) {
            self.pieces = std::mem::take(&mut one.pieces);
            self.charge = Some(charge);
            return Ok(());
        }
        let sum = |sum: [usize; 3], of: [usize; 3]| [0, 1, 2].map(|number| sum[number] + of[number]);
        let added = filled.iter().map(|filled| filled.pieces.sizes()).fold([0; 3], sum);
        let grown = budget.charge("the pieces of a layer", pieces::bytes(sum(added, self.pieces.sizes())))?;
        self.pieces.reserve(added);
        for of_region in &filled {
            self.pieces.append(&of_region.pieces);
        }
        // This frees the charges of the old list and of what the regions were filled with.
        self.charge = Some(grown);
        Ok(())
    }

    /// Puts all pieces in order, and takes them away.
    fn write<E: From<FillError>>(
        &mut self,
        pen: &mut Pen<'_>,
        counts: &mut ScanCounts,
        take: &mut impl FnMut(&Vectors) -> Result<(), E>,
    ) -> Result<(), E> {
        if self.pieces.all().is_empty() {
            return Ok(());
        }
        pen.write(&self.pieces, counts, take)?;
        *self = Self::default();
        Ok(())
    }
}

fn check_place(region: &Region) -> Result<(), FillError> {
    let is_outside = |um: &f64| !(0.0..=MAX_FIELD_UM).contains(um);
    let outside = region.rings().flatten().flatten().copied().find(|um| is_outside(um));
    outside.map_or(Ok(()), |at_um| Err(FillError::OutsideField { at_um }))
}
