//! Compares what a build file says of its primitives with all of them. Before a print, `pipeline` calls it; `tests/buildfile_damage.rs`
//! and `tests/relief/stored.rs` show what is found.

use super::error::BuildFileError;
use super::lowest::Lowest;
use super::maps;
use super::profile::ProfileBuilder;
use super::reader::BuildFile;
use super::relief::ReliefBuilder;
use crate::buildfile::model::{BodyHeader, Bounds, Clip, Lattice, Surface};
use crate::buildfile::primitive::{Primitive, Sortable};
use crate::buildfile::relief::{Patch, Relief};
use crate::solid::HeightMap;

impl BuildFile {
    /// Reads every chunk and compares header and profile with the primitives, so that damage in the middle of a file is found before the
    /// first layer. Reads the file once, and the patches of each relief once more for each of its maps, or once more if it has none. One map at
    /// a time is decoded.
    ///
    /// # Errors
    /// [`BuildFileError`] names the first damaged chunk, or the statement that the primitives contradict.
    pub fn verify(&self) -> Result<(), BuildFileError> {
        self.verify_bodies(true)
    }

    /// As [`BuildFile::verify`], but not how far patches reach: no height map is decoded, only their CRCs are checked.
    ///
    /// # Errors
    /// As [`BuildFile::verify`].
    pub(crate) fn verify_without_reach(&self) -> Result<(), BuildFileError> {
        self.verify_bodies(false)
    }

    /// Memory that [`BuildFile::verify`] takes for the largest height map, and to find the bounds of patches, bytes; 0 if there are none.
    pub(crate) fn verify_bytes(&self) -> u64 {
        let bodies = &self.header().bodies;
        let maps = bodies.iter().flat_map(BodyHeader::maps);
        let map =
            maps.map(|map| HeightMap::bytes(map.size_at(0)) + u64::from(map.bytes) + maps::decoding_bytes(map.size[0]));
        let has_patches = bodies.iter().any(|body| matches!(body, BodyHeader::Relief(_)));
        map.max().unwrap_or(0) + if has_patches { ReliefBuilder::BYTES } else { 0 }
    }

    fn verify_bodies(&self, finds_reach: bool) -> Result<(), BuildFileError> {
        let mut lowest = Lowest::default();
        for (body, header) in self.header().bodies.iter().enumerate() {
            match header {
                BodyHeader::Lattice(lattice) => self.verify_lattice(body, lattice, &mut lowest)?,
                BodyHeader::Surface(surface) | BodyHeader::Clip(Clip { surface, .. }) => {
                    self.verify_surface(body, surface, &mut lowest)?;
                }
                BodyHeader::Relief(relief) => self.verify_relief(body, relief, finds_reach, &mut lowest)?,
            }
        }
        let (stated_um, lowest_um) = (self.header().bottom_um, lowest.um(self.header().quantum_um));
        let is_exact = |body: &BodyHeader| body.is_exact() && (finds_reach || !matches!(body, BodyHeader::Relief(_)));
        if self.header().bodies.iter().all(is_exact) && stated_um != lowest_um {
            return Err(self.contradiction(
                "header",
                format!("it says that the lowest solid point lies at {stated_um} µm, but it lies at {lowest_um} µm"),
            ));
        }
        Ok(())
    }

    fn verify_lattice(&self, body: usize, lattice: &Lattice, lowest: &mut Lowest) -> Result<(), BuildFileError> {
        let Lattice { bounds, radius_range, .. } = lattice;
        let reach = lattice.reach_quanta(self.header().quantum_um);
        let (mut found, mut radii, mut profile) = (Bounds::EMPTY, [u32::MAX, 0], ProfileBuilder::default());
        let mut struts = Vec::new();
        for index in self.body_chunks(body) {
            struts.clear();
            self.read_chunk(index, &mut struts)?;
            for strut in &struts {
                let beyond = || self.contradiction("header", format!("{strut:?} reaches beyond ±2³¹ quanta"));
                found = found.with(strut).ok_or_else(beyond)?;
                let [least, most] = [strut.radius_a.min(strut.radius_b), strut.radius_a.max(strut.radius_b)];
                radii = [radii[0].min(least), radii[1].max(most)];
                profile.add(i64::from(strut.a[2]) - reach, i64::from(strut.b[2]) + reach);
                lowest.add(strut);
            }
        }
        if (&found, &radii) != (bounds, radius_range) {
            return Err(self.contradiction(
                "header",
                format!("it says {bounds:?} and radii {radius_range:?}, but the struts have {found:?} and {radii:?}"),
            ));
        }
        self.verify_peak(body, &profile)
    }

    fn verify_surface(&self, body: usize, surface: &Surface, lowest: &mut Lowest) -> Result<(), BuildFileError> {
        let (mut found, mut profile) = (Bounds::EMPTY, ProfileBuilder::default());
        let (mut triangles, mut last) = (Vec::new(), None);
        for index in self.body_chunks(body) {
            triangles.clear();
            self.read_triangles(index, &mut triangles)?;
            for triangle in &triangles {
                if last.is_some_and(|last| last > triangle.key()) {
                    return Err(self.wrong_chunk(index, format!("{triangle:?} comes after a higher one")));
                }
                last = Some(triangle.key());
                found = found.joined(&triangle.bounds());
                let [low, high] = triangle.z_range().map(i64::from);
                profile.add(low, high);
                lowest.add_triangle(triangle);
            }
        }
        if found != surface.bounds {
            let problem = format!("it says {:?}, but the triangles have {found:?}", surface.bounds);
            return Err(self.contradiction("header", problem));
        }
        self.verify_peak(body, &profile)
    }

    fn verify_relief(
        &self,
        body: usize,
        relief: &Relief,
        finds_reach: bool,
        lowest: &mut Lowest,
    ) -> Result<(), BuildFileError> {
        let wrong = |problem| self.contradiction("height map", problem);
        let quantum_um = self.header().quantum_um;
        let mut found = ReliefBuilder::comparing(relief, quantum_um).map_err(wrong)?;
        self.each_patch(body, |patch| found.add_unplaced(patch))?;
        if found.header().z_reach != relief.z_reach {
            let problem = format!("it says z {:?}, but the patches have {:?}", relief.z_reach, found.header().z_reach);
            return Err(self.contradiction("header", problem));
        }
        self.verify_peak(body, found.profile())?;
        if !finds_reach {
            return (0..relief.maps.len()).try_for_each(|number| self.read_map_bytes(body, number, |_| {}));
        }
        // Patches without a map go with those of the first.
        for number in 0..relief.maps.len().max(1) {
            if !relief.maps.is_empty() {
                found.forget_map(quantum_um).map_err(wrong)?;
                found.look_at(number, self.read_map(body, number, 0)?, quantum_um).map_err(wrong)?;
            }
            self.each_patch(body, |patch| match relief.map_of(patch).unwrap_or(0) == number {
                true => found.reach(patch),
                false => Ok(()),
            })?;
            found.finish().map_err(|problem| self.contradiction("patches", problem))?;
        }
        lowest.add_z(found.lowest());
        let bounds = found.header().bounds;
        if bounds != relief.bounds {
            let problem = format!("it says {:?}, but the patches have {bounds:?}", relief.bounds);
            return Err(self.contradiction("header", problem));
        }
        Ok(())
    }

    /// Calls `look` with each patch of a relief.
    fn each_patch(
        &self,
        body: usize,
        mut look: impl FnMut(&Patch) -> Result<(), String>,
    ) -> Result<(), BuildFileError> {
        let mut patches = Vec::new();
        for index in self.body_chunks(body) {
            patches.clear();
            self.read_patches(index, &mut patches)?;
            patches.iter().try_for_each(&mut look).map_err(|problem| self.wrong_chunk(index, problem))?;
        }
        Ok(())
    }

    fn verify_peak(&self, body: usize, profile: &ProfileBuilder) -> Result<(), BuildFileError> {
        let (stated, peak) = (self.body_peak_active(body), profile.peak_active());
        if peak > stated {
            let problem = format!("it states at most {stated} active primitives, but there are {peak}");
            return Err(self.contradiction("profile", problem));
        }
        Ok(())
    }
}
