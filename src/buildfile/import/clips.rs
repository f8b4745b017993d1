//! Where importers hand over lattices that a mesh clips, and these meshes. Each pair becomes two bodies. Pairs whose boxes do not touch
//! share them: neither mesh then reaches the other lattice. `collect` has one; `tests/clipped/` tests it.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};

use super::collect::CollectedLattice;
use super::lane::{Lane, Tally};
use super::rules::Rules;
use super::surface::{CollectedSurface, SurfaceLane};
use crate::buildfile::error::PackError;
use crate::buildfile::model::{Blend, Header, Keeps, Strut, Triangle};
use crate::buildfile::options::{BlendChoice, PackOptions};
use crate::buildfile::sort::{self, Sorter};

/// Most pairs of bodies: others may be an unclipped lattice, a surface and a relief.
const MAX_PAIRS: usize = (Header::MAX_BODIES - 3) / 2;

/// Most clipped lattices: the boxes of each are compared with those of all others.
const MAX_PLACES: usize = 4096;

/// A box in millimetres, before the options rotate and scale it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Space {
    pub(super) min: DVec3,
    pub(super) max: DVec3,
}

impl Space {
    /// The box of nothing.
    pub(super) const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// Extends it to a point.
    pub(super) fn extend(&mut self, point: DVec3) {
        (self.min, self.max) = (self.min.min(point), self.max.max(point));
    }

    /// A box around it at another place, and `margin` around that.
    fn placed(self, place: &DAffine3, margin: f64) -> Self {
        let mut placed = Self::EMPTY;
        for corner in 0..8 {
            let bits = [0, 1, 2].map(|axis| corner >> axis & 1 == 1);
            placed.extend(place.transform_point3(DVec3::select(bits.into(), self.max, self.min)));
        }
        Self { min: placed.min - margin, max: placed.max + margin }
    }

    fn touches(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }
}

/// Takes the clipped lattices of all sources.
pub(super) struct Clips<'a> {
    rules: &'a Rules,
    /// Whether pairs may share bodies. Struts of a convolution add up, so they are kept apart.
    shares: bool,
    /// Largest factor of the options divided by the smallest.
    unevenness: f64,
    /// Boxes are this much larger, for what rounding moves, millimetres.
    rounding_mm: f64,
    /// Memory of each lane.
    lane_bytes: u64,
    directory: PathBuf,
    lanes: Vec<ClipLane<'a>>,
    place_count: usize,
    /// Struts and triangles announced so far, at most.
    expected: [u64; 2],
}

/// A pair of bodies.
struct ClipLane<'a> {
    keeps: Keeps,
    /// Names the first lattice in errors.
    place: String,
    lattice: Lane<'a>,
    surface: SurfaceLane<'a>,
    /// The boxes of each lattice and of what clips it.
    boxes: Vec<[Space; 2]>,
}

/// A clipped lattice of all its struts, and what clips it.
pub(in crate::buildfile) struct CollectedClip {
    pub(in crate::buildfile) keeps: Keeps,
    pub(in crate::buildfile) place: String,
    pub(in crate::buildfile) lattice: CollectedLattice,
    pub(in crate::buildfile) surface: CollectedSurface,
}

impl<'a> Clips<'a> {
    /// All lanes together take up to `memory_bytes`. They are sorted in `directory` if they do not fit.
    pub(super) fn new(rules: &'a Rules, options: &PackOptions, memory_bytes: u64, directory: &Path) -> Self {
        let least = options.scale.into_iter().fold(f64::INFINITY, f64::min);
        let most = options.scale.into_iter().fold(0.0, f64::max);
        Self {
            rules,
            shares: rules.blend() == BlendChoice::Union,
            unevenness: most / least,
            rounding_mm: 2.0 * options.quantum_um / 1000.0 / least,
            lane_bytes: memory_bytes / (2 * MAX_PAIRS as u64),
            directory: directory.into(),
            lanes: Vec::new(),
            place_count: 0,
            expected: [0; 2],
        }
    }

    /// Begins a lattice of which a mesh leaves a part, both at `place`, and returns the number of its lane. `boxes` are those of the nodes
    /// and of the mesh, in the coordinates of the object, millimetres, and `radius_mm` is the largest radius. `named` names it in errors.
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn begin(
        &mut self,
        keeps: Keeps,
        [nodes, mesh]: [Space; 2],
        radius_mm: f64,
        place: &DAffine3,
        named: &str,
    ) -> Result<u16, PackError> {
        self.place_count += 1;
        if self.place_count > MAX_PLACES {
            let problem = format!("there are more than {MAX_PLACES} clipped lattices; pack fewer at once");
            return Err(PackError::input(named, problem));
        }
        // No direction is stretched more than by the root of the sum of squares of the matrix.
        let matrix = place.matrix3;
        let squares = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::length_squared);
        let margin_mm = radius_mm * squares.into_iter().sum::<f64>().sqrt() * self.unevenness + self.rounding_mm;
        let boxes = [nodes.placed(place, margin_mm), mesh.placed(place, self.rounding_mm)];
        let is_free = |lane: &ClipLane<'_>| {
            let touches = |[nodes, mesh]: &[Space; 2]| boxes[0].touches(mesh) || boxes[1].touches(nodes);
            lane.keeps == keeps && !lane.boxes.iter().any(touches)
        };
        let number = self.lanes.iter().position(|lane| self.shares && is_free(lane)).unwrap_or(self.lanes.len());
        if number == self.lanes.len() {
            let sorter = Sorter::new(&self.directory, self.lane_bytes);
            self.lanes.push(ClipLane {
                keeps,
                place: named.to_owned(),
                lattice: Lane::new(self.rules, sorter, &self.directory),
                surface: SurfaceLane::new(self.rules, self.lane_bytes, &self.directory),
                boxes: Vec::new(),
            });
        }
        self.lanes[number].boxes.push(boxes);
        // There are fewer than `MAX_PLACES` lanes.
        Ok(number as u16)
    }

    /// Checks the number of lanes, after all lattices of a source have begun.
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn check(&self) -> Result<(), PackError> {
        let count = self.lanes.len();
        let Some(one_more) = self.lanes.get(MAX_PAIRS) else { return Ok(()) };
        let problem = if self.shares {
            format!(
                "clipped lattices that touch each other's clipping meshes are kept apart, and these are {count} such; a part has at \
                 most {MAX_PAIRS}. Place them farther apart, or pack some of them as another part"
            )
        } else {
            format!(
                "{count} lattices are clipped; as convolutions, at most {MAX_PAIRS} can be. Pack them with --blend union, or some of \
                 them as another part"
            )
        };
        Err(PackError::input(&one_more.place, problem))
    }

    /// Announces struts and triangles.
    pub(super) fn expect(&mut self, [struts, triangles]: [u64; 2]) {
        self.expected = [self.expected[0].saturating_add(struts), self.expected[1].saturating_add(triangles)];
    }

    /// Temporary space that is still needed at most, bytes.
    pub(super) fn temporary_bytes(&self) -> u64 {
        let [struts, triangles] = self.expected;
        let taken = |lane: &ClipLane<'_>| lane.lattice.sorter.spilled_bytes() + lane.surface.spilled_bytes();
        sort::spill_bytes::<Strut>(struts, self.lane_bytes, 1)
            .saturating_add(sort::spill_bytes::<Triangle>(triangles, self.lane_bytes, 1))
            .saturating_sub(self.lanes.iter().map(taken).sum())
    }

    /// Struts and triangles announced so far.
    pub(super) fn expected(&self) -> [u64; 2] {
        self.expected
    }

    /// The lattice of a lane.
    pub(super) fn lattice(&mut self, lane: u16) -> &mut Lane<'a> {
        &mut self.lanes[usize::from(lane)].lattice
    }

    /// The mesh of a lane.
    pub(super) fn surface(&mut self, lane: u16) -> &mut SurfaceLane<'a> {
        &mut self.lanes[usize::from(lane)].surface
    }

    /// Figures of all struts.
    pub(super) fn tally(&self) -> Tally {
        self.lanes.iter().fold(Tally::default(), |sum, lane| sum.joined(lane.lattice.tally()))
    }

    /// All pairs, of a lattice of this blend and largest radius. Adds notes for the operator.
    pub(super) fn finish(self, blend: Blend, largest_radius: u32, notes: &mut Vec<String>) -> Vec<CollectedClip> {
        let collected = |lane: ClipLane<'_>| {
            let ClipLane { keeps, place, lattice, surface, .. } = lane;
            let count = lattice.tally().count;
            let lattice = CollectedLattice { sorters: vec![lattice.sorter], blend, largest_radius, count };
            // All beams may have been too short.
            let surface = surface.finish(notes).filter(|_| count > 0)?;
            Some(CollectedClip { keeps, place, lattice, surface })
        };
        self.lanes.into_iter().filter_map(collected).collect()
    }
}
