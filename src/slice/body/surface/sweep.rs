//! The sweep plane of a surface. Triangles are read in ascending order. A triangle joins the active set when the plane reaches its lowest
//! corner, and leaves it when the plane has passed its highest. `tests/surface/` tests it.

use super::ROWS_PER_BAND;
use super::active::{ActiveFacets, high};
use crate::buildfile::{QUANTUM_FRACTIONS, Triangle};
use crate::slice::body::buckets::Rows;
use crate::slice::body::feed::Feed;
use crate::slice::body::source::ChunkSource;
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::Facet;
use crate::stream::{Charge, MemoryBudget};

/// Reads triangles from a source while the plane rises, and keeps those that it cuts.
pub(super) struct Sweep {
    source: Box<dyn ChunkSource<Triangle>>,
    rows: Rows,
    max_active: usize,
    last_z: i64,
    active: ActiveFacets,
    feed: Feed<Triangle>,
    _charge: Charge,
}

impl Sweep {
    /// A sweep that can begin at any plane.
    pub(super) fn new(
        source: Box<dyn ChunkSource<Triangle>>,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let bytes = Self::memory_bytes(&*source, plan, threads);
        let charge = budget.charge("the triangles that one layer cuts", bytes)?;
        let max_active = usize::try_from(source.peak_active()).unwrap_or(usize::MAX);
        Ok(Self {
            rows: Rows::of(plan, source.quantum_um(), 0.0),
            max_active,
            last_z: i64::MIN,
            active: ActiveFacets::new(max_active, plan.raster.height_px as usize, ROWS_PER_BAND),
            feed: Feed::new(&*source, threads),
            _charge: charge,
            source,
        })
    }

    /// Memory of a sweep, bytes, at most: the active set, the chunks that are read at once, and the source itself.
    pub(super) fn memory_bytes(source: &dyn ChunkSource<Triangle>, plan: &SlicePlan, threads: usize) -> u64 {
        let active = ActiveFacets::memory_bytes(source.peak_active(), plan.raster.height_px as usize, ROWS_PER_BAND);
        active.saturating_add(Feed::<Triangle>::memory_bytes(source, threads)).saturating_add(source.memory_bytes())
    }

    /// Moves the plane up to `z` quanta. It must not move down.
    pub(super) fn advance(&mut self, z: f64, workers: &Workers) -> Result<(), SliceError> {
        self.active.retire(z);
        let Self { rows, max_active, last_z, active, feed, source, .. } = self;
        feed.take(&**source, [z, z], workers, |triangle, chunk| {
            let facet = facet(triangle);
            if facet[0][2] > z {
                return Ok(false);
            }
            if triangle.corners[0][2] < *last_z {
                return Err(SliceError::Damaged(format!("chunk {chunk} of the build file has a triangle out of order")));
            }
            *last_z = triangle.corners[0][2];
            let high = high(&facet);
            // A level one is never cut.
            if high >= z && high > facet[0][2] {
                if active.count() == *max_active {
                    return Err(SliceError::Damaged(format!(
                        "more triangles are cut by one layer than the {max_active} that the profile of the build file states"
                    )));
                }
                active.add(facet, rows.reached([facet[0][1], facet[1][1], facet[2][1]]));
            }
            Ok(true)
        })
    }

    /// The triangles that the plane cuts.
    pub(super) fn active(&self) -> &ActiveFacets {
        &self.active
    }
}

/// The corners of a triangle in quanta, exact.
fn facet(triangle: &Triangle) -> Facet {
    let [a, b, c] = &triangle.corners;
    let corner = |[x, y, z]: &[i64; 3]| [quanta(*x), quanta(*y), quanta(*z)];
    [corner(a), corner(b), corner(c)]
}

fn quanta(at: i64) -> f64 {
    at as f64 / QUANTUM_FRACTIONS as f64
}
