//! The sweep plane (Liu et al. 2021, §4 and Eq. 8). Struts are read in ascending order. A strut joins the active set when the plane comes
//! within its reach, and leaves it when the plane has passed. `tests/slice.rs` tests it.

use super::active::ActiveSet;
use crate::buildfile::Strut;
use crate::slice::body::buckets::Rows;
use crate::slice::body::feed::Feed;
use crate::slice::body::source::ChunkSource;
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{MAX_RADIUS, Shape, StrutRecord};
use crate::stream::{Charge, MemoryBudget};

/// Reads struts from a source while the plane rises, and keeps those within its reach.
pub(super) struct Sweep {
    source: Box<dyn ChunkSource<Strut>>,
    /// Makes struts what the shape draws.
    record: fn(&Strut, quantum: f64) -> StrutRecord,
    rows: Rows,
    /// Greatest distance from its axis at which a strut has any effect, quanta.
    reach: f64,
    quantum_um: f64,
    /// Length of a quantum in the unit of the solid.
    quantum: f64,
    checks: Checks,
    active: ActiveSet,
    feed: Feed<Strut>,
    _charge: Charge,
}

impl Sweep {
    /// A sweep that can begin at any plane. `unit_um` is the unit of length of the solid, `min_rows` the height of the smallest
    /// buckets of the active set.
    pub(super) fn new<S: Shape>(
        source: Box<dyn ChunkSource<Strut>>,
        plan: &SlicePlan,
        unit_um: f64,
        min_rows: usize,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let bytes = Self::memory_bytes(&*source, plan, min_rows, threads);
        let charge = budget.charge("the struts within reach of one layer", bytes)?;
        let quantum_um = source.quantum_um();
        let reach_um = source.header().reach_um(quantum_um);
        Ok(Self {
            record: Strut::record::<S>,
            rows: Rows::of(plan, quantum_um, reach_um),
            reach: reach_um / quantum_um,
            quantum_um,
            quantum: quantum_um / unit_um,
            checks: Checks {
                radius_range: source.header().radius_range,
                max_active: usize::try_from(source.peak_active()).unwrap_or(usize::MAX),
                last_z: i32::MIN,
            },
            active: ActiveSet::new(plan.raster.height_px as usize, min_rows),
            feed: Feed::new(&*source, threads),
            _charge: charge,
            source,
        })
    }

    /// Memory of a sweep, bytes, at most: the active set, the chunks that are read at once, and the source itself.
    pub(super) fn memory_bytes(
        source: &dyn ChunkSource<Strut>,
        plan: &SlicePlan,
        min_rows: usize,
        threads: usize,
    ) -> u64 {
        let chunks = Feed::<Strut>::memory_bytes(source, threads);
        let (peak, is_graded) = (source.peak_active(), source.header().is_graded);
        let active = ActiveSet::memory_bytes(peak, is_graded, plan.raster.height_px as usize, min_rows);
        active.saturating_add(chunks).saturating_add(source.memory_bytes())
    }

    /// Moves the plane up to `z_um`. It must not move down.
    pub(super) fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        let z = z_um / self.quantum_um;
        // The cast saturates. A strut that ends below only because of rounding has no effect on the plane.
        let lowest_top = (z - self.reach).floor() as i32;
        workers.each(self.active.buckets_mut(), |bucket| bucket.retire(lowest_top));
        self.active.count();
        let (checks, active, rows) = (&mut self.checks, &mut self.active, self.rows);
        let (record, quantum, reach) = (self.record, self.quantum, self.reach);
        self.feed.take(&*self.source, [z - reach, z + reach], workers, |strut, chunk| {
            if f64::from(strut.a[2]) - reach > z {
                return Ok(false);
            }
            checks.check(strut, chunk)?;
            if strut.b[2] >= lowest_top {
                checks.count(active.alive())?;
                active.add(record(strut, quantum), rows.reached([strut.a[1], strut.b[1]].map(f64::from)));
            }
            Ok(true)
        })
    }

    /// The struts within reach.
    pub(super) fn active(&self) -> &ActiveSet {
        &self.active
    }

    /// Length of a quantum in the unit of the solid.
    pub(super) fn quantum(&self) -> f64 {
        self.quantum
    }
}

/// What the header and the profile of the build file promise of the struts.
struct Checks {
    radius_range: [u32; 2],
    /// Most struts within reach.
    max_active: usize,
    last_z: i32,
}

impl Checks {
    fn count(&self, alive: usize) -> Result<(), SliceError> {
        if alive < self.max_active {
            return Ok(());
        }
        Err(SliceError::Damaged(format!(
            "more struts are within reach of one layer than the {} that the profile of the build file states",
            self.max_active
        )))
    }

    fn check(&mut self, strut: &Strut, chunk: usize) -> Result<(), SliceError> {
        let radii = self.radius_range;
        let in_order = strut.a[2] >= self.last_z && strut.b[2] >= strut.a[2];
        let in_range = |radius: u32| (radii[0].max(1)..=radii[1].min(MAX_RADIUS)).contains(&radius);
        if !in_order || !in_range(strut.radius_a) || !in_range(strut.radius_b) {
            let what = if in_order { "a radius outside the header's range" } else { "a strut out of order" };
            return Err(SliceError::Damaged(format!("chunk {chunk} of the build file has {what}")));
        }
        self.last_z = strut.a[2];
        Ok(())
    }
}
