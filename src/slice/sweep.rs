//! The sweep plane and its active set (Liu et al. 2021, §4): struts come in ascending order, join when the plane comes within
//! reach and leave when it is past them. Order never changes, so a layer's sums are the same wherever a sweep began.

use super::{SliceError, StrutSource};
use crate::buildfile::{CHUNK_STRUTS, Cap, Strut};
use crate::solid::{self, Beam, Shape};
use crate::stream::{Charge, MemoryBudget};

/// Struts within reach of the plane, read from a source as the plane rises.
pub(super) struct Sweep<S> {
    source: Box<dyn StrutSource>,
    /// Unit of length of the shapes, micrometres.
    unit_um: f64,
    /// How far from its skeleton a strut can matter, micrometres.
    reach_um: f64,
    quantum_um: f64,
    /// What the source promised at most.
    most_active: usize,
    active: Vec<S>,
    /// The chunk being taken in, from `next_strut` on.
    chunk: Vec<Strut>,
    next_strut: usize,
    next_chunk: usize,
    last_z: i32,
    _charge: Charge,
}

impl<S: Shape> Sweep<S> {
    /// A sweep that can begin at any plane.
    pub(super) fn new(source: Box<dyn StrutSource>, unit_um: f64, budget: &MemoryBudget) -> Result<Self, SliceError> {
        let bytes = Self::memory_bytes(&*source);
        let charge = budget.charge("the struts within reach of one layer", bytes)?;
        let most_active = usize::try_from(source.peak_active()).unwrap_or(usize::MAX);
        let header = source.header();
        Ok(Self {
            unit_um,
            reach_um: header.reach_um(),
            quantum_um: header.quantum_um,
            most_active,
            // The charge was granted, so this much may be taken.
            active: Vec::with_capacity(most_active),
            chunk: Vec::new(),
            next_strut: 0,
            next_chunk: 0,
            last_z: i32::MIN,
            _charge: charge,
            source,
        })
    }

    /// Bytes a sweep takes at most: the active set, one chunk and the source's own.
    pub(super) fn memory_bytes(source: &dyn StrutSource) -> u64 {
        let chunk = (CHUNK_STRUTS * size_of::<Strut>()) as u64;
        let active = source.peak_active().saturating_mul(size_of::<S>() as u64);
        active.saturating_add(chunk).saturating_add(source.memory_bytes())
    }

    /// Moves the plane up to `z_um`; planes must ascend.
    pub(super) fn advance(&mut self, z_um: f64) -> Result<(), SliceError> {
        let z = z_um / self.unit_um;
        self.active.retain(|shape| shape.top() >= z);
        loop {
            while let Some(&strut) = self.chunk.get(self.next_strut) {
                if f64::from(strut.a[2]) * self.quantum_um - self.reach_um > z_um {
                    return Ok(());
                }
                let shape = self.shape(&strut)?;
                self.next_strut += 1;
                if shape.top() >= z {
                    self.join(shape)?;
                }
            }
            if !self.read_next_chunk(z_um)? {
                return Ok(());
            }
        }
    }

    /// The struts within reach, in file order.
    pub(super) fn active(&self) -> &[S] {
        &self.active
    }

    /// Unit of length of the shapes, micrometres.
    pub(super) fn unit_um(&self) -> f64 {
        self.unit_um
    }

    fn join(&mut self, shape: S) -> Result<(), SliceError> {
        if self.active.len() == self.most_active {
            return Err(SliceError::Source(anyhow::anyhow!(
                "more struts lie at one layer than the {} the build file's index promised; the file is damaged: pack the part again",
                self.most_active
            )));
        }
        self.active.push(shape);
        Ok(())
    }

    /// Reads the next chunk that can matter at `z_um` or above; `false` where none begins within reach.
    fn read_next_chunk(&mut self, z_um: f64) -> Result<bool, SliceError> {
        while self.next_chunk < self.source.chunk_count() {
            let span = self.source.chunk_span(self.next_chunk);
            if f64::from(span.lowest_z) * self.quantum_um - self.reach_um > z_um {
                return Ok(false);
            }
            let chunk = self.next_chunk;
            self.next_chunk += 1;
            if f64::from(span.highest_z) * self.quantum_um + self.reach_um >= z_um {
                self.source.read_chunk(chunk, &mut self.chunk).map_err(SliceError::Source)?;
                self.next_strut = 0;
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn shape(&mut self, strut: &Strut) -> Result<S, SliceError> {
        let radii = self.source.header().radius_range;
        let in_order = strut.a[2] >= self.last_z && strut.b[2] >= strut.a[2];
        let in_range = |radius: u32| radius >= radii[0].max(1) && radius <= radii[1];
        if !in_order || !in_range(strut.radius_a) || !in_range(strut.radius_b) {
            let what = if in_order { "a radius outside the header's range" } else { "a strut out of order" };
            return Err(SliceError::Source(anyhow::anyhow!(
                "chunk {} of the build file has {what}; the file is damaged: pack the part again",
                self.next_chunk.saturating_sub(1)
            )));
        }
        self.last_z = strut.a[2];
        Ok(S::prepare(&beam(strut, self.quantum_um), self.unit_um))
    }
}

/// A strut in micrometres.
pub(super) fn beam(strut: &Strut, quantum_um: f64) -> Beam {
    let point = |p: [i32; 3]| p.map(|x| f64::from(x) * quantum_um);
    let cap = |cap| match cap {
        Cap::Sphere => solid::Cap::Sphere,
        Cap::Hemisphere => solid::Cap::Hemisphere,
        Cap::Butt => solid::Cap::Butt,
    };
    Beam {
        a: point(strut.a),
        b: point(strut.b),
        radius_a: f64::from(strut.radius_a) * quantum_um,
        radius_b: f64::from(strut.radius_b) * quantum_um,
        caps: [cap(strut.caps.a), cap(strut.caps.b)],
    }
}
