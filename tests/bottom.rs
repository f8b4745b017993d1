//! Where a part begins: the height that a build file says for its lowest solid point, against plain mathematics.

mod properties;
mod support;

use std::path::Path;

use layerd::buildfile::{Cap, Caps, Header, Joint, Shares, Strut};
use layerd::solid::reference::beam_field;
use layerd::solid::{self, Beam, ISOVALUE};
use proptest::prelude::*;
use support::part::write_part;

/// Writes struts in that directory; the header read back.
fn packed(directory: &Path, struts: &[Strut], joint: Joint) -> Header {
    write_part(&directory.join("part.layerd"), struts, joint)
}

fn strut(a: [i32; 3], b: [i32; 3], radius_a: u32, radius_b: u32, caps: Caps) -> Strut {
    let key = |[x, y, z]: [i32; 3]| [z, y, x];
    if key(a) <= key(b) {
        Strut { a, b, radius_a, radius_b, caps, shares: Shares::default() }
    } else {
        Strut {
            a: b,
            b: a,
            radius_a: radius_b,
            radius_b: radius_a,
            caps: Caps { a: caps.b, b: caps.a },
            shares: Shares::default(),
        }
    }
}

fn beam(strut: &Strut) -> Beam {
    Beam {
        a: strut.a.map(f64::from),
        b: strut.b.map(f64::from),
        radius_a: f64::from(strut.radius_a),
        radius_b: f64::from(strut.radius_b),
        caps: [solid::Cap::Sphere; 2],
    }
}

/// The lowest of very many points of a strut's surface: rims of its ends, and what its caps add.
fn lowest_point(strut: &Strut) -> f64 {
    const STEPS: u32 = 720;
    let [a, b] = [strut.a, strut.b].map(|node| glam::DVec3::from(node.map(f64::from)));
    if a == b {
        return a.z - f64::from(strut.radius_a);
    }
    let u = (b - a).normalize();
    let (right, up) = u.any_orthonormal_pair();
    let mut lowest = f64::INFINITY;
    for (node, outward, radius, cap) in [(a, -u, strut.radius_a, strut.caps.a), (b, u, strut.radius_b, strut.caps.b)] {
        let radius = f64::from(radius);
        for step in 0..STEPS {
            let (sin, cos) = (f64::from(step) / f64::from(STEPS) * std::f64::consts::TAU).sin_cos();
            let rim = right * cos + up * sin;
            lowest = lowest.min((node + rim * radius).z);
            // Meridians of the cap, from the rim outwards, and of a whole ball inwards, too.
            let quarters = match cap {
                Cap::Butt => 0.0..=0.0,
                Cap::Hemisphere => 0.0..=1.0,
                Cap::Sphere => -1.0..=1.0,
            };
            let (from, to) = (quarters.start(), quarters.end());
            for part in 0..=60 {
                let angle = (from + (to - from) * f64::from(part) / 60.0) * std::f64::consts::FRAC_PI_2;
                lowest = lowest.min((node + (rim * angle.cos() + outward * angle.sin()) * radius).z);
            }
        }
    }
    lowest
}

fn caps() -> impl Strategy<Value = Caps> {
    let cap = || prop_oneof![Just(Cap::Sphere), Just(Cap::Hemisphere), Just(Cap::Butt)];
    (cap(), cap()).prop_map(|(a, b)| Caps { a, b })
}

fn any_strut() -> impl Strategy<Value = Strut> {
    let node = || prop::array::uniform3(-2000i32..2000);
    let beam = (node(), node(), 1u32..800, 1u32..800, caps())
        .prop_filter("a ball is another case", |(a, b, ..)| a != b)
        .prop_map(|(a, b, radius_a, radius_b, caps)| strut(a, b, radius_a, radius_b, caps));
    let flat = (node(), -2000i32..2000, 1u32..800, caps())
        .prop_map(|(a, x, radius, caps)| strut(a, [x, a[1] + 1, a[2]], radius, radius, caps));
    let ball = (node(), 1u32..800).prop_map(|(at, radius)| strut(at, at, radius, radius, Caps::default()));
    prop_oneof![6 => beam, 2 => flat, 1 => ball]
}

proptest! {
    #![proptest_config(properties::cases(60))]

    #[test]
    fn of_a_union_it_is_exact(struts in prop::collection::vec(any_strut(), 1..4)) {
        let directory = tempfile::tempdir().expect("temporary directory");
        let header = packed(directory.path(), &struts, Joint::Union);
        let lowest = struts.iter().map(lowest_point).fold(f64::INFINITY, f64::min);
        // The points lie up to 2° and 0.1° apart.
        prop_assert!(header.bottom_um <= lowest + 1e-9, "{} is above {lowest}", header.bottom_um);
        prop_assert!(header.bottom_um >= lowest - 800.0 * 4e-4, "{} is far below {lowest}", header.bottom_um);
    }

}

proptest! {
    #![proptest_config(properties::cases(12))]

    /// No point of a fine grid is solid below it, and one is solid just above.
    #[test]
    fn of_a_convolution_it_is_where_the_field_reaches_the_isovalue(
        ends in prop::collection::vec((prop::array::uniform3(0i32..3000), 0usize..8, 60u32..250), 3..9),
        share in 0.3f64..0.9,
    ) {
        // Joined at common nodes, as lattices are.
        let nodes: Vec<_> = ends.iter().map(|(node, ..)| *node).collect();
        let struts: Vec<_> = ends
            .iter()
            .enumerate()
            .map(|(at, (node, other, radius))| (*node, nodes[(at + 1 + other) % nodes.len()], *radius))
            .filter(|(a, b, _)| a != b)
            .map(|(a, b, radius)| strut(a, b, radius, radius, Caps::default()))
            .collect();
        prop_assume!(!struts.is_empty());
        let largest = struts.iter().map(|strut| strut.radius_a).max().expect("struts");
        let support_um = f64::from(largest) / share;
        let directory = tempfile::tempdir().expect("temporary directory");
        let bottom_um = packed(directory.path(), &struts, Joint::Convolution { support_um }).bottom_um;
        let solid = |z: f64| {
            let near: Vec<_> = struts.iter().filter(|strut| f64::from(strut.a[2]) - support_um < z).map(beam).collect();
            let at = |step: i32| f64::from(step) * 12.0 - support_um;
            let steps = 0..((3000.0 + 2.0 * support_um) / 12.0) as i32;
            let field = |x: f64, y: f64| near.iter().map(|beam| beam_field(beam, support_um, [x, y, z])).sum::<f64>();
            steps.clone().any(|x| steps.clone().any(|y| field(at(x), at(y)) >= ISOVALUE))
        };
        prop_assert!(!solid(bottom_um - 2.5), "solid below {bottom_um}");
        prop_assert!(solid(bottom_um + 2.0), "nothing solid just above {bottom_um}");
    }
}

fn post(x: i32, y: i32) -> Strut {
    strut([x, y, 0], [x, y, 8000], 500, 500, Caps::default())
}

/// The height on a post's axis where the field of all struts reaches the isovalue.
fn root(struts: &[Strut], support_um: f64) -> f64 {
    let field = |z: f64| struts.iter().map(|strut| beam_field(&beam(strut), support_um, [0.0, 0.0, z])).sum::<f64>();
    let (mut dark, mut solid) = (-support_um, 4000.0);
    for _ in 0..60 {
        let middle = (dark + solid) / 2.0;
        if field(middle) >= ISOVALUE { solid = middle } else { dark = middle }
    }
    solid
}

#[test]
fn posts_stand_on_their_rounded_ends() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let table =
        [post(0, 0), post(4000, 0), post(0, 4000), strut([0, 0, 8000], [4000, 0, 8000], 500, 500, Caps::default())];
    for support_um in [550.0, 750.0, 2000.0] {
        let header = packed(directory.path(), &table, Joint::Convolution { support_um });
        let expected = root(&table, support_um);
        assert!(
            (-1.5..0.5).contains(&(expected - header.bottom_um)),
            "R = {support_um}: {} for {expected}",
            header.bottom_um
        );
        assert!(header.bottom_um > f64::from(header.bounds.min[2]) + 50.0, "above the bounds' lower end");
    }
}

/// Posts so far apart that no picture of the whole could show them.
#[test]
fn the_width_of_a_part_costs_nothing() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let far = |k: i32| {
        let at = [k * 35_000_000, k % 7 * 90_000_000, k * 1000];
        strut(at, [at[0], at[1], at[2] + 8000], 100, 100, Caps::default())
    };
    let joint = Joint::Convolution { support_um: 150.0 };
    let apart = packed(directory.path(), &(0..20).map(far).collect::<Vec<_>>(), joint);
    let alone = packed(directory.path(), &[far(0)], joint);
    assert!((apart.bottom_um - alone.bottom_um).abs() < 1.5, "{} or {}", apart.bottom_um, alone.bottom_um);
    // One long strut across all tiles, lying lower by a fifth of its radius than the ball at one of them.
    let lying = strut([-400_000, 37, 0], [400_000, 1_234_567, 0], 100, 100, Caps::default());
    let ball = strut([0, 0, 20], [0, 0, 20], 100, 100, Caps::default());
    let both = packed(directory.path(), &[lying, ball], joint);
    assert!((-101.0..-98.0).contains(&both.bottom_um), "{}", both.bottom_um);
}

/// Short struts print thinner than they are, or not at all: these, of several chunks, are no part of the solid.
#[test]
fn what_does_not_print_is_passed_over_however_high_it_reaches() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let speck = |k: i32| {
        let at = [k % 100 * 1600 - 20_000, k / 100 % 30 * 1600 + 3000, k / 3000 * 1600 - 9000];
        strut(at, [at[0], at[1], at[2] + 30], 500, 500, Caps::default())
    };
    let mut struts: Vec<_> = (0..9000).map(speck).collect();
    struts.push(post(0, 0));
    let joint = Joint::Convolution { support_um: 750.0 };
    let with_specks = packed(directory.path(), &struts, joint);
    let alone = packed(directory.path(), &[post(0, 0)], joint);
    assert_eq!(with_specks.bounds.min[2], -9500);
    assert!((with_specks.bottom_um - alone.bottom_um).abs() < 1.5, "{} or {}", with_specks.bottom_um, alone.bottom_um);
    // Where nothing prints, the bounds are as good as anything.
    struts.pop();
    let nothing = packed(directory.path(), &struts, joint);
    assert_eq!(nothing.bottom_um, -9500.0);
}
