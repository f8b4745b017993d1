//! The sweep plane of a surface. Its elements, triangles or patches, are read in ascending order. One joins the active set when the plane
//! reaches its lowest point, and leaves it when the plane has passed its highest. `tests/surface/` and `tests/relief/` test it.

use super::ROWS_PER_BAND;
use super::active::Active;
use super::element::{Element, Extent};
use crate::slice::body::buckets::Rows;
use crate::slice::body::feed::Feed;
use crate::slice::body::source::ChunkSource;
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::stream::{Charge, MemoryBudget};

/// Reads elements from a source while the plane rises, and keeps those that it cuts.
pub(super) struct Sweep<E: Element> {
    source: Box<dyn ChunkSource<E>>,
    cutter: E::Cutter,
    rows: Rows,
    max_active: usize,
    last: i64,
    active: Active<E::Kept>,
    feed: Feed<E>,
    _charge: Charge,
}

impl<E: Element> Sweep<E> {
    /// A sweep that can begin at any plane.
    pub(super) fn new(
        source: Box<dyn ChunkSource<E>>,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let bytes = Self::memory_bytes(&*source, plan, threads);
        let charge = budget.charge("the triangles that one layer cuts, height maps and facets", bytes)?;
        let max_active = usize::try_from(source.peak_active()).unwrap_or(usize::MAX);
        Ok(Self {
            cutter: E::cutter(&*source, plan)?,
            rows: Rows::of(plan, source.quantum_um(), 0.0),
            max_active,
            last: i64::MIN,
            active: Active::new(max_active, plan.raster.height_px as usize, ROWS_PER_BAND),
            feed: Feed::new(&*source, threads),
            _charge: charge,
            source,
        })
    }

    /// Memory of a sweep, bytes, at most: the active set, the chunks that are read at once, height maps, and the source itself.
    pub(super) fn memory_bytes(source: &dyn ChunkSource<E>, plan: &SlicePlan, threads: usize) -> u64 {
        let height = plan.raster.height_px as usize;
        let active = Active::<E::Kept>::memory_bytes(source.peak_active(), height, ROWS_PER_BAND);
        [E::cutter_bytes(source, plan), Feed::<E>::memory_bytes(source, threads), source.memory_bytes()]
            .into_iter()
            .fold(active, u64::saturating_add)
    }

    /// Moves the plane up to `z` quanta. It must not move down.
    pub(super) fn advance(&mut self, z: f64, workers: &Workers) -> Result<(), SliceError> {
        self.active.retire(z, E::high);
        let Self { cutter, rows, max_active, last, active, feed, source, .. } = self;
        feed.take(&**source, [z, z], workers, |element, chunk| {
            let damaged = |problem: String| SliceError::Damaged(format!("chunk {chunk} of the build file: {problem}"));
            let (kept, Extent { low, y }) = element.keep(cutter).map_err(damaged)?;
            let high = E::high(&kept);
            if low > z {
                return Ok(false);
            }
            if element.order() < *last {
                return Err(damaged(format!("{element:?} is out of order")));
            }
            *last = element.order();
            // A level one is never cut.
            if high >= z && high > low {
                if active.count() == *max_active {
                    return Err(SliceError::Damaged(format!(
                        "one layer cuts more triangles or patches than the {max_active} that the profile of the build file states"
                    )));
                }
                active.add(kept, rows.reached(y));
            }
            Ok(true)
        })
    }

    /// The elements that the plane cuts.
    pub(super) fn active(&self) -> &Active<E::Kept> {
        &self.active
    }

    /// What they are cut with.
    pub(super) fn cutter(&self) -> &E::Cutter {
        &self.cutter
    }
}
