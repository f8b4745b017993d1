//! Random small lattices: topology, orientation, no crossings, the tolerance, and all that must not change a region.

use layerd::buildfile::{Cap, Joint, Strut};
use layerd::layer::{Depth, Mirror, Raster};
use layerd::solid::InstructionSet;
use layerd::solid::reference::beam_field;
use proptest::prelude::*;

use crate::rings::{crossing, distance_to_ring, signed_area};
use crate::slice_part::{Part, any_strut, beam, raster};
use crate::topology::{Pieces, problem};
use crate::{Way, layers, properties};

const SUPPORT_UM: f64 = 150.0;

/// Pitches at which no pixel's centre lies exactly on a surface whose coordinates are whole micrometres.
const PIXEL_UM: [f64; 2] = [19.973, 24.031];

fn part(struts: &[Strut], union: bool, mirror: Mirror) -> Part {
    let joint = if union { Joint::Union } else { Joint::Convolution { support_um: SUPPORT_UM } };
    Part::on(Raster { pixel_um: PIXEL_UM, ..raster(mirror) }, struts, joint, Depth::Bit, 61.7)
}

/// By how far a point lies within a strut, micrometres, as `solid/excess.rs` defines it.
fn union_excess(strut: &Strut, p: [f64; 3]) -> f64 {
    let one = beam(strut);
    let (a, b, p) = (glam::DVec3::from(one.a), glam::DVec3::from(one.b), glam::DVec3::from(p));
    let balls = [one.radius_a - p.distance(a), one.radius_b - p.distance(b)];
    if a == b {
        return balls[0];
    }
    let (u, length) = ((b - a).normalize(), a.distance(b));
    let t = (p - a).dot(u);
    let away = (p - a).cross(u).length();
    let flat = |radius: f64, past: f64| if away <= radius { -past } else { -(away - radius).hypot(past) };
    let mut excess = match (t < 0.0, t > length) {
        (true, _) if strut.caps.a == Cap::Butt => flat(one.radius_a, -t),
        (true, _) => balls[0],
        (_, true) if strut.caps.b == Cap::Butt => flat(one.radius_b, t - length),
        (_, true) => balls[1],
        _ => {
            let limit = |cap, rest| if cap == Cap::Butt { rest } else { f64::INFINITY };
            let within = one.radius_a + (one.radius_b - one.radius_a) * t / length - away;
            within.min(limit(strut.caps.a, t)).min(limit(strut.caps.b, length - t))
        }
    };
    for (cap, ball) in [(strut.caps.a, balls[0]), (strut.caps.b, balls[1])] {
        if cap == Cap::Sphere {
            excess = excess.max(ball);
        }
    }
    excess
}

/// The field at a pixel: 0 or more where it is solid.
fn field(part: &Part, union: bool, [x, y]: [u32; 2], layer: usize) -> f64 {
    let p = part.point(x, y, layer);
    if !union {
        let field = |strut: &Strut| beam_field(&beam(strut), SUPPORT_UM, p);
        return part.struts.iter().map(field).sum::<f64>() - 1.0;
    }
    let reaches = |strut: &&Strut| {
        let radius = f64::from(strut.radius_a.max(strut.radius_b));
        p[2] >= f64::from(strut.a[2]) - radius && p[2] <= f64::from(strut.b[2]) + radius
    };
    let least = -1.5 * PIXEL_UM[0].max(PIXEL_UM[1]);
    part.struts.iter().filter(reaches).map(|strut| union_excess(strut, p)).fold(least, f64::max)
}

proptest! {
    #![proptest_config(properties::cases(24))]

    #[test]
    fn regions_are_those_of_the_picture(
        struts in prop::collection::vec(any_strut(), 1..25), union in any::<bool>(), x in any::<bool>(), y in any::<bool>(),
    ) {
        let part = part(&struts, union, Mirror { x, y });
        let exact = layers(|| part.bodies(), &part.plan, Way::with_tolerance(0.0));
        let simple = layers(|| part.bodies(), &part.plan, Way::with_tolerance(5.0));
        for (layer, bitmap) in part.layers(1, 0).iter().enumerate() {
            let mut undecided = false;
            let pieces = Pieces::of(bitmap, |x, y| {
                let corners = [[x - 1, y - 1], [x, y - 1], [x - 1, y], [x, y]];
                let centre = corners.map(|pixel| field(&part, union, pixel, layer)).iter().sum::<f64>();
                undecided |= centre.abs() < 1e-3;
                centre >= 0.0
            });
            if undecided {
                continue;
            }
            prop_assert_eq!(problem(&exact[layer], bitmap, &part.plan, pieces.clone()), None);
            prop_assert_eq!(problem(&simple[layer], bitmap, &part.plan, pieces), None);
        }
        for (exact, simple) in exact.iter().zip(&simple) {
            check(exact, simple, 5.0)?;
        }
    }

    #[test]
    fn a_tolerance_of_many_pixels_changes_no_topology(
        struts in prop::collection::vec(any_strut(), 1..25), union in any::<bool>(), tolerance_um in 0.01..200.0_f64,
    ) {
        let part = part(&struts, union, Mirror::default());
        let exact = layers(|| part.bodies(), &part.plan, Way::with_tolerance(0.0));
        let simple = layers(|| part.bodies(), &part.plan, Way::with_tolerance(tolerance_um));
        for (exact, simple) in exact.iter().zip(&simple) {
            check(exact, simple, tolerance_um)?;
        }
    }

    #[test]
    fn neither_threads_nor_the_start_nor_the_instruction_set_change_a_region(
        struts in prop::collection::vec(any_strut(), 1..40), union in any::<bool>(), start in 1..4_u32,
    ) {
        let part = part(&struts, union, Mirror::default());
        let way = Way::with_tolerance(5.0);
        let regions = |way| layers(|| part.bodies(), &part.plan, way);
        let whole = regions(way);
        prop_assert_eq!(&regions(Way { threads: 3, ..way }), &whole);
        for instructions in InstructionSet::available() {
            prop_assert_eq!(&regions(Way { instructions, ..way }), &whole);
        }
        let first = start.min(whole.len() as u32 - 1);
        prop_assert_eq!(&regions(Way { threads: 2, first, ..way })[..], &whole[first as usize..]);
    }
}

/// Rings are closed, oriented and apart, and simplified ones are the exact ones within the tolerance.
fn check(
    exact: &[layerd::slice::scan::Region],
    simple: &[layerd::slice::scan::Region],
    tolerance_um: f64,
) -> Result<(), TestCaseError> {
    for regions in [exact, simple] {
        prop_assert_eq!(crossing(regions), None);
        for region in regions {
            prop_assert!(signed_area(&region.outer) > 0.0 && region.outer.len() >= 3);
            for hole in &region.holes {
                prop_assert!(signed_area(hole) < 0.0 && hole.len() >= 3);
            }
        }
    }
    prop_assert_eq!(exact.len(), simple.len());
    for (exact, simple) in exact.iter().zip(simple) {
        prop_assert_eq!(exact.holes.len(), simple.holes.len());
        for (exact, simple) in exact.rings().zip(simple.rings()) {
            prop_assert!(simple.len() <= exact.len());
            let points = simple.iter().map(|point| distance_to_ring(*point, exact));
            let left_out = exact.iter().map(|point| distance_to_ring(*point, simple));
            let farthest = points.chain(left_out).fold(0.0, f64::max);
            prop_assert!(farthest <= tolerance_um + 0.01, "{farthest} µm");
        }
    }
    Ok(())
}
