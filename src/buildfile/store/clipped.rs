//! The lowest and the highest point of a clipped lattice. Planes are probed from below, and from above, until one has a solid point; then the
//! interval between that plane and the last dark one is bisected. `writer` calls it once for each clip; `tests/clipped/` tests it.

use super::error::BuildFileError;
use super::reader::BuildFile;
use crate::buildfile::model::{Clip, Keeps, Lattice, QUANTUM_FRACTIONS, Triangle};
use crate::solid::{Convolution, Facet, PixelShape, PlaneProbe, ProbeCut, ProbeRecord, Union};

/// Largest distance of planes and of points, micrometres. No machine has smaller pixels and thinner layers, and before a print begins,
/// nothing may be solid so far below the plate.
const STEP_UM: f64 = 10.0;

/// Smallest distance of points, micrometres: thinner struts print on no machine.
const LEAST_PITCH_UM: f64 = 1.0;

/// Least number of planes that a height is divided into, however small it is.
const LEAST_PLANES: f64 = 16.0;

/// After so many dark planes that are not empty the step is doubled: a lattice that is clipped over a great height must not take hours. The
/// step in which a solid point is found is probed again, in smaller ones.
const PATIENT_PLANES: u32 = 128;

/// By how much the step becomes smaller when it is probed again.
const FINER: f64 = 16.0;

/// Bisections of the last step: to less than a thousandth of it.
const HALVINGS: u32 = 10;

/// The lowest point is rounded to so many parts of a micrometre: a part that is cut at a whole height has as many layers as that height.
const PARTS_OF_UM: f64 = 10.0;

/// The heights between which a clipped lattice lies, micrometres. `None` if nothing is left of it.
///
/// # Errors
/// If a chunk cannot be read.
pub(super) fn range_of_clipped(
    file: &BuildFile,
    body: usize,
    lattice: &Lattice,
    clip: &Clip,
) -> Result<Option<[f64; 2]>, BuildFileError> {
    match lattice.joint.support_um() {
        None => Probing::<Union>::range(file, body, lattice, clip, 1.0),
        Some(support_um) => Probing::<Convolution>::range(file, body, lattice, clip, support_um),
    }
}

/// Something that is held while planes may reach it.
trait Held: Sized {
    /// Lowest and highest z.
    fn z(&self) -> [f64; 2];
}

impl Held for ProbeRecord {
    fn z(&self) -> [f64; 2] {
        [f64::from(self.record.a[2]), f64::from(self.record.b[2])]
    }
}

impl Held for Facet {
    fn z(&self) -> [f64; 2] {
        let [a, b, c] = self.map(|corner| corner[2]);
        [a.min(b).min(c), a.max(b).max(c)]
    }
}

/// What planes may reach that move up or down.
struct Near<T> {
    /// Chunks that are still to be read.
    chunks: Vec<usize>,
    held: Vec<T>,
    moves_up: bool,
}

impl<T: Held> Near<T> {
    fn new(file: &BuildFile, body: usize, moves_up: bool) -> Self {
        Self { chunks: file.body_chunks(body).collect(), held: Vec::new(), moves_up }
    }

    /// Drops what lies behind the planes of a range, and reads what they may reach. `scale` is the unit of `low` and `high` in quanta.
    fn hold(
        &mut self,
        file: &BuildFile,
        [low, high]: [f64; 2],
        scale: f64,
        read: impl Fn(usize, &mut Vec<T>) -> Result<(), BuildFileError>,
    ) -> Result<(), BuildFileError> {
        let mut result = Ok(());
        let held = &mut self.held;
        self.chunks.retain(|&chunk| {
            let entry = &file.chunks()[chunk];
            let is_far = f64::from(entry.z_low_min) > high * scale || f64::from(entry.z_high_max) < low * scale;
            if is_far || result.is_err() {
                return true;
            }
            result = read(chunk, held);
            false
        });
        let moves_up = self.moves_up;
        held.retain(|item| {
            let z = item.z();
            if moves_up { z[1] >= low } else { z[0] <= high }
        });
        result
    }
}

/// A clipped lattice that is probed in one direction.
struct Probing<'a, S: PixelShape> {
    file: &'a BuildFile,
    /// Unit of length of the shape, micrometres.
    unit_um: f64,
    /// How far struts reach, micrometres.
    reach_um: f64,
    struts: Near<ProbeRecord>,
    facets: Near<Facet>,
    probe: PlaneProbe<S>,
    cut: ProbeCut,
    /// Largest step, micrometres.
    step_um: f64,
    /// Planes that were probed and are not empty.
    planes: u32,
}

impl<'a, S: PixelShape> Probing<'a, S> {
    fn range(
        file: &'a BuildFile,
        body: usize,
        lattice: &Lattice,
        clip: &Clip,
        unit_um: f64,
    ) -> Result<Option<[f64; 2]>, BuildFileError> {
        let quantum_um = file.header().quantum_um;
        let Some(limits) = clip.limits(lattice, quantum_um) else { return Ok(None) };
        let [low_um, high_um] = [limits.min[2], limits.max[2]].map(|z| f64::from(z) * quantum_um);
        let radius_um = f64::from(lattice.radius_range[0]) * quantum_um;
        let reach_um = lattice.reach_um(quantum_um);
        let pitch_um = STEP_UM.min(radius_um / 2.0).max(LEAST_PITCH_UM);
        let probing = |moves_up| Self {
            file,
            unit_um,
            reach_um,
            struts: Near::new(file, body, moves_up),
            facets: Near::new(file, body + 1, moves_up),
            probe: PlaneProbe::new(quantum_um / unit_um, reach_um / unit_um, pitch_um / unit_um),
            cut: ProbeCut::new(clip.keeps == Keeps::Inside),
            step_um: STEP_UM.min(radius_um).min((high_um - low_um) / LEAST_PLANES),
            planes: 0,
        };
        let Some([lowest_um, _]) = probing(true).first(low_um, high_um)? else { return Ok(None) };
        // There is something, so from above it is found, too, unless it is thinner than a step.
        let highest = probing(false).first(high_um, lowest_um)?;
        let highest_um = highest.map_or(high_um, |[_, solid_um]| solid_um);
        let rounded_um = (lowest_um * PARTS_OF_UM).round() / PARTS_OF_UM;
        Ok(Some([rounded_um.clamp(low_um, highest_um), highest_um]))
    }

    /// Where the first solid point on the way from one height to another is: the last dark height and the first solid one.
    fn first(&mut self, from_um: f64, to_um: f64) -> Result<Option<[f64; 2]>, BuildFileError> {
        let (whole_um, sign) = ((to_um - from_um).abs(), (to_um - from_um).signum());
        let height = |way_um: f64| from_um + sign * way_um;
        let (mut dark_um, mut step_um) = (0.0, self.step_um);
        let mut solid_um = loop {
            if dark_um >= whole_um {
                return Ok(None);
            }
            let way_um = (dark_um + step_um).min(whole_um);
            if self.is_solid(height(dark_um), height(way_um))? {
                if step_um <= self.step_um {
                    break way_um;
                }
                step_um = (step_um / FINER).max(self.step_um);
                self.planes = 0;
                continue;
            }
            dark_um = way_um;
            if self.planes >= PATIENT_PLANES {
                step_um *= 2.0;
                self.planes = 0;
            }
        };
        for _ in 0..HALVINGS {
            let middle_um = f64::midpoint(dark_um, solid_um);
            if self.is_solid(height(dark_um), height(middle_um))? {
                solid_um = middle_um;
            } else {
                dark_um = middle_um;
            }
        }
        Ok(Some([height(dark_um), height(solid_um)]))
    }

    /// Whether the plane at `z_um` has a solid point. Planes behind `from_um` are not asked for any more.
    fn is_solid(&mut self, from_um: f64, z_um: f64) -> Result<bool, BuildFileError> {
        let (file, quantum_um, unit_um) = (self.file, self.file.header().quantum_um, self.unit_um);
        let range_um = [from_um.min(z_um), from_um.max(z_um)];
        let reached = [range_um[0] - self.reach_um, range_um[1] + self.reach_um].map(|um| um / quantum_um);
        self.struts.hold(file, reached, 1.0, |chunk, held| {
            let mut struts = Vec::new();
            file.read_chunk(chunk, &mut struts)?;
            held.extend(
                struts.iter().map(|strut| ProbeRecord { record: strut.record::<S>(quantum_um / unit_um), member: 0 }),
            );
            Ok(())
        })?;
        self.facets.hold(file, range_um.map(|um| um / unit_um), unit_um / quantum_um, |chunk, held| {
            let mut triangles = Vec::new();
            file.read_triangles(chunk, &mut triangles)?;
            held.extend(triangles.iter().map(|triangle| facet(triangle, quantum_um / unit_um)));
            Ok(())
        })?;
        let z = z_um / unit_um;
        self.cut.begin(self.facets.held.iter(), z);
        if self.struts.held.is_empty() || self.cut.is_empty() {
            return Ok(false);
        }
        self.planes += 1;
        Ok(self.probe.is_solid(&self.struts.held, z, Some(&mut self.cut)))
    }
}

fn facet(triangle: &Triangle, quantum: f64) -> Facet {
    let fraction = quantum / QUANTUM_FRACTIONS as f64;
    triangle.corners.map(|corner| corner.map(|at| at as f64 * fraction))
}
