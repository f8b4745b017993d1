//! Facets of patches, kept for the next layers: dividing a patch takes longer than cutting its facets. `patches` divides. `tests/relief/`
//! compares layers with formulas, and with those of other starts and other numbers of threads.
//!
//! The picture is divided into blocks of rows. The slab of a block is what lies between two planes some layers apart. The first plane in a
//! slab fills it; patches that begin higher are added at the plane that reaches them. All slabs share a fixed number of pages. A slab for
//! which too few are left has fewer layers; if there is no room for a single one, its patches are divided each time that they are drawn.

use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard};

use super::ROWS_PER_BAND;
use super::active::Active;
use super::patches::Dicer;
use crate::buildfile::Patch;
use crate::slice::SlicePlan;
use crate::solid::{Facet, Window};

/// Rows of a block: a band then needs one or two.
const ROWS_PER_BLOCK: usize = ROWS_PER_BAND;

/// Most layers of a slab. With 16 layers and steep surfaces, about half of the facets cross an end of the slab and are divided again in the
/// next slab. More layers save little, and each plane then passes over more facets.
const MAX_LAYERS: u32 = 16;

/// Facets for each row and column of a picture: 16 layers of a wall 1.5 times as long as the picture's border, with 2 facets a pixel and layer.
const FACETS_PER_PX: usize = 96;

/// Most facets: 16 MB, a quarter of what a print has by default.
const MAX_FACETS: usize = 200_000;

/// Facets of a page: so few that a block with a single facet does not take much.
const FACETS_PER_PAGE: usize = 256;

/// Facets of one slab. It has no more room than it is created with.
struct Page {
    /// A range of z around each facet. Most facets of a slab are passed over, so they are not looked at.
    spans: Vec<[f32; 2]>,
    facets: Vec<Facet>,
}

impl Page {
    /// Memory of a page, bytes.
    const BYTES: usize = (size_of::<Facet>() + size_of::<[f32; 2]>()) * FACETS_PER_PAGE;

    fn new() -> Self {
        Self { spans: Vec::with_capacity(FACETS_PER_PAGE), facets: Vec::with_capacity(FACETS_PER_PAGE) }
    }

    fn is_full(&self) -> bool {
        self.facets.len() == FACETS_PER_PAGE
    }

    fn add(&mut self, facet: &Facet) {
        let [a, b, c] = facet.map(|corner| corner[2]);
        self.spans.push([a.min(b).min(c) as f32, a.max(b).max(c) as f32]);
        self.facets.push(*facet);
    }

    fn clear(&mut self) {
        self.spans.clear();
        self.facets.clear();
    }

    /// The facets that a plane at `z` may cut.
    fn at(&self, z: f64) -> impl Iterator<Item = &Facet> {
        // Rounding keeps the order, so no facet is passed over by mistake.
        let z = z as f32;
        let both = self.spans.iter().zip(&self.facets);
        both.filter_map(move |([low, high], facet)| (*low <= z && *high >= z).then_some(facet))
    }
}

/// The slabs of all blocks.
pub(super) struct Slabs {
    blocks: Vec<RwLock<Slab>>,
    /// Pages that are not in use.
    free: Mutex<Vec<Page>>,
    page_count: usize,
    /// y of the first row, and from one row to the next, quanta.
    row_0: f64,
    row_step: f64,
    /// Height of a layer, quanta.
    layer: f64,
}

/// The patches that a plane may cut, and what divides them.
#[derive(Clone, Copy)]
pub(super) struct Patches<'a> {
    pub(super) active: &'a Active<Patch>,
    pub(super) dicer: &'a Dicer,
}

/// The slab of one block.
struct Slab {
    /// The plane for which it was used last. Facets of all patches that begin at or below it are in the pages.
    plane: f64,
    /// The highest plane that it can be used for.
    top: f64,
    /// Number of its layers.
    layers: u32,
    pages: Vec<Page>,
    /// Whether there is no room for its facets. The pages are then empty.
    is_too_full: bool,
}

impl Slabs {
    /// Slabs for the pictures of a plan.
    pub(super) fn new(plan: &SlicePlan, quantum_um: f64) -> Self {
        let slab = || Slab {
            plane: f64::NEG_INFINITY,
            top: f64::NEG_INFINITY,
            layers: 1,
            pages: Vec::new(),
            is_too_full: false,
        };
        let page_count = page_count(plan);
        Self {
            blocks: (0..block_count(plan)).map(|_| RwLock::new(slab())).collect(),
            free: Mutex::new((0..page_count).map(|_| Page::new()).collect()),
            page_count,
            row_0: plan.origin_um[1] / quantum_um,
            row_step: plan.step_um()[1] / quantum_um,
            layer: plan.layer_height_um / quantum_um,
        }
    }

    /// Their memory, bytes.
    pub(super) fn bytes(plan: &SlicePlan) -> u64 {
        // The lists of the blocks have room for at most twice as many pages as there are, and the first grows to four.
        let page = Page::BYTES + 3 * size_of::<Page>();
        let block = size_of::<RwLock<Slab>>() + 4 * size_of::<Page>();
        (page_count(plan) * page + block_count(plan) * block) as u64
    }

    /// Hands on the facets that a plane at `z` may cut in some rows, each once, until `take` returns false.
    pub(super) fn facets(&self, patches: Patches<'_>, z: f64, rows: Range<i64>, mut take: impl FnMut(&Facet) -> bool) {
        let wanted = Window { y: self.ys(rows.clone()), z: [z, z] };
        let [first, last] = [self.block(rows.start), self.block(rows.end - 1)];
        for block in first..=last {
            // What reaches into the block before was handed on with that.
            let before = (block > first).then(|| Window { y: self.block_ys(block - 1), z: [z, z] });
            let mut take = |facet: &Facet| {
                let is_new = wanted.meets(facet) && before.is_none_or(|before| !before.meets(facet));
                !is_new || take(facet)
            };
            let slab = self.slab(block, patches, z);
            let goes_on = if slab.is_too_full {
                drop(slab);
                // Of what is wanted, the part in this block.
                let [ours, block_ys] = [wanted.y, self.block_ys(block)];
                let window = Window { y: [ours[0].max(block_ys[0]), ours[1].min(block_ys[1])], z: [z, z] };
                patches.active.reaching(self.rows_of(block)).all(|patch| patches.dicer.dice(patch, window, &mut take))
            } else {
                slab.pages.iter().flat_map(|page| page.at(z)).all(take)
            };
            if !goes_on {
                return;
            }
        }
    }

    /// The slab of a block, with all facets that a plane cuts.
    fn slab(&self, block: usize, patches: Patches<'_>, z: f64) -> RwLockReadGuard<'_, Slab> {
        loop {
            let slab = self.blocks[block].read().unwrap_or_else(PoisonError::into_inner);
            if slab.plane == z {
                return slab;
            }
            drop(slab);
            let mut slab = self.blocks[block].write().unwrap_or_else(PoisonError::into_inner);
            // Another thread may have been faster.
            if slab.plane != z {
                self.move_up(block, &mut slab, patches, z);
            }
        }
    }

    /// Moves the plane of a slab up to `z`.
    fn move_up(&self, block: usize, slab: &mut Slab, patches: Patches<'_>, z: f64) {
        let has_room = z <= slab.top && (slab.is_too_full || self.fill(block, slab, patches, [z, slab.top]));
        if !has_room {
            // Of planes far apart, each needs a slab of its own.
            let is_next = z - slab.plane < 1.5 * self.layer;
            self.clear(slab);
            let layers = if is_next { self.layers(slab.layers) } else { 1 };
            self.renew(block, slab, patches, z, layers);
        }
        slab.plane = z;
    }

    /// The number of layers of the next slab of a block: more as long as half of the pages are free, fewer when most are in use, so that other
    /// blocks get some.
    fn layers(&self, last: u32) -> u32 {
        let free = self.free().len();
        let layers = if 2 * free > self.page_count {
            2 * last
        } else if 8 * free < self.page_count {
            last / 2
        } else {
            last
        };
        layers.clamp(1, MAX_LAYERS)
    }

    /// Fills an empty slab from `z` on: with so many layers, or with as many as there is room for.
    fn renew(&self, block: usize, slab: &mut Slab, patches: Patches<'_>, z: f64, layers: u32) {
        // Half a layer more, because heights of planes are rounded.
        let top = |layers: u32| z + (f64::from(layers) - 0.5) * self.layer;
        slab.layers = layers;
        loop {
            slab.top = top(slab.layers);
            if self.fill(block, slab, patches, [z, slab.top]) {
                return;
            }
            self.clear(slab);
            if slab.layers == 1 {
                slab.is_too_full = true;
                // Trying again costs up to as much as drawing. There is a point in it if others took the room.
                let free = self.free().len();
                slab.top = if 2 * free > self.page_count { top(MAX_LAYERS) } else { z };
                return;
            }
            slab.layers /= 2;
        }
    }

    /// Adds the facets of all patches that begin above the plane of the slab, from one height to another. Returns false if there is no room.
    fn fill(&self, block: usize, slab: &mut Slab, patches: Patches<'_>, z: [f64; 2]) -> bool {
        let window = Window { y: self.block_ys(block), z };
        let plane = slab.plane;
        let mut new = patches.active.reaching(self.rows_of(block)).filter(|patch| f64::from(patch.z[0]) > plane);
        new.all(|patch| patches.dicer.dice(patch, window, |facet| self.add(&mut slab.pages, facet)))
    }

    /// Adds a facet to some pages. Returns false if there is no room.
    fn add(&self, pages: &mut Vec<Page>, facet: &Facet) -> bool {
        if pages.last().is_none_or(Page::is_full) {
            let Some(page) = self.free().pop() else { return false };
            pages.push(page);
        }
        pages.last_mut().is_some_and(|page| {
            page.add(facet);
            true
        })
    }

    /// Empties a slab.
    fn clear(&self, slab: &mut Slab) {
        slab.pages.iter_mut().for_each(Page::clear);
        // Their list goes, too.
        self.free().extend(std::mem::take(&mut slab.pages));
        (slab.plane, slab.is_too_full) = (f64::NEG_INFINITY, false);
    }

    /// The pages that are not in use.
    fn free(&self) -> MutexGuard<'_, Vec<Page>> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The block of a row.
    fn block(&self, row: i64) -> usize {
        row.div_euclid(ROWS_PER_BLOCK as i64).clamp(0, self.blocks.len() as i64 - 1) as usize
    }

    /// The range of y of some rows. Rows of samples, and shifted rows, lie up to half a row from the middle of a row.
    fn ys(&self, rows: Range<i64>) -> [f64; 2] {
        let [one, other] = [rows.start - 1, rows.end].map(|row| self.row_0 + row as f64 * self.row_step);
        [one.min(other), one.max(other)]
    }

    /// The range of y of a block.
    fn block_ys(&self, block: usize) -> [f64; 2] {
        self.ys(self.rows_of(block))
    }

    /// The rows of a block. What lies beyond the picture belongs to the first or the last.
    fn rows_of(&self, block: usize) -> Range<i64> {
        let [first, end] = [block, block + 1].map(|block| (block * ROWS_PER_BLOCK) as i64);
        let is_last = block + 1 == self.blocks.len();
        (if block == 0 { -BEYOND } else { first })..(if is_last { BEYOND } else { end })
    }
}

/// More rows than any picture has.
const BEYOND: i64 = 1 << 32;

fn block_count(plan: &SlicePlan) -> usize {
    (plan.raster.height_px as usize).div_ceil(ROWS_PER_BLOCK).max(1)
}

fn page_count(plan: &SlicePlan) -> usize {
    let px = plan.raster.width_px as usize + plan.raster.height_px as usize;
    (px * FACETS_PER_PX).min(MAX_FACETS).div_ceil(FACETS_PER_PAGE)
}
