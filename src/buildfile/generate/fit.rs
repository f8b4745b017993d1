//! Finds the grid for a lattice: one with enough struts in the box, and, if requested, a box of such a height that a given number of
//! struts is active at the busiest plane. `generate` calls [`fit`].

use super::grid::{Grid, Radii};
use super::{GenerateOptions, Height, QUANTUM_UM};
use crate::buildfile::error::PackError;

/// Default radius in grid steps: a tenth of the edge of a cell. Struts are slender, but still 4 pixels of 50 µm in radius in a cell of
/// 2 mm.
const RADIUS_SHARE: f64 = 0.2;

/// Smallest distance of grid points, micrometres: nodes that are closer could fall on the same quantum.
const MIN_PITCH: f64 = 10.0;

/// Each grid that is tried is finer than the one before by this factor. A large grid then has at most 1 % more struts than wanted.
const FINER: f64 = 0.998;

/// Bisections of the height, on a logarithmic scale of five decades: down to about 1 %.
const BISECTIONS: u32 = 10;

/// Number of heights tried around the one found, and their largest distance from it as a share: a lattice has a whole number of layers
/// of nodes, so its active set jumps up and down.
const NEAR_HEIGHTS: u32 = 24;
const NEAR_SHARE: f64 = 0.15;

/// Heights of a cell, as shares of its width, that are tried with each height of the box. A flat lattice of few layers needs the choice.
const STRETCHES: [f64; 3] = [1.0, 0.85, 1.15];

/// Relative error that is small enough to stop the search.
const CLOSE: f64 = 0.005;

/// Most struts that are counted to find the busiest plane. Of a larger lattice only a section is counted.
const MAX_COUNTED: u64 = 500_000;

/// Size of that section: layers of nodes, beyond which the active set of a higher lattice hardly changes, and steps along x and y.
const SECTION_LAYERS: i64 = 12;
const SECTION_STEPS: i64 = 128;

/// Slabs of the height for which active struts are counted.
const SLABS: usize = 4096;

/// Largest allowed relative error of the counted active set. It leaves room for the errors of counting a section, and in slabs: together
/// they are below 5 %.
const TOLERANCE: f64 = 0.025;

/// The grid and the radii for `options`.
///
/// # Errors
/// [`PackError::Option`] names the option that is out of range.
pub(super) fn fit(options: &GenerateOptions) -> Result<(Grid, Radii), PackError> {
    let GenerateOptions { struts, footprint_mm, height, .. } = *options;
    if !(1..=1_000_000_000).contains(&struts) {
        return refused(format!("--struts {struts}: allowed is 1 to 1000000000"));
    }
    let edges = footprint_mm.into_iter().chain(match height {
        Height::Mm(height_mm) => Some(height_mm),
        Height::Active(_) => None,
    });
    if let Some(edge) = edges.into_iter().find(|edge| !(0.1..=1e4).contains(edge)) {
        return refused(format!("--box with an edge of {edge} mm: allowed is 0.1 to 10000 mm"));
    }
    match height {
        Height::Mm(height_mm) => in_height(options, height_mm, 1.0),
        Height::Active(active) if active > struts => {
            refused(format!("--active {active}: there are only {struts} struts"))
        }
        Height::Active(active) => with_active(options, active),
    }
}

fn refused<T>(problem: String) -> Result<T, PackError> {
    Err(PackError::Option(problem))
}

/// The coarsest grid with enough struts in a box of this height. Its cells are about `stretch` times as high as wide.
fn in_height(options: &GenerateOptions, height_mm: f64, stretch: f64) -> Result<(Grid, Radii), PackError> {
    let GenerateOptions { kind, struts, footprint_mm: [x_mm, y_mm], radius_mm, seed, .. } = *options;
    let edges = [x_mm, y_mm, height_mm].map(|edge_mm| edge_mm * 1000.0 / QUANTUM_UM);
    // Begin with a coarse grid: a flat or slender box has several times as many struts as the same volume inside a large one.
    let mut step = 2.0 * (edges.iter().product::<f64>() * kind.density() / struts as f64).cbrt();
    let grid = loop {
        let multiple = kind.steps_multiple();
        let wished = [step, step, step * stretch];
        let steps =
            [0, 1, 2].map(|axis| (edges[axis] / wished[axis] / multiple as f64).round().max(1.0) as i64 * multiple);
        let pitch = [0, 1, 2].map(|axis| edges[axis] / steps[axis] as f64);
        if let Some(pitch) = pitch.iter().find(|pitch| **pitch < MIN_PITCH) {
            return refused(format!(
                "--struts {struts}: nodes {pitch:.1} µm apart in this box; ask for fewer or a larger --box"
            ));
        }
        let grid = Grid { kind, seed, steps, pitch };
        if grid.strut_count() >= struts {
            break grid;
        }
        step *= FINER;
    };
    let least_pitch = grid.pitch.iter().copied().fold(f64::INFINITY, f64::min);
    let radius = radius_mm.map_or(RADIUS_SHARE * least_pitch, |radius_mm| radius_mm * 1000.0 / QUANTUM_UM);
    if !(1.0..=1e7).contains(&radius) {
        return refused(format!("--radius {}: allowed is 0.001 to 10000 mm", radius * QUANTUM_UM / 1000.0));
    }
    Ok((grid, Radii::new(kind, radius)))
}

/// The box in which `wanted` struts are active at the busiest plane. The higher the box, the fewer are.
fn with_active(options: &GenerateOptions, wanted: u64) -> Result<(Grid, Radii), PackError> {
    let mut nearest: Option<(u64, Grid, Radii)> = None;
    let off = |active: u64| active.abs_diff(wanted) as f64 / wanted as f64;
    let mut attempt = |height_mm: f64, stretch: f64| -> Result<u64, PackError> {
        let (grid, radii) = in_height(options, height_mm, stretch)?;
        let active = busiest(&grid, &radii, options.struts);
        if nearest.is_none_or(|(nearest, ..)| off(active) < off(nearest)) {
            nearest = Some((active, grid, radii));
        }
        Ok(active)
    };
    let [mut low_mm, mut high_mm] = [0.1f64, 1e4];
    let mut failure = None;
    for _ in 0..BISECTIONS {
        let height_mm = (low_mm * high_mm).sqrt();
        match attempt(height_mm, 1.0) {
            Ok(active) if active <= wanted => high_mm = height_mm,
            Ok(_) => low_mm = height_mm,
            Err(error) => {
                // The nodes are too close to one another: the box must be higher.
                failure = Some(error);
                low_mm = height_mm;
            }
        }
    }
    let shares = (0..=NEAR_HEIGHTS).map(|number| 2.0 * f64::from(number) / f64::from(NEAR_HEIGHTS) - 1.0);
    let nearby = STRETCHES.iter().flat_map(|stretch| shares.clone().map(|share| (1.0 + NEAR_SHARE * share, *stretch)));
    for (factor, stretch) in nearby {
        // An impossible box is not a candidate.
        if attempt(high_mm * factor, stretch).is_ok_and(|active| off(active) <= CLOSE) {
            break;
        }
    }
    match (nearest, failure) {
        (Some((active, grid, radii)), _) if off(active) <= TOLERANCE => Ok((grid, radii)),
        (None, Some(failure)) => Err(failure),
        (nearest, _) => refused(format!(
            "--active {wanted}: {} struts on this footprint reach at best {} at the busiest plane, at any height; use about that \
             number, or another --radius or --footprint",
            options.struts,
            nearest.map_or(0, |(active, ..)| active)
        )),
    }
}

/// Number of active struts at the busiest plane, if `chosen` struts of a grid are chosen.
fn busiest(whole: &Grid, radii: &Radii, chosen: u64) -> u64 {
    let mut section = *whole;
    if chosen > MAX_COUNTED {
        section.steps = [
            section.steps[0].min(SECTION_STEPS),
            section.steps[1].min(SECTION_STEPS),
            section.steps[2].min(SECTION_LAYERS),
        ];
    }
    // The whole grid at the height of the section.
    let tall = Grid { steps: [whole.steps[0], whole.steps[1], section.steps[2]], ..*whole };
    let share = tall.strut_count() as f64 / section.strut_count() as f64;
    let chosen_share = chosen as f64 / whole.strut_count() as f64;
    let mut choice = section.choice((section.strut_count() as f64 * chosen_share).round() as u64);

    let reach = radii.support();
    let slab = (section.steps[2] as f64 * section.pitch[2] + 2.0 * reach) / SLABS as f64;
    // Nodes are rounded to quanta, possibly beyond the end of the last slab.
    let number = |z: f64| ((z / slab) as usize).min(SLABS);
    // The struts active in a slab are those that begin in it or below it, without those that end below it.
    let mut change = vec![0i64; SLABS + 2];
    for k in 0..section.layer_count() {
        section.layer(k, radii, &mut choice, &mut |strut| {
            change[number(f64::from(strut.a[2]))] += 1;
            change[number(f64::from(strut.b[2]) + 2.0 * reach) + 1] -= 1;
        });
    }
    let mut active = 0;
    let most = change.iter().map(|change| {
        active += change;
        active
    });
    (most.max().unwrap_or(0) as f64 * share).round() as u64
}
