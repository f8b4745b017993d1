//! Where importers hand over lattices that a mesh clips, and these meshes. Each pair becomes two bodies. Pairs share them if it changes nothing:
//! if neither mesh reaches the other lattice, or both are the same. `collect` has one; `tests/clipped/` tests it.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};

use super::collect::CollectedLattice;
use super::lane::{Lane, Tally};
use super::materials::Mixture;
use super::rules::Rules;
use super::struts::Struts;
use super::surface::{CollectedSurface, SurfaceLane};
use crate::buildfile::error::PackError;
use crate::buildfile::materials::Materials;
use crate::buildfile::model::{Header, Joint, Keeps, Strut, Triangle};
use crate::buildfile::options::{JointChoice, PackOptions};
use crate::buildfile::sort::{self, Sorter};

/// Most pairs of bodies: others may be an unclipped lattice of each material, a surface and a relief.
const MAX_PAIRS: usize = (Header::MAX_BODIES - Materials::MAX_COUNT - 2) / 2;

/// Most clipped lattices: the boxes of each are compared with those of all others.
const MAX_PLACES: usize = 4096;

/// A box in millimetres, before the options rotate and scale it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoxMm {
    pub(super) min: DVec3,
    pub(super) max: DVec3,
}

impl BoxMm {
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
    /// Whether pairs whose boxes do not touch share bodies. A convolution bulges out of its box by a support that is not known yet.
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
    /// Number of the current source.
    source: usize,
    /// Struts and triangles announced so far, at most.
    expected: [u64; 2],
}

/// A pair of bodies.
struct ClipLane<'a> {
    keeps: Keeps,
    /// Names the first lattice in errors.
    place: String,
    /// That of its first strut.
    material: Option<Option<Mixture>>,
    lattice: Lane<'a>,
    surface: SurfaceLane<'a>,
    taken: Vec<Taken>,
}

/// A lattice that a pair of bodies takes, and what clips it.
struct Taken {
    /// The boxes of both.
    boxes: [BoxMm; 2],
    /// Source and number of the mesh, and its place.
    mesh: (usize, u32, DAffine3),
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
            shares: rules.joint() == JointChoice::Union,
            unevenness: most / least,
            rounding_mm: 2.0 * options.quantum_um / 1000.0 / least,
            lane_bytes: memory_bytes / (2 * MAX_PAIRS as u64),
            directory: directory.into(),
            lanes: Vec::new(),
            place_count: 0,
            source: 0,
            expected: [0; 2],
        }
    }

    /// Begins a lattice of which the mesh of this number leaves a part, both at `place`, and returns the number of its lane. The boxes are
    /// those of nodes and mesh before they are placed, and `radius_mm` is the largest radius. `named` names it in errors.
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn begin(
        &mut self,
        keeps: Keeps,
        [nodes, mesh]: [BoxMm; 2],
        radius_mm: f64,
        (mesh_number, place): (u32, DAffine3),
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
        let boxes = [nodes.placed(&place, margin_mm), mesh.placed(&place, self.rounding_mm)];
        let mesh = (self.source, mesh_number, place);
        let is_free = |lane: &ClipLane<'_>| {
            let is_apart = |other: &Taken| !boxes[0].touches(&other.boxes[1]) && !boxes[1].touches(&other.boxes[0]);
            lane.keeps == keeps && lane.taken.iter().all(|other| other.mesh == mesh || self.shares && is_apart(other))
        };
        let number = self.lanes.iter().position(is_free).unwrap_or(self.lanes.len());
        if number == self.lanes.len() {
            let sorter = Sorter::new(&self.directory, self.lane_bytes);
            self.lanes.push(ClipLane {
                keeps,
                place: named.to_owned(),
                material: None,
                lattice: Lane::new(self.rules, sorter, Vec::new(), &self.directory),
                surface: SurfaceLane::new(self.rules, self.lane_bytes, &self.directory),
                taken: Vec::new(),
            });
        }
        self.lanes[number].taken.push(Taken { boxes, mesh });
        // There are fewer than `MAX_PLACES` lanes.
        Ok(number as u16)
    }

    /// Checks the number of lanes. Call it after all lattices of a source have begun.
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn end_source(&mut self) -> Result<(), PackError> {
        self.source += 1;
        let count = self.lanes.len();
        let Some(one_more) = self.lanes.get(MAX_PAIRS) else { return Ok(()) };
        let problem = if self.shares {
            format!(
                "clipped lattices that touch each other's clipping meshes are kept apart, and these are {count} such; a part has at \
                 most {MAX_PAIRS}. Place them farther apart, or pack some of them as another part"
            )
        } else {
            format!(
                "{count} lattices are clipped by meshes of their own; as convolutions, at most {MAX_PAIRS} can be. Pack them with --joint union, or some of \
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

    /// The lattice of a lane, for a strut that consists of this.
    ///
    /// # Errors
    /// If its struts are of several materials: they would have to be joined before they are clipped.
    pub(super) fn lattice(
        &mut self,
        lane: u16,
        mixture: Option<Mixture>,
        place: &dyn Fn() -> String,
    ) -> Result<&mut Lane<'a>, PackError> {
        let lane = &mut self.lanes[usize::from(lane)];
        let first = *lane.material.get_or_insert(mixture);
        if first != mixture || mixture.is_some_and(|mixture| mixture.pure().is_none()) {
            let problem = "lattices that meshes clip have one material each, but this beam is of another, or of several; pack the lattice                            without its clipping mesh (--lattice-only), or give all its beams one material (--materials)";
            return Err(PackError::input(place(), problem));
        }
        Ok(&mut lane.lattice)
    }

    /// The mesh of a lane.
    pub(super) fn surface(&mut self, lane: u16) -> &mut SurfaceLane<'a> {
        &mut self.lanes[usize::from(lane)].surface
    }

    /// Figures of all struts.
    pub(super) fn tally(&self) -> Tally {
        self.lanes.iter().fold(Tally::default(), |sum, lane| sum.joined(lane.lattice.tally()))
    }

    /// All pairs, of a lattice of this joint and largest radius. Adds notes for the operator.
    pub(super) fn finish(self, joint: Joint, largest_radius: u32, notes: &mut Vec<String>) -> Vec<CollectedClip> {
        let collected = |lane: ClipLane<'_>| {
            let ClipLane { keeps, place, lattice, surface, material, .. } = lane;
            let material = material.flatten().and_then(|mixture| mixture.pure());
            let count = lattice.tally().count;
            let struts = Struts { whole: vec![lattice.sorter], shared: Vec::new() };
            let lattice = CollectedLattice { struts, joint, largest_radius, count, material };
            // All beams may have been too short.
            let surface = surface.finish(notes).filter(|_| count > 0)?;
            Some(CollectedClip { keeps, place, lattice, surface })
        };
        self.lanes.into_iter().filter_map(collected).collect()
    }
}
