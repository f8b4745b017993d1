//! Where a clipped lattice begins and ends.

use glam::{DMat3, DVec3};
use layerd::buildfile::{Cap, Caps, Joint, Keeps, Strut};
use layerd::layer::{Depth, Mirror};
use layerd::slice::BodySource;
use layerd::slice::{Footing, Slicer, Volume};
use layerd::stream::MemoryBudget;

use crate::shapes::{ball, cuboid};
use crate::slice_part::strut;
use crate::{Clipped, is_lit};

const CONVOLUTION: Joint = Joint::Convolution { support_um: 300.0 };

/// A post of 200 µm radius with flat ends, 4 mm high.
fn post() -> Strut {
    Strut { caps: Caps { a: Cap::Butt, b: Cap::Butt }, ..strut([0, 0, 0], [0, 0, 4000], 200, 200) }
}

fn slab(low: f64, high: f64) -> crate::shapes::Mesh {
    cuboid([-900.0, -900.0, low], [900.0, 900.0, high])
}

#[test]
fn flat_cuts_are_exact() {
    for joint in [Joint::Union, CONVOLUTION] {
        let inside = Clipped::new(&[post()], joint, Keeps::Inside, &slab(1234.5, 2345.25)).packed().expect("a slab");
        let header = inside.header();
        assert_eq!((header.bottom_um, header.bounds.min[2], header.bounds.max[2]), (1234.5, 1234, 2346), "{joint:?}");
    }
    let outside =
        Clipped::new(&[post()], Joint::Union, Keeps::Outside, &slab(-10.0, 1500.5)).packed().expect("the rest");
    assert_eq!((outside.header().bottom_um, outside.header().bounds.max[2]), (1500.5, 4000));
    // What is left is two pieces, and the clip does not touch the ends.
    let middle =
        Clipped::new(&[post()], Joint::Union, Keeps::Outside, &slab(1000.0, 1500.0)).packed().expect("the rest");
    assert_eq!((middle.header().bottom_um, middle.header().bounds.max[2]), (0.0, 4000));
}

#[test]
fn slanting_and_round_cuts_are_found_within_ten_micrometres() {
    // A plane at 45°: the lowest point is at the side of the post.
    let turned = cuboid([-3000.0, -3000.0, 0.0], [3000.0, 3000.0, 6000.0])
        .moved(DMat3::from_rotation_y(std::f64::consts::FRAC_PI_4), DVec3::new(0.0, 0.0, 2000.0));
    let packed = Clipped::new(&[post()], Joint::Union, Keeps::Inside, &turned).packed().expect("half");
    let off = packed.header().bottom_um - 1800.0;
    assert!((-0.02..10.0).contains(&off), "{off}");
    assert_eq!(packed.header().bounds.max[2], 4000);
    let centre = [100.0, 50.0, 2000.0];
    let packed = Clipped::new(&[post()], Joint::Union, Keeps::Inside, &ball(centre, 700.0, 4)).packed().expect("half");
    let off = packed.header().bottom_um - 1300.0;
    assert!((-0.02..10.0).contains(&off), "{off}");
    let off = 2700 - packed.header().bounds.max[2];
    assert!((-1..10).contains(&off), "{off}");
}

#[test]
fn layers_are_lit_from_the_first_to_the_last_and_nothing_lies_below() {
    let struts = [post(), strut([-1000, 0, 3000], [1000, 300, 2500], 100, 60)];
    for (joint, keeps) in [(Joint::Union, Keeps::Inside), (CONVOLUTION, Keeps::Inside), (Joint::Union, Keeps::Outside)]
    {
        let packed =
            Clipped::new(&struts, joint, keeps, &ball([150.0, 90.0, 2000.0], 800.0, 4)).packed().expect("some");
        let plan = packed.plan(Depth::Bit, Mirror::default(), 20.0);
        let layers = packed.layers(&plan, 1, 0);
        assert!(is_lit(&layers[0]) && layers.last().is_some_and(is_lit), "{joint:?}, {keeps:?}");
        let bodies = BodySource::of(&packed.file);
        let budget = MemoryBudget::new(Slicer::memory_bytes(&bodies, &plan, 1));
        let mut slicer = Slicer::new(bodies, plan, 1, 0, &budget).expect("a slicer");
        assert_eq!(Footing::of(&mut slicer, 4).expect("layers"), Footing::Firm, "{joint:?}, {keeps:?}");
    }
}

#[test]
fn a_clip_that_leaves_nothing_is_refused() {
    let far = ball([5000.0, 0.0, 2000.0], 300.0, 2);
    // Its box touches that of the strut, but not the strut.
    let beside = ball([205.0, 205.0, 2000.0], 80.0, 3);
    let around = cuboid([-300.0, -300.0, -300.0], [300.0, 300.0, 4300.0]);
    for (keeps, mesh) in [(Keeps::Inside, &far), (Keeps::Inside, &beside), (Keeps::Outside, &around)] {
        assert!(Clipped::new(&[post()], Joint::Union, keeps, mesh).packed().is_none());
    }
    // A skin of 4 µm is something.
    let most = cuboid([-300.0, -300.0, -300.0], [300.0, 300.0, 3996.0]);
    let packed = Clipped::new(&[post()], Joint::Union, Keeps::Outside, &most).packed().expect("a skin");
    assert!((packed.header().bottom_um - 3996.0).abs() < 0.02, "{}", packed.header().bottom_um);
}

#[test]
fn a_clip_over_a_great_height_takes_no_hours() {
    // 2 m of posts, of which all but the last millimetre is clipped.
    let high: Vec<_> = (0..20)
        .flat_map(|x| {
            (0..100).map(move |z| strut([x * 1000, 0, z * 20_000], [x * 1000, 0, (z + 1) * 20_000], 200, 200))
        })
        .collect();
    let most = cuboid([-900.0, -900.0, -900.0], [21_000.0, 900.0, 1_999_000.0]);
    let packed = Clipped::new(&high, Joint::Union, Keeps::Outside, &most).packed().expect("a millimetre");
    assert!((packed.header().bottom_um - 1_999_000.0).abs() < 0.02, "{}", packed.header().bottom_um);
}

#[test]
fn the_volume_is_that_of_what_is_left() {
    let packed = Clipped::new(&[post()], Joint::Union, Keeps::Inside, &slab(1000.0, 2000.0)).packed().expect("a slab");
    let volume = Volume::sample(&packed.file, 2).expect("sampled").solid_mm3;
    let expected = std::f64::consts::PI * 0.2 * 0.2;
    assert!((volume.value - expected).abs() < 0.01 * expected, "{volume:?}, {expected}");
}
