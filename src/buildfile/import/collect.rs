//! What importers hand over: beams and balls in millimetres, turned, scaled, quantised, checked and given to the sort.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use sha2::{Digest, Sha256};

use super::stretch::{ROUND_TOLERANCE_UM, Stretch};
use crate::buildfile::error::PackError;
use crate::buildfile::model::{Blend, Caps, QUANTA_UM, SUPPORT_FACTOR, Strut, node_key};
use crate::buildfile::options::{BlendChoice, PackOptions};
use crate::buildfile::progress::PackProgress;
use crate::buildfile::sort::{self, Sorter};
use crate::buildfile::store::EXPECTED_STRUT_BYTES;
use crate::solid::{LARGEST_RADIUS, LARGEST_RADIUS_SHARE};
use crate::text::count_text;

/// R as a multiple of the mean radius beyond which it is told: a strut's field then falls so slowly (to 0.7 C at twice its
/// radius) that all within R of it swells it.
const WIDE_SUPPORT: f64 = 5.0;

/// Radii of fewer quanta are told: rounding changes them by 5 % and more.
const COARSE_RADIUS: u32 = 10;

/// Farthest coordinate of a node, quanta: radii add to a node's place, and half the range leaves room for them.
const COORDINATE_LIMIT: f64 = (i32::MAX / 2) as f64;

/// One beam in millimetres as its source states it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    pub(super) a: DVec3,
    pub(super) b: DVec3,
    pub(super) radius_a: f64,
    pub(super) radius_b: f64,
    pub(super) caps: Caps,
}

/// What every beam goes through: the same for all threads.
pub(in crate::buildfile) struct Rules {
    quantum_um: f64,
    blend: BlendChoice,
    /// Turns and scales.
    map: DMat3,
    stretch: Stretch,
    /// From millimetres as a source states them to quanta.
    to_quanta: DMat3,
}

/// What one thread collects.
pub(super) struct Lane<'a> {
    rules: &'a Rules,
    sorter: Sorter,
    directory: PathBuf,
    tally: Tally,
}

#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    largest_radius: u32,
    least_radius: Option<u32>,
    /// Of both ends, to tell the mean.
    radius_sum: u64,
    count: u64,
    /// Beams whose ends fall on one quantum.
    short_count: u64,
    /// Beams with caps other than spheres.
    capped_count: u64,
    /// Most that a surface lies off where its map puts it.
    most_off_um: f64,
}

/// Takes beams and balls of all inputs.
pub(in crate::buildfile) struct Collector<'a> {
    rules: &'a Rules,
    lanes: Vec<Lane<'a>>,
    hasher: Sha256,
    /// Place and millimetres of convolution radii that sources state.
    stated_supports: Vec<(String, f64)>,
    notes: Vec<String>,
    directory: PathBuf,
    memory_bytes: u64,
    /// Struts that the sources so far can hold at most.
    expected: u64,
    /// Whose turn it is, of the lanes, where one thread reads.
    turn: usize,
}

/// Everything a build file is written from.
pub(in crate::buildfile) struct Collected {
    pub(in crate::buildfile) sorters: Vec<Sorter>,
    pub(in crate::buildfile) blend: Blend,
    pub(in crate::buildfile) largest_radius: u32,
    pub(in crate::buildfile) count: u64,
    pub(in crate::buildfile) source_digest: [u8; 32],
    pub(in crate::buildfile) notes: Vec<String>,
}

impl Tally {
    /// Notes how far a radius is off where its map puts it.
    fn stretched(&mut self, stretch: Stretch, stated_mm: f64) {
        self.most_off_um = self.most_off_um.max(stretch.off(stated_mm) * 1000.0);
    }
}

impl Rules {
    /// # Errors
    /// Where the factors flatten the part.
    pub(in crate::buildfile) fn new(options: &PackOptions, blend: BlendChoice) -> Result<Self, PackError> {
        let PackOptions { quantum_um, scale, rotate_deg, .. } = *options;
        let to_quanta = DMat3::from_diagonal(DVec3::from(scale.map(|factor| factor * 1000.0 / quantum_um)));
        let turn = turn(rotate_deg);
        let map = DMat3::from_diagonal(DVec3::from(scale)) * turn;
        let uniform = scale.iter().all(|factor| *factor == scale[0]).then(|| Stretch::uniform(scale[0]));
        let stretch = uniform
            .or_else(|| Stretch::of(map))
            .ok_or_else(|| PackError::Option(format!("--scale {}: it flattens the part", factors(scale))))?;
        Ok(Self { quantum_um, blend, map, stretch, to_quanta: to_quanta * turn })
    }

    /// What becomes of radii that `map` is applied to before the options are; `None` where that flattens them.
    pub(super) fn stretch(&self, map: DMat3) -> Option<Stretch> {
        if map == DMat3::IDENTITY { Some(self.stretch) } else { Stretch::of(self.map * map) }
    }

    fn node(&self, point: DVec3, place: &dyn Fn() -> String) -> Result<[i32; 3], PackError> {
        let quanta = self.to_quanta * point;
        let quanta = quanta.to_array();
        // Not so where any is no number.
        if quanta.iter().all(|value| value.abs() <= COORDINATE_LIMIT) {
            return Ok(quanta.map(nearest));
        }
        let problem = format!(
            "the point {:?}, {:?}, {:?} mm is not within ±{} mm of the origin once turned and scaled: a quantum of {} µm \
             reaches no further (--quantum)",
            point.x,
            point.y,
            point.z,
            (COORDINATE_LIMIT * self.quantum_um / 1000.0).floor(),
            self.quantum_um
        );
        Err(PackError::input(place(), problem))
    }

    fn radius(&self, radius_mm: f64, stretch: Stretch, place: &dyn Fn() -> String) -> Result<u32, PackError> {
        let quanta = radius_mm * stretch.mean() * 1000.0 / self.quantum_um;
        if !(0.5..=f64::from(LARGEST_RADIUS)).contains(&quanta) {
            let problem = format!(
                "a radius of {radius_mm} mm, scaled by {}; allowed is {} to {} mm at a quantum of {} µm (--quantum)",
                stretch.mean(),
                self.quantum_um / 2000.0,
                (f64::from(LARGEST_RADIUS) * self.quantum_um / 1000.0).floor(),
                self.quantum_um
            );
            return Err(PackError::input(place(), problem));
        }
        let off_um = stretch.off(radius_mm) * 1000.0;
        if off_um > ROUND_TOLERANCE_UM {
            let [least, most] = stretch.range();
            let problem = format!(
                "a radius of {radius_mm} mm is stretched by {least:.4} to {most:.4} in different directions (transform, --scale): \
                 a round strut would be oval, and off by up to {off_um:.0} µm if it stayed round; allowed are \
                 {ROUND_TOLERANCE_UM} µm. Use one factor for all directions, or factors that differ by at most {:.4} for \
                 this radius",
                (2.0 * ROUND_TOLERANCE_UM / 1000.0 / radius_mm * 1e4).floor() / 1e4
            );
            return Err(PackError::input(place(), problem));
        }
        if let BlendChoice::Convolution { support_mm: Some(support_mm) } = self.blend {
            let final_mm = f64::from(nearest(quanta)) * self.quantum_um / 1000.0;
            if final_mm >= LARGEST_RADIUS_SHARE * support_mm {
                let problem = format!(
                    "a radius of {final_mm:?} mm does not fit the support R = {support_mm} mm: it must be below \
                     {LARGEST_RADIUS_SHARE} R; name --support {:.3} or more, or none",
                    SUPPORT_FACTOR * final_mm
                );
                return Err(PackError::input(place(), problem));
            }
        }
        Ok(nearest(quanta) as u32)
    }
}

impl Lane<'_> {
    /// Adds one beam; `place` names it in errors.
    ///
    /// # Errors
    /// Where it has no finite place, no positive radius, or a radius too large for the support or for how it is stretched.
    pub(super) fn beam(&mut self, beam: &Beam, place: &dyn Fn() -> String) -> Result<(), PackError> {
        self.stretched_beam(beam, self.rules.stretch, place)
    }

    /// Adds one beam whose radii are those before a map of this [`Rules::stretch`].
    fn stretched_beam(&mut self, beam: &Beam, stretch: Stretch, place: &dyn Fn() -> String) -> Result<(), PackError> {
        let Beam { a, b, radius_a: stated_a, radius_b: stated_b, caps } = *beam;
        let rules = self.rules;
        let (a, b) = (rules.node(a, place)?, rules.node(b, place)?);
        let (radius_a, radius_b) = (rules.radius(stated_a, stretch, place)?, rules.radius(stated_b, stretch, place)?);
        if a == b {
            self.tally.short_count += 1;
            return Ok(());
        }
        self.tally.capped_count += u64::from(caps != Caps::default());
        self.tally.stretched(stretch, stated_a.max(stated_b));
        let strut = Strut { a, b, radius_a, radius_b, caps };
        self.push(if node_key(a) <= node_key(b) { strut } else { reversed(strut) })
    }

    /// Adds one ball whose radius is that before a map of this [`Rules::stretch`]; `place` names it in errors.
    ///
    /// # Errors
    /// As [`Lane::beam`].
    fn ball(
        &mut self,
        centre: DVec3,
        stated: f64,
        stretch: Stretch,
        place: &dyn Fn() -> String,
    ) -> Result<(), PackError> {
        let node = self.rules.node(centre, place)?;
        let radius = self.rules.radius(stated, stretch, place)?;
        self.tally.stretched(stretch, stated);
        self.push(Strut { a: node, b: node, radius_a: radius, radius_b: radius, caps: Caps::default() })
    }

    fn push(&mut self, strut: Strut) -> Result<(), PackError> {
        self.tally.largest_radius = self.tally.largest_radius.max(strut.radius_a).max(strut.radius_b);
        self.tally.least_radius = self.tally.least_radius.into_iter().chain([strut.radius_a, strut.radius_b]).min();
        self.tally.radius_sum += u64::from(strut.radius_a) + u64::from(strut.radius_b);
        self.tally.count += 1;
        let sorted = self.sorter.push(strut);
        sorted.map_err(|source| PackError::Sort { directory: self.directory.clone(), source })
    }
}

impl<'a> Collector<'a> {
    /// A collector of as many lanes as `options` asks for threads; runs are spilled to `directory`.
    pub(in crate::buildfile) fn new(rules: &'a Rules, options: &PackOptions, directory: &Path) -> Self {
        let threads = options.threads.get();
        let lane = |sorter| Lane { rules, sorter, directory: directory.into(), tally: Tally::default() };
        Self {
            rules,
            lanes: Sorter::team(directory, options.memory_bytes, threads).into_iter().map(lane).collect(),
            hasher: Sha256::new(),
            stated_supports: Vec::new(),
            notes: Vec::new(),
            directory: directory.into(),
            memory_bytes: options.memory_bytes,
            expected: 0,
            turn: 0,
        }
    }

    /// Adds a sentence for the operator.
    pub(super) fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Remembers a convolution radius that a source states, millimetres.
    pub(super) fn stated_support(&mut self, place: String, support_mm: f64) {
        self.stated_supports.push((place, support_mm));
    }

    /// Announces that a source holds at most so many struts, before the first of them; `progress` takes what temporary space
    /// is needed besides what earlier sources took, where memory does not suffice.
    ///
    /// # Errors
    /// Where that space is not free.
    pub(super) fn expect(&mut self, struts: u64, progress: &mut dyn FnMut(PackProgress)) -> Result<(), PackError> {
        self.expected = self.expected.saturating_add(struts);
        let temporary_bytes = sort::spill_bytes(self.expected, self.memory_bytes, self.lanes.len())
            .saturating_sub(self.lanes[0].sorter.spilled_bytes());
        if temporary_bytes == 0 {
            return Ok(());
        }
        let output_bytes = self.expected.saturating_mul(EXPECTED_STRUT_BYTES);
        let directory = &self.directory;
        let sort_error = |source| PackError::Sort { directory: directory.clone(), source };
        let free_bytes = crate::disk::free_bytes(directory).map_err(sort_error)?;
        progress(PackProgress::Space { temporary_bytes, output_bytes, free_bytes });
        sort::check_free_space(directory, temporary_bytes).map_err(sort_error)
    }

    /// What each thread may add to, at least one, and the digest of all sources' bytes in order.
    pub(super) fn parts(&mut self) -> (&mut [Lane<'a>], &mut Sha256) {
        (&mut self.lanes, &mut self.hasher)
    }

    /// What becomes of radii that `map` is applied to before the options are; `None` where that flattens them.
    pub(super) fn stretch(&self, map: DMat3) -> Option<Stretch> {
        self.rules.stretch(map)
    }

    /// As [`Lane::beam`], for sources that are read by one thread, of radii before a map of this [`Collector::stretch`].
    pub(super) fn beam(&mut self, beam: &Beam, stretch: Stretch, place: &dyn Fn() -> String) -> Result<(), PackError> {
        self.next_lane().stretched_beam(beam, stretch, place)
    }

    /// Adds one ball; otherwise as [`Collector::beam`].
    pub(super) fn ball(
        &mut self,
        centre: DVec3,
        radius: f64,
        stretch: Stretch,
        place: &dyn Fn() -> String,
    ) -> Result<(), PackError> {
        self.next_lane().ball(centre, radius, stretch, place)
    }

    /// In turns, as each lane has its share of the memory.
    fn next_lane(&mut self) -> &mut Lane<'a> {
        self.turn = (self.turn + 1) % self.lanes.len();
        &mut self.lanes[self.turn]
    }

    /// Settles blend and notes.
    ///
    /// # Errors
    /// Where no strut was found.
    pub(in crate::buildfile) fn finish(mut self, inputs: &[PathBuf]) -> Result<Collected, PackError> {
        let Tally { largest_radius, least_radius, radius_sum, count, short_count, capped_count, most_off_um } =
            self.tally();
        let quantum_mm = self.rules.quantum_um / 1000.0;
        if count == 0 {
            return Err(self.nothing(inputs, short_count));
        }
        let blend = match self.rules.blend {
            BlendChoice::Union => Blend::Union,
            BlendChoice::Convolution { support_mm } => {
                let default_um = SUPPORT_FACTOR * f64::from(largest_radius) * self.rules.quantum_um;
                let support_um = support_mm.map_or(default_um, |support_mm| support_mm * 1000.0);
                self.note_supports(support_um / 1000.0);
                let mean_radius_um = radius_sum as f64 / (2 * count) as f64 * self.rules.quantum_um;
                if support_um > WIDE_SUPPORT * mean_radius_um {
                    self.notes.push(format!(
                        "R = {} mm is {:.0} times the mean radius: struts within R of one another swell into one body, and \
                         short ones print thin or not at all. Look at it with `layerctl slice`; --support names another R, \
                         above the thickest radius of {} mm, and --blend union has none",
                        support_um / 1000.0,
                        support_um / mean_radius_um,
                        f64::from(largest_radius) * quantum_mm
                    ));
                }
                Blend::Convolution { support_um }
            }
        };
        if let Some(least_radius) = least_radius.filter(|radius| *radius < COARSE_RADIUS) {
            self.notes.push(format!(
                "the thinnest radius is {least_radius} quanta of {quantum_mm} mm: rounding has changed it by up to {} %; name a \
                 smaller --quantum",
                100 / (2 * least_radius - 1)
            ));
        }
        if short_count > 0 {
            self.notes.push(format!(
                "left out {} shorter than the file's resolution of {quantum_mm} mm",
                count_text(short_count, "strut")
            ));
        }
        if capped_count > 0 && blend != Blend::Union {
            self.notes.push(format!(
                "the caps of {} do not apply: a convolution surface rounds its ends by itself; --blend union has them",
                count_text(capped_count, "beam")
            ));
        }
        // What the file's resolution hides needs no word.
        if most_off_um > self.rules.quantum_um / 2.0 {
            self.notes.push(format!(
                "directions are stretched differently, and round struts stay round, with their mean radius: surfaces lie up \
                 to {most_off_um:.1} µm off the stretched ones, of {ROUND_TOLERANCE_UM} µm that are allowed"
            ));
        }
        let Self { lanes, notes, hasher, .. } = self;
        let sorters = lanes.into_iter().map(|lane| lane.sorter).collect();
        Ok(Collected { sorters, blend, largest_radius, count, source_digest: hasher.finalize().into(), notes })
    }

    fn tally(&self) -> Tally {
        self.lanes.iter().fold(Tally::default(), |sum, Lane { tally, .. }| Tally {
            largest_radius: sum.largest_radius.max(tally.largest_radius),
            least_radius: sum.least_radius.into_iter().chain(tally.least_radius).min(),
            radius_sum: sum.radius_sum + tally.radius_sum,
            count: sum.count + tally.count,
            short_count: sum.short_count + tally.short_count,
            capped_count: sum.capped_count + tally.capped_count,
            most_off_um: sum.most_off_um.max(tally.most_off_um),
        })
    }

    fn nothing(&self, inputs: &[PathBuf], short_count: u64) -> PackError {
        let names: Vec<_> = inputs.iter().map(|path| path.display().to_string()).collect();
        let short = match short_count {
            0 => String::new(),
            count => format!(" ({count} are shorter than {} mm)", self.rules.quantum_um / 1000.0),
        };
        let left_out = match self.notes.as_slice() {
            [] => String::new(),
            notes => format!("; left out: {}", notes.join("; ")),
        };
        PackError::input(names.join(", "), format!("there are no struts to print{short}{left_out}"))
    }

    fn note_supports(&mut self, support_mm: f64) {
        for (place, stated_mm) in &self.stated_supports {
            if (stated_mm * self.rules.stretch.mean() - support_mm).abs() > 1e-9 {
                self.notes.push(format!(
                    "{place} states a convolution radius of {stated_mm} mm, which files in the wild mean otherwise; the support \
                     used is R = {support_mm} mm (name another, above the thickest radius, with --support)"
                ));
            }
        }
    }
}

/// The nearest whole number, halves away from zero, of one that an `i32` holds: `f64::round` is a call without SSE 4.1.
fn nearest(value: f64) -> i32 {
    let whole = value as i32;
    let rest = value - f64::from(whole);
    whole + i32::from(rest >= 0.5) - i32::from(rest <= -0.5)
}

fn reversed(strut: Strut) -> Strut {
    let Strut { a, b, radius_a, radius_b, caps } = strut;
    Strut { a: b, b: a, radius_a: radius_b, radius_b: radius_a, caps: Caps { a: caps.b, b: caps.a } }
}

/// One factor, or three with commas between them: as `--scale` takes them.
fn factors(scale: [f64; 3]) -> String {
    let [x, y, z] = scale;
    if x == y && y == z { x.to_string() } else { format!("{x},{y},{z}") }
}

/// # Errors
/// Where an option is out of range.
pub(in crate::buildfile) fn check_options(options: &PackOptions) -> Result<(), PackError> {
    if options.scale.iter().any(|factor| !(1e-6..=1e6).contains(factor)) {
        return Err(PackError::Option(format!("--scale {}: allowed is 0.000001 to 1000000", factors(options.scale))));
    }
    if !QUANTA_UM.contains(&options.quantum_um) {
        return Err(PackError::Option(format!("--quantum {}: allowed is 0.001 to 1000 µm", options.quantum_um)));
    }
    if options.rotate_deg.iter().any(|angle| !(-3600.0..=3600.0).contains(angle)) {
        let [x, y, z] = options.rotate_deg;
        return Err(PackError::Option(format!("--rotate {x},{y},{z}: allowed are degrees from -3600 to 3600")));
    }
    if let Some(BlendChoice::Convolution { support_mm: Some(support_mm) }) = options.blend
        && !(1e-3..=1e3).contains(&support_mm)
    {
        return Err(PackError::Option(format!("--support {support_mm}: allowed is 0.001 to 1000 mm")));
    }
    Ok(())
}

/// Rotation about x, then y, then z; quarter turns are exact.
fn turn(degrees: [f64; 3]) -> DMat3 {
    let [(sin_x, cos_x), (sin_y, cos_y), (sin_z, cos_z)] = degrees.map(sin_cos_deg);
    let x = DMat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, cos_x, sin_x, 0.0, -sin_x, cos_x]);
    let y = DMat3::from_cols_array(&[cos_y, 0.0, -sin_y, 0.0, 1.0, 0.0, sin_y, 0.0, cos_y]);
    let z = DMat3::from_cols_array(&[cos_z, sin_z, 0.0, -sin_z, cos_z, 0.0, 0.0, 0.0, 1.0]);
    z * y * x
}

fn sin_cos_deg(degrees: f64) -> (f64, f64) {
    match degrees.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        other => other.to_radians().sin_cos(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_reading_thread_fills_the_memory_of_all_lanes() {
        let threads = std::num::NonZero::<usize>::MIN.saturating_add(3);
        let options = PackOptions { memory_bytes: 2 << 20, threads, ..PackOptions::default() };
        let rules = Rules::new(&options, BlendChoice::Union).expect("in range");
        let directory = tempfile::tempdir().expect("temporary directory");
        let mut collector = Collector::new(&rules, &options, directory.path());
        // 2 MiB hold 65,536 of them.
        for number in 0..60_000 {
            let (a, b) = (DVec3::new(f64::from(number), 0.0, 0.0), DVec3::new(0.0, 0.0, 9.0));
            let beam = Beam { a, b, radius_a: 1.0, radius_b: 1.0, caps: Caps::default() };
            collector.beam(&beam, rules.stretch, &|| "the test".into()).expect("is fine");
        }
        assert_eq!(collector.lanes[0].sorter.spilled_bytes(), 0);
    }
}
