//! Nodes without a film: each is refused for its own reason, and none makes a panic, an endless loop or a number that is none.

use layerd::solid::soap::{FilmBuilder, FilmMesh, Level, NoFilm, Node, StrutEnd};
use proptest::prelude::*;

use crate::node_shapes::{Random, ends, node, regular};
use crate::{level, properties, special};

fn reason(directions: &[[f64; 3]]) -> Option<NoFilm> {
    FilmBuilder::new().outline(&node(&ends(directions))).err()
}

#[test]
fn nodes_without_a_film_are_told_with_their_reason() {
    assert_eq!(reason(&[]), Some(NoFilm::NoStrut));
    assert_eq!(reason(&[[1.0, 0.0, 0.0], [-1.0, 0.01, 0.0]]), Some(NoFilm::Straight));
    assert_eq!(reason(&[[1.0, 0.0, 0.0], [-1.0, 0.02, 0.0]]), None);
    let close = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.17, 0.0]];
    assert_eq!(reason(&close), Some(NoFilm::Close { struts: [1, 2] }));
    assert_eq!(reason(&[[1.0, 0.0, 0.0], [1.0, 0.18, 0.0]]), None);
    assert_eq!(reason(&[[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), Some(NoFilm::Close { struts: [0, 1] }));
    let mut random = Random(1);
    let thousand: Vec<_> = (0..1000).map(|_| random.direction()).collect();
    assert_eq!(reason(&thousand), Some(NoFilm::TooMany { count: 1000 }));
    let told = reason(&close).expect("a reason").to_string();
    assert_eq!(told, "struts 1 and 2 of the node are closer than 10°");
}

/// Valid are cuts within half of a strut: `tan(θ/2) > 2 (1 + λ) r / L`.
#[test]
fn a_cut_beyond_the_middle_of_a_strut_is_refused() {
    let mut ends = ends(&regular(6));
    ends[3].length = 2.6;
    let reason = FilmBuilder::new().outline(&node(&ends)).err();
    let Some(NoFilm::Short { of: 3, cut, length: 2.6 }) = reason else { panic!("{reason:?}") };
    assert!((cut - 1.3).abs() < 1e-15);
    ends[3].length = 2.6 + 1e-12;
    assert_eq!(FilmBuilder::new().outline(&node(&ends)).err(), None);
}

#[test]
fn numbers_out_of_range_are_told() {
    let good = ends(&regular(6));
    let told = |node: Node<'_>| FilmBuilder::new().outline(&node).expect_err("no film").to_string();
    assert_eq!(told(Node { radius: -1.0, ..node(&good) }), "the node's radius is -1, which is out of range");
    assert_eq!(told(Node { lambda: f64::NAN, ..node(&good) }), "the node's lambda is NaN, which is out of range");
    assert_eq!(told(Node { lambda: 0.5, ..node(&good) }), "the node's lambda is 0.5, which is out of range");
    let with = |end: StrutEnd| vec![end, good[1], good[2]];
    let none = with(StrutEnd { direction: [0.0; 3], length: 9.0 });
    assert_eq!(told(node(&none)), "the node's direction's length is 0, which is out of range");
    let endless = with(StrutEnd { direction: [1.0; 3], length: f64::INFINITY });
    assert_eq!(told(node(&endless)), "the node's strut length is inf, which is out of range");
}

/// A refusal leaves the mesh as it was.
#[test]
fn a_refused_node_changes_no_mesh() {
    let (mut builder, mut mesh) = (FilmBuilder::new(), FilmMesh::default());
    builder.mesh(&node(&ends(&regular(6))), level(1), &mut mesh).expect("a film");
    let before = mesh.clone();
    builder.mesh(&node(&[]), level(1), &mut mesh).expect_err("no strut");
    assert_eq!(mesh, before);
}

fn check_numbers(mesh: &FilmMesh) -> Result<(), TestCaseError> {
    for (vertex, normal) in mesh.vertices().iter().zip(mesh.normals()) {
        prop_assert!(vertex.iter().all(|part| part.is_finite()));
        let length = crate::node_shapes::dot(*normal, *normal);
        prop_assert!((length - 1.0).abs() < 1e-12, "a normal of {length}");
    }
    Ok(())
}

/// Directions on a coarse grid: many are opposite, in one plane or on one circle, exactly or by a hair.
fn any_directions() -> impl Strategy<Value = Vec<[f64; 3]>> {
    let part = || (-3_i32..=3).prop_map(f64::from);
    let hair = || prop_oneof![Just(0.0), Just(1e-15), Just(1e-9), Just(1e-6), Just(1e-3), -0.1..0.1];
    let direction = ([part(), part(), part()], [hair(), hair(), hair()]);
    let direction = direction.prop_map(|(parts, hairs)| [0, 1, 2].map(|axis| parts[axis] + hairs[axis]));
    prop::collection::vec(direction, 0..30)
}

proptest! {
    #![proptest_config(properties::cases(2000))]

    #[test]
    fn any_directions_give_a_film_or_a_reason(directions in any_directions(), lambda in 0.01..0.49) {
        // Pairs that are too close would refuse most sets, so they are left out; a sixth of them stays.
        let mut apart: Vec<[f64; 3]> = Vec::new();
        for (at, direction) in directions.iter().enumerate() {
            let cosine = |other: &[f64; 3]| {
                let dot = crate::node_shapes::dot;
                dot(*other, *direction) / (dot(*other, *other) * dot(*direction, *direction)).sqrt()
            };
            if at % 6 == 5 || apart.iter().all(|other| cosine(other) < 0.98) {
                apart.push(*direction);
            }
        }
        let ends = ends(&apart);
        let (mut builder, mut mesh) = (FilmBuilder::new(), FilmMesh::default());
        match builder.mesh(&Node { lambda, ..node(&ends) }, Level::COARSEST, &mut mesh) {
            Ok(()) => check_numbers(&mesh)?,
            Err(reason) => prop_assert!(reason != NoFilm::Degenerate, "{apart:?}"),
        }
    }
}

#[test]
fn special_nodes_have_numbers_at_all_levels() {
    for (name, directions) in special() {
        for steps in 0..=4 {
            check_numbers(&crate::mesh(&directions, steps)).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
    }
}
