//! The same node gives the same mesh: whatever the order of its struts, the buffers, and the unit of length. Turned nodes give turned
//! meshes.

use glam::{DMat3, DVec3};
use layerd::solid::soap::{FilmBuilder, FilmMesh, Node};
use proptest::prelude::*;

use crate::node_shapes::measure::points;
use crate::node_shapes::{Random, ends, node, regular};
use crate::{level, mesh, properties, random, special};

/// Any node with a film: a seed and a number of struts.
fn any_directions() -> impl Strategy<Value = Vec<[f64; 3]>> {
    (any::<u64>(), 1_usize..24).prop_map(|(seed, count)| Random(seed).directions(count, 12.0))
}

proptest! {
    #![proptest_config(properties::cases(40))]

    #[test]
    fn the_order_of_struts_changes_no_bit(directions in any_directions(), shift in 0_usize..24, back in any::<bool>()) {
        let mut moved = directions.clone();
        moved.rotate_left(shift % directions.len());
        if back {
            moved.reverse();
        }
        let [given, other] = [&directions, &moved].map(|directions| mesh(directions, 1));
        prop_assert_eq!(given.vertices(), other.vertices());
        prop_assert_eq!(given.normals(), other.normals());
        prop_assert_eq!(given.triangles(), other.triangles());
        for (strut, direction) in directions.iter().enumerate() {
            let place = moved.iter().position(|other| other == direction).expect("it was moved");
            prop_assert_eq!(given.rim(strut), other.rim(place));
        }
    }

    /// Scaled by a power of two, every number of the mesh is.
    #[test]
    fn the_unit_of_length_changes_no_shape(directions in any_directions(), power in -20_i32..20) {
        let scale = 2_f64.powi(power);
        let mut scaled = ends(&directions);
        scaled.iter_mut().for_each(|end| end.length *= scale);
        let node = Node { ends: &scaled, radius: scale, lambda: Node::USUAL_LAMBDA };
        let mut large = FilmMesh::default();
        FilmBuilder::new().mesh(&node, level(1), &mut large).expect("a film");
        let small = mesh(&directions, 1);
        let expected: Vec<_> = small.vertices().iter().map(|vertex| vertex.map(|part| part * scale)).collect();
        prop_assert_eq!(large.vertices(), &expected[..]);
        prop_assert_eq!(large.normals(), small.normals());
    }
}

#[test]
fn buffers_that_serve_again_change_no_bit() {
    let (mut builder, mut again) = (FilmBuilder::new(), FilmMesh::default());
    for directions in random(60, 12.0).chain(special().into_iter().map(|(_, directions)| directions)) {
        for steps in [2, 0, 1] {
            builder.mesh(&node(&ends(&directions)), level(steps), &mut again).expect("a film");
            assert_eq!(again, mesh(&directions, steps));
        }
    }
}

/// Turned, a node is divided alike, and its vertices are turned: rounding decides only how they are numbered. This is not so where
/// several gaps are equally wide, as in an elbow: which of them is filled first depends on the coordinates.
#[test]
fn turned_nodes_have_turned_meshes() {
    let turn = DMat3::from_rotation_z(0.7) * DMat3::from_rotation_x(0.4);
    for directions in random(40, 25.0).filter(|directions| directions.len() > 7).chain([regular(6), regular(20)]) {
        let turned: Vec<_> = directions.iter().map(|direction| (turn * DVec3::from(*direction)).to_array()).collect();
        let [given, turned] = [&directions, &turned].map(|directions| points(&mesh(directions, 0)));
        assert_eq!(given.len(), turned.len());
        for point in given {
            let place = turn * point;
            let nearest = turned.iter().map(|other| other.distance(place)).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-5, "{nearest} from any vertex of the turned mesh");
        }
    }
}
