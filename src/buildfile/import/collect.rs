//! Where importers hand over beams and balls: one [`Lane`] for each thread, and what is known at the end of all sources.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use sha2::{Digest, Sha256};

use super::clips::{Clips, CollectedClip};
use super::lane::{Beam, Lane, Tally};
use super::materials::{MaterialNames, Mixture};
use super::meshes::Meshes;
use super::relief::CollectedRelief;
use super::rules::Rules;
use super::stretch::{ROUND_TOLERANCE_UM, Stretch};
use super::struts::Struts;
use super::surface::CollectedSurface;
use crate::buildfile::error::PackError;
use crate::buildfile::materials::Materials;
use crate::buildfile::model::{Bounds, Joint, SUPPORT_FACTOR, Strut, Triangle};
use crate::buildfile::options::{BlendBegin, JointChoice, PackOptions};
use crate::buildfile::primitive::{EXPECTED_STRUT_BYTES, EXPECTED_TRIANGLE_BYTES};
use crate::buildfile::progress::PackProgress;
use crate::buildfile::sort::{self, Sorter};
use crate::text::count_text;

/// A support larger than this multiple of the mean radius gets a note. The field of a strut then falls so slowly (to 0.7 C at twice its
/// radius) that struts within R of one another swell.
const WIDE_SUPPORT: f64 = 5.0;

/// A radius of fewer quanta gets a note: rounding changes it by 5 % or more.
const COARSE_RADIUS: u32 = 10;

/// Takes the beams and balls of all sources.
pub(in crate::buildfile) struct Collector<'a> {
    rules: &'a Rules,
    lanes: Vec<Lane<'a>>,
    pub(super) meshes: Meshes<'a>,
    pub(super) clips: Clips<'a>,
    hasher: Sha256,
    /// Convolution radii that sources state: place and millimetres.
    stated_supports: Vec<(String, f64)>,
    notes: Vec<String>,
    directory: PathBuf,
    memory_bytes: u64,
    /// Struts and triangles in the sources announced so far, at most.
    expected: [u64; 2],
    /// The lane that took the last beam of a source that one thread reads.
    turn: usize,
}

/// The struts of one material, or of none.
pub(in crate::buildfile) struct CollectedLattice {
    pub(in crate::buildfile) struts: Struts,
    pub(in crate::buildfile) joint: Joint,
    pub(in crate::buildfile) largest_radius: u32,
    pub(in crate::buildfile) count: u64,
    /// The number of its material, as sources named them.
    pub(in crate::buildfile) material: Option<u8>,
}

/// Everything that a build file is written from. There is at least one body.
pub(in crate::buildfile) struct Collected {
    pub(in crate::buildfile) lattices: Vec<CollectedLattice>,
    pub(in crate::buildfile) clips: Vec<CollectedClip>,
    pub(in crate::buildfile) surface: Option<CollectedSurface>,
    pub(in crate::buildfile) relief: Option<CollectedRelief>,
    pub(in crate::buildfile) source_digest: [u8; 32],
    pub(in crate::buildfile) notes: Vec<String>,
}

impl<'a> Collector<'a> {
    /// A collector with one lane for each thread that `options` asks for. Runs are spilled to `directory`. There may be
    /// `kinds` kinds of primitives, which share the memory.
    pub(in crate::buildfile) fn new(rules: &'a Rules, options: &PackOptions, kinds: u64, directory: &Path) -> Self {
        let memory_bytes = options.memory_bytes / kinds;
        let threads = options.threads.get();
        let sorters = Sorter::team(directory, memory_bytes, threads);
        let shared = Lane::shared_sorters(directory, memory_bytes, threads);
        Self {
            rules,
            lanes: sorters
                .into_iter()
                .zip(shared)
                .map(|(sorter, shared)| Lane::new(rules, sorter, shared, directory))
                .collect(),
            meshes: Meshes::new(rules, options, memory_bytes, directory),
            clips: Clips::new(rules, options, memory_bytes, directory),
            hasher: Sha256::new(),
            stated_supports: Vec::new(),
            notes: Vec::new(),
            directory: directory.into(),
            memory_bytes,
            expected: [0; 2],
            turn: 0,
        }
    }

    /// Adds a sentence for the operator.
    pub(super) fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Adds a convolution radius that a source states, millimetres.
    pub(super) fn stated_support(&mut self, place: String, support_mm: f64) {
        self.stated_supports.push((place, support_mm));
    }

    /// Announces the largest number of struts in a source. Call it before the first of them. If they may not fit memory, `progress`
    /// gets the temporary space that is needed, without what earlier sources have taken.
    ///
    /// # Errors
    /// If that space is not free.
    pub(super) fn expect(&mut self, struts: u64, progress: &mut dyn FnMut(PackProgress)) -> Result<(), PackError> {
        self.expected[0] = self.expected[0].saturating_add(struts);
        self.check_space(progress)
    }

    /// As [`Collector::expect`], of triangles. Those with relief are held in memory.
    ///
    /// # Errors
    /// As [`Collector::expect`].
    pub(super) fn expect_triangles(
        &mut self,
        triangles: u64,
        progress: &mut dyn FnMut(PackProgress),
    ) -> Result<(), PackError> {
        if self.meshes.is_relief() {
            return Ok(());
        }
        self.expected[1] = self.expected[1].saturating_add(triangles);
        self.check_space(progress)
    }

    fn check_space(&self, progress: &mut dyn FnMut(PackProgress)) -> Result<(), PackError> {
        let [struts, triangles] = self.expected;
        let of_struts = sort::spill_bytes::<Strut>(struts, self.memory_bytes, self.lanes.len())
            .saturating_sub(self.lanes[0].sorter.spilled_bytes());
        let of_triangles =
            sort::spill_bytes::<Triangle>(triangles, self.memory_bytes, 1).saturating_sub(self.meshes.spilled_bytes());
        let temporary_bytes = of_struts.saturating_add(of_triangles).saturating_add(self.clips.temporary_bytes());
        if temporary_bytes == 0 {
            return Ok(());
        }
        let of_clips = self.clips.expected();
        let [struts, triangles] = [0, 1].map(|kind| self.expected[kind].saturating_add(of_clips[kind]));
        let output_bytes = struts
            .saturating_mul(EXPECTED_STRUT_BYTES)
            .saturating_add(triangles.saturating_mul(EXPECTED_TRIANGLE_BYTES));
        let directory = &self.directory;
        let sort_error = |source| PackError::Sort { directory: directory.clone(), source };
        let free_bytes = crate::disk::free_bytes(directory).map_err(sort_error)?;
        progress(PackProgress::Space { temporary_bytes, output_bytes, free_bytes });
        sort::check_free_space(directory, temporary_bytes).map_err(sort_error)
    }

    /// The lanes, at least one, for as many threads, and the digest of all sources' bytes in order.
    pub(super) fn parts(&mut self) -> (&mut [Lane<'a>], &mut Sha256) {
        (&mut self.lanes, &mut self.hasher)
    }

    /// What `map` followed by the options does to radii; `None` if it flattens them.
    pub(super) fn stretch_after(&self, map: DMat3) -> Option<Stretch> {
        self.rules.stretch_after(map)
    }

    /// As [`Lane::stretched_beam`], for a source that one thread reads. With `clip`, it belongs to the lattice of that lane of [`Collector::clips`].
    ///
    /// # Errors
    /// As [`Lane::beam`].
    pub(super) fn beam(
        &mut self,
        beam: &Beam,
        stretch: Stretch,
        clip: Option<u16>,
        place: &dyn Fn() -> String,
    ) -> Result<(), PackError> {
        // A clipped lattice has one material, which its body has.
        let whole = Beam { mixture: beam.mixture.filter(|_| clip.is_none()), ..*beam };
        self.lane_of(clip, beam.mixture, place)?.stretched_beam(&whole, stretch, place)
    }

    /// As [`Lane::ball`], for a source that one thread reads. With `clip` as in [`Collector::beam`].
    ///
    /// # Errors
    /// As [`Lane::ball`].
    pub(super) fn ball(
        &mut self,
        centre: DVec3,
        radius_mm: f64,
        mixture: Option<Mixture>,
        stretch: Stretch,
        clip: Option<u16>,
        place: &dyn Fn() -> String,
    ) -> Result<(), PackError> {
        let lane = self.lane_of(clip, mixture, place)?;
        lane.ball(centre, radius_mm, mixture.filter(|_| clip.is_none()), stretch, place)
    }

    /// The lane of a clipped lattice, or else the lanes in turn, because each has only its share of the memory.
    fn lane_of(
        &mut self,
        clip: Option<u16>,
        mixture: Option<Mixture>,
        place: &dyn Fn() -> String,
    ) -> Result<&mut Lane<'a>, PackError> {
        if let Some(lane) = clip {
            return self.clips.lattice(lane, mixture, place);
        }
        self.turn = (self.turn + 1) % self.lanes.len();
        Ok(&mut self.lanes[self.turn])
    }

    /// The materials of the sources.
    pub(super) fn materials(&self) -> &'a MaterialNames {
        self.rules.materials()
    }

    /// The files that were read beside the sources.
    pub(in crate::buildfile) fn read_files(&self) -> impl Iterator<Item = &Path> {
        self.meshes.read_files()
    }

    /// A box around all struts and triangles; `None` if there are none.
    pub(in crate::buildfile) fn bounds(&self) -> Option<Bounds> {
        let tally = self.lanes.iter().fold(self.clips.tally(), |sum, lane| sum.joined(lane.tally()));
        let bounds = tally.bounds.joined(&self.meshes.bounds());
        (bounds.min[0] <= bounds.max[0]).then_some(bounds)
    }

    /// Decides the joint and adds the notes that need all sources.
    ///
    /// # Errors
    /// If there is nothing to print, or a displaced triangle reaches too far.
    pub(in crate::buildfile) fn finish(mut self, inputs: &[PathBuf]) -> Result<Collected, PackError> {
        let unclipped = self.lanes.iter().fold(Tally::default(), |sum, lane| sum.joined(lane.tally()));
        let tally = unclipped.joined(&self.clips.tally());
        if tally.count == 0 && self.meshes.count() == 0 {
            return Err(self.nothing(inputs, tally.short_count));
        }
        let joint = match self.rules.joint() {
            _ if tally.count == 0 => None,
            JointChoice::Union => Some(Joint::Union),
            JointChoice::Convolution { support_mm } => {
                Some(Joint::Convolution { support_um: self.support_um(support_mm, &tally) })
            }
            JointChoice::Elliptic { support_mm, begins } => {
                let least = match begins {
                    BlendBegin::Least(least) => least,
                    // The writer finds them when all struts are there.
                    BlendBegin::Points(_) => [0.5; 2],
                };
                Some(Joint::Elliptic { support_um: self.support_um(support_mm, &tally), least })
            }
        };
        self.rules.materials().check_renamed()?;
        if let Some(joint) = joint {
            self.note_tally(&tally, joint);
        }
        let Self { lanes, meshes, clips, mut notes, hasher, .. } = self;
        let largest_radius = tally.largest_radius;
        let clips = joint.map(|joint| clips.finish(joint, largest_radius, &mut notes)).unwrap_or_default();
        let lattices = joint.map(|joint| lattices(lanes, &unclipped, joint, largest_radius)).unwrap_or_default();
        let (surface, relief) = meshes.finish(&mut notes)?;
        Ok(Collected { lattices, clips, surface, relief, source_digest: hasher.finalize().into(), notes })
    }

    /// The given or the default support of a convolution, with notes on it.
    fn support_um(&mut self, support_mm: Option<f64>, tally: &Tally) -> f64 {
        let quantum_um = self.rules.quantum_um();
        let default_um = SUPPORT_FACTOR * f64::from(tally.largest_radius) * quantum_um;
        let support_um = support_mm.map_or(default_um, |support_mm| support_mm * 1000.0);
        self.note_supports(support_um / 1000.0);
        let mean_radius_um = tally.radius_sum as f64 / (2 * tally.count) as f64 * quantum_um;
        if support_um > WIDE_SUPPORT * mean_radius_um {
            self.notes.push(format!(
                "R = {} mm is {:.0} times the mean radius: struts within R of one another swell into one body, and short ones \
                 print thin or not at all. Check it with `layerctl slice`; choose another R with --support, above the largest \
                 radius of {} mm, or use --joint union",
                support_um / 1000.0,
                support_um / mean_radius_um,
                f64::from(tally.largest_radius) * quantum_um / 1000.0
            ));
        }
        support_um
    }

    fn note_tally(&mut self, tally: &Tally, joint: Joint) {
        let quantum_um = self.rules.quantum_um();
        let quantum_mm = quantum_um / 1000.0;
        if let Some(smallest) = tally.smallest_radius.filter(|radius| *radius < COARSE_RADIUS) {
            self.notes.push(format!(
                "the thinnest radius is {smallest} quanta of {quantum_mm} mm: rounding has changed it by up to {} %; use a smaller \
                 --quantum",
                100 / (2 * smallest - 1)
            ));
        }
        if tally.short_count > 0 {
            self.notes.push(format!(
                "left out {} shorter than the file's resolution of {quantum_mm} mm",
                count_text(tally.short_count, "strut")
            ));
        }
        if tally.capped_count > 0 && joint != Joint::Union {
            self.notes.push(format!(
                "the caps of {} do not apply: a convolution surface rounds all ends; --joint union applies them",
                count_text(tally.capped_count, "beam")
            ));
        }
        // Smaller deviations disappear in rounding.
        if tally.largest_off_um > quantum_um / 2.0 {
            self.notes.push(format!(
                "directions are stretched differently, but struts stay round, with their mean radius: surfaces lie up to {:.1} µm \
                 off the stretched ones; the limit is {ROUND_TOLERANCE_UM} µm",
                tally.largest_off_um
            ));
        }
    }

    fn nothing(&self, inputs: &[PathBuf], short_count: u64) -> PackError {
        let short = match short_count {
            0 => String::new(),
            count => {
                let struts = count_text(count, "strut");
                format!(" ({struts} shorter than {} mm)", self.rules.quantum_um() / 1000.0)
            }
        };
        let left_out = match self.notes.as_slice() {
            [] => String::new(),
            notes => format!("; left out: {}", notes.join("; ")),
        };
        PackError::input(names(inputs), format!("there is nothing to print{short}{left_out}"))
    }

    fn note_supports(&mut self, support_mm: f64) {
        for (place, stated_mm) in &self.stated_supports {
            if (stated_mm * self.rules.stretch().mean() - support_mm).abs() > 1e-9 {
                self.notes.push(format!(
                    "{place} states a convolution radius of {stated_mm} mm, which existing files use in another sense; the support \
                     used is R = {support_mm} mm (choose another, above the largest radius, with --support)"
                ));
            }
        }
    }
}

/// The lattices that are not clipped: one without a material, if there are such struts, and one of each material.
fn lattices(lanes: Vec<Lane<'_>>, tally: &Tally, joint: Joint, largest_radius: u32) -> Vec<CollectedLattice> {
    let mut whole = Vec::new();
    let mut shared: Vec<_> = (0..Materials::MAX_COUNT).map(|_| Vec::new()).collect();
    for lane in lanes {
        whole.push(lane.sorter);
        lane.shared.into_iter().zip(&mut shared).for_each(|(sorter, team)| team.push(sorter));
    }
    let lattice = |struts, count, material| CollectedLattice { struts, joint, largest_radius, count, material };
    let without = lattice(Struts { whole, shared: Vec::new() }, tally.whole_count, None);
    let with = shared
        .into_iter()
        .zip(tally.counts)
        .zip(0..)
        .map(|((shared, count), material)| lattice(Struts { whole: Vec::new(), shared }, count, Some(material)));
    std::iter::once(without).chain(with).filter(|lattice| lattice.count > 0).collect()
}

fn names(inputs: &[PathBuf]) -> String {
    inputs.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::buildfile::model::Caps;

    #[test]
    fn one_reading_thread_fills_the_memory_of_all_lanes() {
        let threads = std::num::NonZero::<usize>::MIN.saturating_add(3);
        let options = PackOptions { memory_bytes: 2 << 20, threads, ..PackOptions::default() };
        let rules = Rules::new(&options, JointChoice::Union).expect("in range");
        let directory = tempfile::tempdir().expect("temporary directory");
        let mut collector = Collector::new(&rules, &options, 1, directory.path());
        // 2 MiB hold 65,536 of them.
        for number in 0..60_000 {
            let (a, b) = (DVec3::new(f64::from(number), 0.0, 0.0), DVec3::new(0.0, 0.0, 9.0));
            let beam = Beam { a, b, radius_a: 1.0, radius_b: 1.0, caps: Caps::default(), mixture: None };
            collector.beam(&beam, rules.stretch(), None, &|| "the test".into()).expect("is fine");
        }
        assert_eq!(collector.lanes[0].sorter.spilled_bytes(), 0);
    }
}
