//! From the numbers of a source to those of a build file: rotation, scale, quanta, and the checks of each coordinate and radius.
//! `lane` applies them.

use glam::{DMat3, DVec3};

use super::materials::MaterialNames;
use super::stretch::{ROUND_TOLERANCE_UM, Stretch};
use crate::buildfile::error::PackError;
use crate::buildfile::model::{QUANTA_UM, QUANTUM_FRACTIONS, SUPPORT_FACTOR, Triangle};
use crate::buildfile::options::{BlendBegin, JointChoice, PackOptions, ReliefOptions};
use crate::solid::{MAX_RADIUS, MAX_RADIUS_SHARE};

/// Largest coordinate of a node, quanta: half the range, which leaves room for adding a radius.
const MAX_COORDINATE: f64 = (i32::MAX / 2) as f64;

/// What is done to every beam and ball of a pack. All threads share it.
pub(in crate::buildfile) struct Rules {
    quantum_um: f64,
    joint: JointChoice,
    /// Rotation and scale.
    map: DMat3,
    stretch: Stretch,
    /// `map`, from millimetres to quanta.
    to_quanta: DMat3,
    materials: MaterialNames,
}

impl Rules {
    /// # Errors
    /// If the factors flatten the part, or materials cannot be renamed as the options say.
    pub(in crate::buildfile) fn new(options: &PackOptions, joint: JointChoice) -> Result<Self, PackError> {
        let PackOptions { quantum_um, scale, rotate_deg, .. } = *options;
        let to_quanta = DMat3::from_diagonal(DVec3::from(scale.map(|factor| factor * 1000.0 / quantum_um)));
        let turn = turn(rotate_deg);
        let map = DMat3::from_diagonal(DVec3::from(scale)) * turn;
        let uniform = scale.iter().all(|factor| *factor == scale[0]).then(|| Stretch::uniform(scale[0]));
        let stretch = uniform
            .or_else(|| Stretch::of(map))
            .ok_or_else(|| PackError::Option(format!("--scale {}: it flattens the part", factors(scale))))?;
        let materials = MaterialNames::new(&options.materials)?;
        Ok(Self { quantum_um, joint, map, stretch, to_quanta: to_quanta * turn, materials })
    }

    /// Length of a quantum, micrometres.
    pub(super) fn quantum_um(&self) -> f64 {
        self.quantum_um
    }

    /// The materials of the sources.
    pub(in crate::buildfile) fn materials(&self) -> &MaterialNames {
        &self.materials
    }

    /// How the pack was asked to join struts.
    pub(super) fn joint(&self) -> JointChoice {
        self.joint
    }

    /// What the options alone do to radii.
    pub(super) fn stretch(&self) -> Stretch {
        self.stretch
    }

    /// What `map` followed by the options does to radii; `None` if it flattens them.
    pub(super) fn stretch_after(&self, map: DMat3) -> Option<Stretch> {
        if map == DMat3::IDENTITY { Some(self.stretch) } else { Stretch::of(self.map * map) }
    }

    /// A point, given in millimetres, as a node. `place` names it in errors.
    ///
    /// # Errors
    /// If it is too far from the origin or not finite.
    pub(super) fn node(&self, point: DVec3, place: &dyn Fn() -> String) -> Result<[i32; 3], PackError> {
        let quanta = self.to_quanta * point;
        let quanta = quanta.to_array();
        // False if any of them is NaN.
        if quanta.iter().all(|value| value.abs() <= MAX_COORDINATE) {
            return Ok(quanta.map(nearest));
        }
        Err(self.too_far(point, place))
    }

    /// Where a corner was before it was rotated and scaled, millimetres.
    pub(super) fn source_mm(&self, corner: [i64; 3]) -> [f64; 3] {
        let quanta = DVec3::from(corner.map(|at| at as f64 / QUANTUM_FRACTIONS as f64));
        (self.to_quanta.inverse() * quanta).to_array()
    }

    fn too_far(&self, point: DVec3, place: &dyn Fn() -> String) -> PackError {
        if !point.is_finite() {
            let problem =
                format!("the point {}, {}, {} is not finite; export the part again", point.x, point.y, point.z);
            return PackError::input(place(), problem);
        }
        let problem = format!(
            "the point {:?}, {:?}, {:?} mm, rotated and scaled, is farther than {} mm from the origin along an axis, the limit \
             at a quantum of {} µm; use a larger --quantum",
            point.x,
            point.y,
            point.z,
            (MAX_COORDINATE * self.quantum_um / 1000.0).floor(),
            self.quantum_um
        );
        PackError::input(place(), problem)
    }

    /// A point, given in millimetres, as a corner of a triangle, in fractions of a quantum. `place` names it in errors.
    ///
    /// # Errors
    /// If it is too far from the origin or not finite.
    pub(super) fn corner(&self, point: DVec3, place: &dyn Fn() -> String) -> Result<[i64; 3], PackError> {
        let fractions = (self.to_quanta * point * QUANTUM_FRACTIONS as f64).to_array();
        // False if any of them is NaN.
        if fractions.iter().all(|value| value.abs() <= Triangle::MAX_COORDINATE as f64) {
            return Ok(fractions.map(|value| value.round() as i64));
        }
        Err(self.too_far(point, place))
    }

    /// A normal of a source, as it is once the part has been rotated and scaled, of any length.
    pub(super) fn normal(&self, normal: DVec3) -> DVec3 {
        // Of the transposed inverse, up to a positive factor.
        let DMat3 { x_axis, y_axis, z_axis } = self.map;
        y_axis.cross(z_axis) * normal.x + z_axis.cross(x_axis) * normal.y + x_axis.cross(y_axis) * normal.z
    }

    /// Rotation and scale.
    pub(super) fn map(&self) -> DMat3 {
        self.map
    }

    /// A place in fractions of a quantum, micrometres.
    pub(super) fn um(&self, at: [i64; 3]) -> DVec3 {
        DVec3::from(at.map(|at| at as f64 / QUANTUM_FRACTIONS as f64)) * self.quantum_um
    }

    /// A point, given in millimetres, in quanta, not rounded.
    pub(in crate::buildfile) fn quanta(&self, point: [f64; 3]) -> [f64; 3] {
        (self.to_quanta * DVec3::from(point)).to_array()
    }

    /// A radius, given in millimetres, in quanta. `place` names it in errors.
    ///
    /// # Errors
    /// If it is too small or too large for the quantum, too large for the support, or too large for how it is stretched.
    pub(super) fn radius(
        &self,
        radius_mm: f64,
        stretch: Stretch,
        place: &dyn Fn() -> String,
    ) -> Result<u32, PackError> {
        let quanta = radius_mm * stretch.mean() * 1000.0 / self.quantum_um;
        if !(0.5..=f64::from(MAX_RADIUS)).contains(&quanta) {
            let problem = format!(
                "a radius of {radius_mm} mm, scaled by {}; allowed is {} to {} mm at a quantum of {} µm (--quantum)",
                stretch.mean(),
                self.quantum_um / 2000.0,
                (f64::from(MAX_RADIUS) * self.quantum_um / 1000.0).floor(),
                self.quantum_um
            );
            return Err(PackError::input(place(), problem));
        }
        self.check_roundness(radius_mm, stretch, place)?;
        let radius = nearest(quanta);
        self.check_support(radius, place)?;
        Ok(radius as u32)
    }

    fn check_roundness(&self, radius_mm: f64, stretch: Stretch, place: &dyn Fn() -> String) -> Result<(), PackError> {
        let off_um = stretch.off(radius_mm) * 1000.0;
        if off_um <= ROUND_TOLERANCE_UM {
            return Ok(());
        }
        let [smallest, largest] = stretch.range();
        let problem = format!(
            "a radius of {radius_mm} mm is stretched by {smallest:.4} to {largest:.4} in different directions (transform, \
             --scale): the round strut that a build file can hold would be off by up to {off_um:.0} µm; the limit is \
             {ROUND_TOLERANCE_UM} µm. Use one factor for all directions, or factors that differ by at most {:.4} for \
             this radius",
            (2.0 * ROUND_TOLERANCE_UM / 1000.0 / radius_mm * 1e4).floor() / 1e4
        );
        Err(PackError::input(place(), problem))
    }

    fn check_support(&self, radius: i32, place: &dyn Fn() -> String) -> Result<(), PackError> {
        let JointChoice::Convolution { support_mm: Some(support_mm) } = self.joint else { return Ok(()) };
        let radius_mm = f64::from(radius) * self.quantum_um / 1000.0;
        if radius_mm < MAX_RADIUS_SHARE * support_mm {
            return Ok(());
        }
        let problem = format!(
            "a radius of {radius_mm:?} mm does not fit the support R = {support_mm} mm: it must be below \
             {MAX_RADIUS_SHARE} R; use --support {:.3} or more, or leave it out",
            SUPPORT_FACTOR * radius_mm
        );
        Err(PackError::input(place(), problem))
    }
}

/// The nearest whole number, halves away from zero, of a number within the range of `i32`. `f64::round` is a function call on
/// processors without SSE 4.1.
fn nearest(value: f64) -> i32 {
    let whole = value as i32;
    let rest = value - f64::from(whole);
    whole + i32::from(rest >= 0.5) - i32::from(rest <= -0.5)
}

/// The factors as `--scale` takes them: one, or three separated by commas.
fn factors(scale: [f64; 3]) -> String {
    let [x, y, z] = scale;
    if x == y && y == z { x.to_string() } else { format!("{x},{y},{z}") }
}

/// # Errors
/// If an option is out of range.
pub(in crate::buildfile) fn check_options(options: &PackOptions) -> Result<(), PackError> {
    if options.scale.iter().any(|factor| !(1e-6..=1e6).contains(factor)) {
        return Err(PackError::Option(format!("--scale {}: allowed is 0.000001 to 1000000", factors(options.scale))));
    }
    if let Some(size_mm) = options.size_mm
        && !(1e-3..=1e6).contains(&size_mm)
    {
        return Err(PackError::Option(format!("--size {size_mm}: allowed is 0.001 to 1000000 mm")));
    }
    if !QUANTA_UM.contains(&options.quantum_um) {
        return Err(PackError::Option(format!("--quantum {}: allowed is 0.001 to 1000 µm", options.quantum_um)));
    }
    if options.rotate_deg.iter().any(|angle| !(-3600.0..=3600.0).contains(angle)) {
        let [x, y, z] = options.rotate_deg;
        return Err(PackError::Option(format!("--rotate {x},{y},{z}: allowed are degrees from -3600 to 3600")));
    }
    check_relief(&options.relief)?;
    if let Some(support_mm) = options.joint.and_then(JointChoice::support_mm)
        && !(1e-3..=1e3).contains(&support_mm)
    {
        return Err(PackError::Option(format!("--support {support_mm}: allowed is 0.001 to 1000 mm")));
    }
    if let Some(JointChoice::Elliptic { begins: BlendBegin::Points(points), .. }) = options.joint
        && let Some(far) = points.as_flattened().iter().find(|at| !(-1e6..=1e6).contains(*at))
    {
        return Err(PackError::Option(format!("--control-points: {far}, but allowed is -1000000 to 1000000 mm")));
    }
    Ok(())
}

fn check_relief(options: &ReliefOptions) -> Result<(), PackError> {
    let ReliefOptions { map, height_mm, offset_mm, shell_mm, .. } = options;
    let refused = |text: String| Err(PackError::Option(text));
    for (name, length_mm) in [("--height", height_mm), ("--offset", offset_mm)] {
        if length_mm.is_some_and(|length_mm| !(-1000.0..=1000.0).contains(&length_mm)) {
            return refused(format!("{name} {}: allowed is -1000 to 1000 mm", length_mm.unwrap_or_default()));
        }
    }
    if map.is_some() && height_mm.is_none() {
        return refused(
            "--displacement needs --height: how far the surface is displaced where the map is white, in mm".into(),
        );
    }
    match shell_mm {
        Some(shell_mm) if !(1e-3..=1000.0).contains(shell_mm) => {
            refused(format!("--shell {shell_mm}: allowed is 0.001 to 1000 mm"))
        }
        _ => Ok(()),
    }
}

/// Rotation about x, then y, then z. Quarter turns are exact.
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
