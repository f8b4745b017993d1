//! What one thread collects: beams and balls become struts, go to the sort, and are counted. `collect` has one lane a thread.

use std::io;
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::materials::{MaterialNames, Mixture};
use super::rules::Rules;
use super::stretch::Stretch;
use crate::buildfile::error::PackError;
use crate::buildfile::materials::{Materials, Shares};
use crate::buildfile::model::{Bounds, Caps, Strut, node_key};
use crate::buildfile::primitive::SharedStrut;
use crate::buildfile::sort::Sorter;

/// One beam as its source states it, millimetres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    pub(super) a: DVec3,
    pub(super) b: DVec3,
    pub(super) radius_a: f64,
    pub(super) radius_b: f64,
    pub(super) caps: Caps,
    /// What it consists of; `None` if the source does not say.
    pub(super) mixture: Option<Mixture>,
}

/// The struts of one thread.
pub(super) struct Lane<'a> {
    rules: &'a Rules,
    /// Struts without a material.
    pub(super) sorter: Sorter<Strut>,
    /// Struts of each material.
    pub(super) shared: Vec<Sorter<SharedStrut>>,
    directory: PathBuf,
    tally: Tally,
}

/// Figures of the struts collected so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tally {
    pub(super) largest_radius: u32,
    pub(super) smallest_radius: Option<u32>,
    /// Sum over both ends, for the mean.
    pub(super) radius_sum: u64,
    pub(super) count: u64,
    /// Struts and balls without a material.
    pub(super) whole_count: u64,
    /// Struts and balls of each material: one that is of several counts for each.
    pub(super) counts: [u64; Materials::MAX_COUNT],
    /// Beams whose ends fall on the same quantum.
    pub(super) short_count: u64,
    /// Beams with caps other than spheres.
    pub(super) capped_count: u64,
    /// Largest distance of a surface from where an exact stretch would put it.
    pub(super) largest_off_um: f64,
    /// A box around all of them.
    pub(super) bounds: Bounds,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            largest_radius: 0,
            smallest_radius: None,
            radius_sum: 0,
            count: 0,
            whole_count: 0,
            counts: [0; Materials::MAX_COUNT],
            short_count: 0,
            capped_count: 0,
            largest_off_um: 0.0,
            bounds: Bounds::EMPTY,
        }
    }
}

impl Tally {
    /// Figures of both.
    pub(super) fn joined(self, other: &Self) -> Self {
        Self {
            largest_radius: self.largest_radius.max(other.largest_radius),
            smallest_radius: self.smallest_radius.into_iter().chain(other.smallest_radius).min(),
            radius_sum: self.radius_sum + other.radius_sum,
            count: self.count + other.count,
            whole_count: self.whole_count + other.whole_count,
            counts: std::array::from_fn(|material| self.counts[material] + other.counts[material]),
            short_count: self.short_count + other.short_count,
            capped_count: self.capped_count + other.capped_count,
            largest_off_um: self.largest_off_um.max(other.largest_off_um),
            bounds: self.bounds.joined(&other.bounds),
        }
    }

    fn add_stretch(&mut self, stretch: Stretch, stated_mm: f64) {
        self.largest_off_um = self.largest_off_um.max(stretch.off(stated_mm) * 1000.0);
    }

    fn add_radii(&mut self, radii: [u32; 2]) {
        self.largest_radius = self.largest_radius.max(radii[0]).max(radii[1]);
        self.smallest_radius = self.smallest_radius.into_iter().chain(radii).min();
        self.radius_sum += u64::from(radii[0]) + u64::from(radii[1]);
        self.count += 1;
    }
}

impl<'a> Lane<'a> {
    /// A lane that sorts with `sorter`, which spills to `directory`, and with one of `shared` for each material.
    pub(super) fn new(
        rules: &'a Rules,
        sorter: Sorter<Strut>,
        shared: Vec<Sorter<SharedStrut>>,
        directory: &Path,
    ) -> Self {
        Self { rules, sorter, shared, directory: directory.into(), tally: Tally::default() }
    }

    /// The sorters of all materials for each of `threads` lanes. They take half of `memory_bytes` together, once there are materials.
    pub(super) fn shared_sorters(directory: &Path, memory_bytes: u64, threads: usize) -> Vec<Vec<Sorter<SharedStrut>>> {
        let each_bytes = memory_bytes / (2 * Materials::MAX_COUNT as u64);
        let mut lanes: Vec<_> = (0..threads).map(|_| Vec::new()).collect();
        for _ in 0..Materials::MAX_COUNT {
            let team = Sorter::team(directory, each_bytes, threads);
            lanes.iter_mut().zip(team).for_each(|(lane, sorter)| lane.push(sorter));
        }
        lanes
    }

    /// The materials of the sources.
    pub(super) fn materials(&self) -> &'a MaterialNames {
        self.rules.materials()
    }

    /// Figures of what was added.
    pub(super) fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Adds one beam; `place` names it in errors.
    ///
    /// # Errors
    /// If a point or a radius breaks the [`Rules`], or the temporary file cannot be written.
    pub(super) fn beam(&mut self, beam: &Beam, place: &dyn Fn() -> String) -> Result<(), PackError> {
        self.stretched_beam(beam, self.rules.stretch(), place)
    }

    /// Adds one beam whose points are already transformed and whose radii are still to be stretched.
    ///
    /// # Errors
    /// As [`Lane::beam`].
    pub(super) fn stretched_beam(
        &mut self,
        beam: &Beam,
        stretch: Stretch,
        place: &dyn Fn() -> String,
    ) -> Result<(), PackError> {
        let Beam { a, b, radius_a: stated_a, radius_b: stated_b, caps, mixture } = *beam;
        let rules = self.rules;
        let (a, b) = (rules.node(a, place)?, rules.node(b, place)?);
        let (radius_a, radius_b) = (rules.radius(stated_a, stretch, place)?, rules.radius(stated_b, stretch, place)?);
        if a == b {
            self.tally.short_count += 1;
            return Ok(());
        }
        self.tally.capped_count += u64::from(caps != Caps::default());
        self.tally.add_stretch(stretch, stated_a.max(stated_b));
        let strut = Strut { a, b, radius_a, radius_b, caps, shares: Shares::default() };
        if node_key(a) <= node_key(b) {
            self.push(strut, mixture)
        } else {
            self.push(reversed(strut), mixture.map(|mixture| mixture.reversed()))
        }
    }

    /// Adds one ball whose centre is already transformed and whose radius is still to be stretched; `place` names it in errors.
    ///
    /// # Errors
    /// As [`Lane::beam`].
    pub(super) fn ball(
        &mut self,
        centre: DVec3,
        stated_mm: f64,
        mixture: Option<Mixture>,
        stretch: Stretch,
        place: &dyn Fn() -> String,
    ) -> Result<(), PackError> {
        let node = self.rules.node(centre, place)?;
        let radius = self.rules.radius(stated_mm, stretch, place)?;
        self.tally.add_stretch(stretch, stated_mm);
        self.push(
            Strut {
                a: node,
                b: node,
                radius_a: radius,
                radius_b: radius,
                caps: Caps::default(),
                shares: Shares::default(),
            },
            mixture,
        )
    }

    fn push(&mut self, strut: Strut, mixture: Option<Mixture>) -> Result<(), PackError> {
        self.tally.add_radii([strut.radius_a, strut.radius_b]);
        // A node and a radius have 2³⁰ quanta at most.
        self.tally.bounds = self.tally.bounds.with(&strut).unwrap_or(self.tally.bounds);
        let sorted = match mixture {
            None => {
                self.tally.whole_count += 1;
                self.sorter.push(strut)
            }
            Some(mixture) => self.push_shares(strut, &mixture),
        };
        sorted.map_err(|source| PackError::Sort { directory: self.directory.clone(), source })
    }
}

impl Lane<'_> {
    /// Adds a strut to each of its materials.
    fn push_shares(&mut self, strut: Strut, mixture: &Mixture) -> io::Result<()> {
        if self.tally.counts.iter().all(|count| *count == 0) {
            // The other half is for struts with a material.
            self.sorter.halve()?;
        }
        for (material, shares) in mixture.shares() {
            self.tally.counts[usize::from(material)] += 1;
            self.shared[usize::from(material)].push(SharedStrut(Strut { shares, ..strut }))?;
        }
        Ok(())
    }
}

fn reversed(strut: Strut) -> Strut {
    let Strut { a, b, radius_a, radius_b, caps, shares } = strut;
    let (caps, shares) = (Caps { a: caps.b, b: caps.a }, Shares { a: shares.b, b: shares.a });
    Strut { a: b, b: a, radius_a: radius_b, radius_b: radius_a, caps, shares }
}
