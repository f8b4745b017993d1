//! Refined meshes converge, and each level is within its bound of the limit.

use glam::DVec3;
use layerd::solid::soap::Level;

use crate::distance::{curved_point, greatest_distance};
use crate::node_shapes::measure::points;
use crate::node_shapes::regular;
use crate::{level, mesh, outline, random, special};

/// Regular nodes, special ones, and random ones with angles of 36° and more, and down to 10°.
fn any_nodes() -> impl Iterator<Item = (String, Vec<[f64; 3]>)> {
    let special = special().into_iter().map(|(name, directions)| (name.to_owned(), directions));
    let seeded = |name: &'static str, (seed, directions)| (format!("{name} {seed}"), directions);
    let wide = random(8, 36.0).enumerate().map(move |of| seeded("wide", of));
    let narrow = random(8, 10.01).enumerate().map(move |of| seeded("narrow", of));
    special.chain([("12".to_owned(), regular(12))]).chain(wide).chain(narrow)
}

/// Level 3 stands for the limit: what it lacks is added as the bound says.
#[test]
fn each_level_is_within_its_bound_of_the_limit() {
    for (name, directions) in any_nodes() {
        let fine = mesh(&directions, 3);
        let outline = outline(&directions);
        for steps in 0..=2 {
            let bound = outline.error(level(steps)) - outline.error(fine.level());
            let found = greatest_distance(&mesh(&directions, steps), points(&fine).into_iter(), bound);
            assert!(found <= bound, "{name}: level {steps} is {found} from the limit, not {bound}");
        }
    }
}

/// A prototype of regular nodes has 0.06 and 0.017.
#[test]
fn regular_nodes_are_nearer_to_the_limit() {
    for (count, bounds) in [(6, [0.023, 0.0061, 0.0016]), (12, [0.015, 0.0044, 0.0012]), (20, [0.04, 0.0125, 0.0041])] {
        let fine = mesh(&regular(count), 4);
        for (steps, bound) in (0..).zip(bounds) {
            let found = greatest_distance(&mesh(&regular(count), steps), points(&fine).into_iter(), bound);
            assert!(found <= bound, "{count} struts: level {steps} is {found} from the limit");
        }
    }
}

#[test]
fn the_control_mesh_as_curved_triangles_is_within_its_bound_of_the_limit() {
    const PARTS: u32 = 6;
    for (name, directions) in any_nodes() {
        let (coarse, fine) = (mesh(&directions, 0), mesh(&directions, 3));
        let coarse_points = points(&coarse);
        let curved = coarse.triangles().iter().flat_map(|names| {
            let corners = names.map(|name| coarse_points[name as usize]);
            let normals = names.map(|name| DVec3::from(coarse.normals()[name as usize]));
            let weights = (0..=PARTS).flat_map(|a| (0..=PARTS - a).map(move |b| [a, b, PARTS - a - b]));
            weights.map(move |weights| {
                curved_point(corners, normals, weights.map(|weight| f64::from(weight) / f64::from(PARTS)))
            })
        });
        let bound = outline(&directions).curved_error();
        let found = greatest_distance(&fine, curved, bound);
        assert!(found <= bound, "{name}: level 0 as PN triangles is {found} from the limit, not {bound}");
    }
}

/// How far the vertices of a level move with the next one: mean and greatest.
fn movement(directions: &[[f64; 3]], steps: u8) -> [f64; 2] {
    let [before, after] = [steps, steps + 1].map(|steps| points(&mesh(directions, steps)));
    let moves: Vec<_> = before.iter().zip(&after).map(|(before, after)| before.distance(*after)).collect();
    [moves.iter().sum::<f64>() / moves.len() as f64, moves.into_iter().fold(0.0, f64::max)]
}

/// On average. Those where three struts meet or more come nearer more slowly.
#[test]
fn vertices_move_a_quarter_as_far_each_level() {
    for (name, directions) in special().into_iter().filter(|(name, _)| ["6", "12", "20", "octet"].contains(name)) {
        let moves = [0, 1, 2, 3].map(|steps| movement(&directions, steps));
        for pair in moves.windows(2) {
            assert!(pair[1][0] < 0.3 * pair[0][0] && pair[1][1] < 0.6 * pair[0][1], "{name}: {moves:?}");
        }
    }
}

#[test]
fn a_tolerance_chooses_the_coarsest_level_that_is_near_enough() {
    let directions = regular(12);
    let outline = outline(&directions);
    for steps in 0..=3 {
        assert_eq!(outline.level(outline.error(level(steps))), level(steps));
    }
    assert_eq!(outline.level(f64::INFINITY), Level::COARSEST);
    assert_eq!(outline.level(0.0), Level::FINEST_NEEDED);
    assert_eq!((Level::new(5), Level::new(6)), (Some(Level::FINEST), None));
}
