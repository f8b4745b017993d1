//! What importers hand over: beams and balls in millimetres, turned, scaled, quantised, checked and given to the sort.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::chunk::node_key;
use super::model::{Blend, Caps, Strut};
use super::pack::{BlendChoice, PackError, PackOptions};
use super::sort::Sorter;
use crate::solid::LARGEST_RADIUS_SHARE;

/// Support R as a multiple of the largest radius where none is named: keeps every radius at or below 2R/3.
const SUPPORT_FACTOR: f64 = 1.5;

/// One beam in millimetres as its source states it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    pub(super) a: DVec3,
    pub(super) b: DVec3,
    pub(super) radius_a: f64,
    pub(super) radius_b: f64,
    pub(super) caps: Caps,
}

/// Takes beams and balls of all inputs.
pub(super) struct Collector<'a> {
    options: &'a PackOptions,
    quantum_um: f64,
    turn: DMat3,
    directory: PathBuf,
    sorter: Sorter,
    largest_radius: u32,
    count: u64,
    /// Beams whose ends fall on one quantum.
    short_count: u64,
    /// Beams with caps other than spheres.
    capped_count: u64,
    /// Place and millimetres of convolution radii that sources state.
    stated_supports: Vec<(String, f64)>,
    notes: Vec<String>,
}

/// Everything a build file is written from.
pub(super) struct Collected {
    pub(super) sorter: Sorter,
    pub(super) blend: Blend,
    pub(super) largest_radius: u32,
    pub(super) count: u64,
    pub(super) notes: Vec<String>,
}

impl<'a> Collector<'a> {
    pub(super) fn new(options: &'a PackOptions, quantum_um: f64, directory: &Path) -> Result<Self, PackError> {
        check_options(options)?;
        Ok(Self {
            options,
            quantum_um,
            turn: turn(options.rotate_deg) * options.scale,
            directory: directory.into(),
            sorter: Sorter::new(directory, options.memory_bytes),
            largest_radius: 0,
            count: 0,
            short_count: 0,
            capped_count: 0,
            stated_supports: Vec::new(),
            notes: Vec::new(),
        })
    }

    /// Adds a sentence for the operator.
    pub(super) fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Remembers a convolution radius that a source states, millimetres.
    pub(super) fn stated_support(&mut self, place: String, support_mm: f64) {
        self.stated_supports.push((place, support_mm));
    }

    /// Adds one beam; `place` names it in errors.
    ///
    /// # Errors
    /// Where it has no finite place, no positive radius, or a radius too large for the support.
    pub(super) fn beam(&mut self, beam: &Beam, place: &dyn Fn() -> String) -> Result<(), PackError> {
        let Beam { a, b, radius_a, radius_b, mut caps } = *beam;
        let ends = [self.node(a, place)?, self.node(b, place)?];
        let radii = [self.radius(radius_a, place)?, self.radius(radius_b, place)?];
        if ends[0] == ends[1] {
            self.short_count += 1;
            return Ok(());
        }
        if caps != Caps::default() {
            self.capped_count += 1;
            if self.options.blend != BlendChoice::Union {
                caps = Caps::default();
            }
        }
        let [a, b] = ends;
        let strut = Strut { a, b, radius_a: radii[0], radius_b: radii[1], caps };
        self.push(if node_key(a) <= node_key(b) { strut } else { reversed(strut) })
    }

    /// Adds one ball; `place` names it in errors.
    ///
    /// # Errors
    /// As [`Collector::beam`].
    pub(super) fn ball(&mut self, centre: DVec3, radius: f64, place: &dyn Fn() -> String) -> Result<(), PackError> {
        let node = self.node(centre, place)?;
        let radius = self.radius(radius, place)?;
        self.push(Strut { a: node, b: node, radius_a: radius, radius_b: radius, caps: Caps::default() })
    }

    fn push(&mut self, strut: Strut) -> Result<(), PackError> {
        self.largest_radius = self.largest_radius.max(strut.radius_a).max(strut.radius_b);
        self.count += 1;
        let sorted = self.sorter.push(strut);
        sorted.map_err(|source| PackError::Sort { directory: self.directory.clone(), source })
    }

    fn node(&self, point: DVec3, place: &dyn Fn() -> String) -> Result<[i32; 3], PackError> {
        let quanta = self.turn * point * (1000.0 / self.quantum_um);
        // Radii add to a node's place: half the range leaves room for them.
        let limit = f64::from(i32::MAX / 2);
        if !(quanta.is_finite() && quanta.abs().max_element() <= limit) {
            let problem = format!(
                "the point {:?}, {:?}, {:?} mm is not within ±{} m of the origin",
                point.x,
                point.y,
                point.z,
                (limit * self.quantum_um / 1e6).floor()
            );
            return Err(PackError::input(place(), problem));
        }
        Ok(quanta.round().to_array().map(|value| value as i32))
    }

    fn radius(&self, radius_mm: f64, place: &dyn Fn() -> String) -> Result<u32, PackError> {
        let quanta = (radius_mm * self.options.scale * 1000.0 / self.quantum_um).round();
        if !(1.0..=f64::from(i32::MAX / 4)).contains(&quanta) {
            let problem = format!(
                "a radius of {radius_mm} mm, scaled by {}; allowed is {} mm or more",
                self.options.scale,
                self.quantum_um / 1000.0
            );
            return Err(PackError::input(place(), problem));
        }
        if let BlendChoice::Convolution { support_mm: Some(support_mm) } = self.options.blend {
            let final_mm = quanta * self.quantum_um / 1000.0;
            if final_mm >= LARGEST_RADIUS_SHARE * support_mm {
                let problem = format!(
                    "a radius of {final_mm:?} mm does not fit the support R = {support_mm} mm: it must be below \
                     {LARGEST_RADIUS_SHARE} R; name --support {:.3} or more, or none",
                    SUPPORT_FACTOR * final_mm
                );
                return Err(PackError::input(place(), problem));
            }
        }
        Ok(quanta as u32)
    }

    /// Settles blend and notes.
    ///
    /// # Errors
    /// Where no strut was found.
    pub(super) fn finish(mut self, inputs: &[PathBuf]) -> Result<Collected, PackError> {
        if self.count == 0 {
            let names: Vec<_> = inputs.iter().map(|path| path.display().to_string()).collect();
            let short = match self.short_count {
                0 => String::new(),
                count => format!(" ({count} are shorter than {} mm)", self.quantum_um / 1000.0),
            };
            let left_out = match self.notes.as_slice() {
                [] => String::new(),
                notes => format!("; left out: {}", notes.join("; ")),
            };
            return Err(PackError::input(names.join(", "), format!("there are no struts to print{short}{left_out}")));
        }
        let blend = match self.options.blend {
            BlendChoice::Union => Blend::Union,
            BlendChoice::Convolution { support_mm } => {
                let default_um = SUPPORT_FACTOR * f64::from(self.largest_radius) * self.quantum_um;
                let support_um = support_mm.map_or(default_um, |support_mm| support_mm * 1000.0);
                self.note_supports(support_um / 1000.0);
                Blend::Convolution { support_um }
            }
        };
        if self.short_count > 0 {
            self.notes.push(format!(
                "{} struts shorter than the file's resolution of {} mm were left out",
                self.short_count,
                self.quantum_um / 1000.0
            ));
        }
        if self.capped_count > 0 && blend != Blend::Union {
            self.notes.push(format!(
                "the caps of {} beams were left out: a convolution surface rounds its ends by itself; \
                 --blend union keeps them",
                self.capped_count
            ));
        }
        let Self { sorter, largest_radius, count, notes, .. } = self;
        Ok(Collected { sorter, blend, largest_radius, count, notes })
    }

    fn note_supports(&mut self, support_mm: f64) {
        for (place, stated_mm) in &self.stated_supports {
            let stated_mm = stated_mm * self.options.scale;
            if (stated_mm - support_mm).abs() > 1e-9 {
                self.notes.push(format!(
                    "{place} states a convolution radius of {stated_mm} mm; the support used is R = {support_mm} mm \
                     (name another with --support)"
                ));
            }
        }
    }
}

fn reversed(strut: Strut) -> Strut {
    let Strut { a, b, radius_a, radius_b, caps } = strut;
    Strut { a: b, b: a, radius_a: radius_b, radius_b: radius_a, caps: Caps { a: caps.b, b: caps.a } }
}

fn check_options(options: &PackOptions) -> Result<(), PackError> {
    if !(1e-6..=1e6).contains(&options.scale) {
        return Err(PackError::Option(format!("--scale {}: allowed is 0.000001 to 1000000", options.scale)));
    }
    if options.rotate_deg.iter().any(|angle| !(-3600.0..=3600.0).contains(angle)) {
        let [x, y, z] = options.rotate_deg;
        return Err(PackError::Option(format!("--rotate {x},{y},{z}: allowed are degrees from -3600 to 3600")));
    }
    if let BlendChoice::Convolution { support_mm: Some(support_mm) } = options.blend
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
