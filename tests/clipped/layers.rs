//! Pixels of clipped lattices.

use glam::DVec3;
use layerd::buildfile::{Joint, Keeps};
use layerd::layer::{Depth, Mirror};
use layerd::slice::BodySource;
use proptest::prelude::*;

use crate::shapes::{Mesh, ball, cuboid, turn};
use crate::slice_part::any_strut;
use crate::{Clipped, MIDDLE, properties, sliced};

/// A closed mesh of pieces that may overlap, and of cavities.
fn any_mesh() -> impl Strategy<Value = Mesh> {
    let piece = (
        prop::array::uniform3(-3.0..3.0),
        prop::array::uniform3(-1.0..1.0),
        prop::array::uniform3(60.0..700.0),
        any::<bool>(),
        0..5_u8,
    );
    prop::collection::vec(piece, 1..4).prop_map(|pieces| {
        let mesh = |(angles, off, half, is_ball, reversed): ([f64; 3], [f64; 3], [f64; 3], bool, u8)| {
            let mesh = if is_ball { ball([0.0; 3], half[0], 2) } else { cuboid(half.map(|um| -um), half) };
            let mesh = mesh.moved(turn(angles), MIDDLE + DVec3::from(off) * DVec3::new(600.0, 400.0, 100.0));
            if reversed == 0 { mesh.reversed() } else { mesh }
        };
        pieces.into_iter().map(mesh).fold(Mesh::default(), |all, one| all.and(&one))
    })
}

fn any_keeps() -> impl Strategy<Value = Keeps> {
    prop_oneof![Just(Keeps::Inside), Just(Keeps::Outside)]
}

pub(crate) fn any_joint() -> impl Strategy<Value = Joint> {
    prop_oneof![2 => Just(Joint::Union), 1 => Just(Joint::Convolution { support_um: 180.0 })]
}

proptest! {
    #![proptest_config(properties::cases(40))]

    #[test]
    fn each_pixel_is_lit_where_the_lattice_is_and_the_clip_leaves_it(
        struts in prop::collection::vec(any_strut(), 1..12), mesh in any_mesh(), keeps in any_keeps(), joint in any_joint(),
        grey in any::<bool>(), x in any::<bool>(), y in any::<bool>(), start in 0..8_u32,
    ) {
        let clipped = Clipped::new(&struts, joint, keeps, &mesh);
        let Some(packed) = clipped.packed() else { return Ok(()) };
        let plan = packed.plan(if grey { Depth::Grey } else { Depth::Bit }, Mirror { x, y }, 30.0);
        let layers = packed.layers(&plan, 1, 0);
        let alone = |body: usize| {
            let bodies = || clipped.alone().into_iter().nth(body).unwrap_or_default();
            sliced(bodies, &plan, 1, 0)
        };
        for (layer, ((found, lattice), clip)) in layers.iter().zip(alone(0)).zip(alone(1)).enumerate() {
            for (at, ((found, lattice), clip)) in found.data().iter().zip(lattice.data()).zip(clip.data()).enumerate() {
                let left = if keeps == Keeps::Inside { *clip } else { 255 - clip };
                let expected = if grey { *lattice.min(&left) } else { lattice & left };
                prop_assert_eq!(*found, expected, "layer {}, byte {}", layer, at);
            }
        }
        prop_assert!(layers == packed.layers(&plan, 3, 0), "threads");
        let start = start.min(plan.layer_count - 1);
        prop_assert!(layers[start as usize..] == packed.layers(&plan, 2, start)[..], "start");
    }
}

#[test]
fn other_bodies_are_printed_whole_beside_a_clipped_lattice() {
    let struts = [crate::slice_part::strut([0, 0, 0], [1600, 0, 0], 100, 100)];
    let mesh = cuboid([500.0, -500.0, -500.0], [900.0, 500.0, 500.0]);
    let clipped = Clipped::new(&struts, Joint::Union, Keeps::Inside, &mesh);
    let packed = clipped.packed().expect("something is left");
    let plan = packed.plan(Depth::Grey, Mirror::default(), 20.0);
    let solid =
        || Clipped::new(&struts, Joint::Union, Keeps::Inside, &cuboid([350.0, -60.0, -90.0], [700.0, 90.0, 90.0]));
    let of_solid = || solid().alone().into_iter().nth(1).unwrap_or_default();
    let both = || BodySource::of(&packed.file).into_iter().chain(of_solid()).collect();
    let layers = [sliced(|| BodySource::of(&packed.file), &plan, 1, 0), sliced(of_solid, &plan, 1, 0)];
    for (layer, both) in sliced(both, &plan, 2, 0).iter().enumerate() {
        let alone = layers[0][layer].data().iter().zip(layers[1][layer].data());
        assert!(both.data().iter().zip(alone).all(|(both, (one, other))| both == one.max(other)), "layer {layer}");
    }
}
