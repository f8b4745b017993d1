//! How large a grid must be: enough struts in the box, and where it is asked for, a box of such a height that a given
//! number of struts is active at the busiest plane.

use super::grid::{Grid, Radii};
use super::{GenerateOptions, Height, QUANTUM_UM};
use crate::buildfile::error::PackError;

/// Strut radius in grid steps where none is given, a tenth of a cell's edge: slender, yet four pixels wide in a 2 mm cell at
/// 50 µm.
const RADIUS_SHARE: f64 = 0.2;

/// Nodes nearer than this could fall on one quantum.
const LEAST_PITCH: f64 = 10.0;

/// Each grid tried is finer than the one before by this factor: a large one has at most 1 % more struts than wanted.
const FINER: f64 = 0.998;

/// Heights tried to halve five decades on a logarithmic scale: down to about 1 %.
const BISECTIONS: u32 = 10;

/// Heights tried round the one found, and how far from it: a lattice has a whole number of layers of nodes, so that its active
/// set changes by leaps, up and down.
const NEAR_HEIGHTS: u32 = 24;
const NEAR_SHARE: f64 = 0.15;

/// Heights of a cell, as shares of its width, tried with each of them: a flat lattice of few layers of nodes needs the choice.
const STRETCHES: [f64; 3] = [1.0, 0.85, 1.15];

/// Near enough to look no further.
const CLOSE: f64 = 0.005;

/// Most struts counted to find the busiest plane, one by one; of a larger lattice a part stands for the whole.
const MOST_COUNTED: u64 = 500_000;

/// That part: layers of nodes beyond which a higher lattice is only more of the same, and steps along x and y.
const PART_LAYERS: i64 = 12;
const PART_STEPS: i64 = 128;

/// Slices of the height in which active struts are counted.
const SLABS: usize = 4096;

/// Largest share by which the active set as counted may differ from what is asked for. It leaves room for what a part of a
/// lattice and slabs of its height cannot tell.
const TOLERANCE: f64 = 0.025;

/// The grid and the radii that `options` ask for.
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

/// The coarsest grid in a box of this height that has enough struts, of cells about `stretch` times as high as wide.
fn in_height(options: &GenerateOptions, height_mm: f64, stretch: f64) -> Result<(Grid, Radii), PackError> {
    let GenerateOptions { kind, struts, footprint_mm: [x_mm, y_mm], radius_mm, seed, .. } = *options;
    let edges = [x_mm, y_mm, height_mm].map(|edge_mm| edge_mm * 1000.0 / QUANTUM_UM);
    // A flat or slender box has up to some times as many struts as a part of the inside of a large one.
    let mut step = 2.0 * (edges.iter().product::<f64>() * kind.density() / struts as f64).cbrt();
    let grid = loop {
        let multiple = kind.steps_multiple();
        let wished = [step, step, step * stretch];
        let steps =
            [0, 1, 2].map(|axis| (edges[axis] / wished[axis] / multiple as f64).round().max(1.0) as i64 * multiple);
        let pitch = [0, 1, 2].map(|axis| edges[axis] / steps[axis] as f64);
        if let Some(pitch) = pitch.iter().find(|pitch| **pitch < LEAST_PITCH) {
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

/// The box of such a height that `wanted` struts are active at the busiest plane: higher boxes have fewer.
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
                // Nodes too near one another: too little room.
                failure = Some(error);
                low_mm = height_mm;
            }
        }
    }
    let shares = (0..=NEAR_HEIGHTS).map(|number| 2.0 * f64::from(number) / f64::from(NEAR_HEIGHTS) - 1.0);
    let nearby = STRETCHES.iter().flat_map(|stretch| shares.clone().map(|share| (1.0 + NEAR_SHARE * share, *stretch)));
    for (factor, stretch) in nearby {
        // One that cannot be is no candidate.
        if attempt(high_mm * factor, stretch).is_ok_and(|active| off(active) <= CLOSE) {
            break;
        }
    }
    match (nearest, failure) {
        (Some((active, grid, radii)), _) if off(active) <= TOLERANCE => Ok((grid, radii)),
        (None, Some(failure)) => Err(failure),
        (nearest, _) => refused(format!(
            "--active {wanted}: {} struts on this footprint come no nearer than {} at the busiest plane, whatever the height; \
             ask for about that, or try another --radius or --footprint",
            options.struts,
            nearest.map_or(0, |(active, ..)| active)
        )),
    }
}

/// How many of the `chosen` struts of a grid are active at the plane where most are.
fn busiest(whole: &Grid, radii: &Radii, chosen: u64) -> u64 {
    let mut part = *whole;
    if chosen > MOST_COUNTED {
        part.steps = [part.steps[0].min(PART_STEPS), part.steps[1].min(PART_STEPS), part.steps[2].min(PART_LAYERS)];
    }
    // As many of the whole's struts as lie at the part's height.
    let tall = Grid { steps: [whole.steps[0], whole.steps[1], part.steps[2]], ..*whole };
    let share = tall.strut_count() as f64 / part.strut_count() as f64;
    let chosen_share = chosen as f64 / whole.strut_count() as f64;
    let mut choice = part.choice((part.strut_count() as f64 * chosen_share).round() as u64);

    let reach = radii.support();
    let slab = (part.steps[2] as f64 * part.pitch[2] + 2.0 * reach) / SLABS as f64;
    // Nodes are rounded to quanta, perhaps past the end of the last slab.
    let number = |z: f64| ((z / slab) as usize).min(SLABS);
    // Active in a slab are those that begin in it or below, without those that end below it.
    let mut change = vec![0i64; SLABS + 2];
    for k in 0..part.layer_count() {
        part.layer(k, radii, &mut choice, &mut |strut| {
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
