//! Control points: the blend begins where they are.

use layerd::buildfile::{BlendBegin, Joint, JointChoice};
use layerd::solid::Beam;
use layerd::solid::reference::beam_field;

use crate::pack_bench::{Bench, said};

/// Two long struts that cross at a right angle, micrometres, and their support.
const SUPPORT_UM: f64 = 750.0;

fn beam(axis: usize) -> Beam {
    let (mut a, mut b) = ([0.0; 3], [0.0; 3]);
    (a[axis], b[axis]) = (-10_000.0, 10_000.0);
    Beam { a, b, radius_a: 500.0, radius_b: 500.0, caps: Default::default() }
}

const TEXT: &str = "2 0.5 0 0\n-10 0 0 10 0 0 0.5 a\n0 -10 0 0 10 0 0.5 b\n";

fn choice(points: [[f64; 3]; 2]) -> Option<JointChoice> {
    Some(JointChoice::Elliptic { support_mm: None, begins: BlendBegin::Points(points) })
}

#[test]
fn the_fields_at_the_points_say_where_the_blend_begins() {
    let mut bench = Bench::new();
    // On the surfaces of the struts along x and along y, at different distances from the node.
    let points = [[0.62, 0.5, 0.0], [0.5, 0.55, 0.0]];
    bench.options.joint = choice(points);
    let (report, _) = bench.text(TEXT).expect("is packed");
    let Joint::Elliptic { support_um, least } = report.header.lattices().next().expect("it has one").joint else {
        panic!("it is elliptic")
    };
    assert_eq!(support_um, SUPPORT_UM);
    let field = |axis: usize, point: [f64; 3]| beam_field(&beam(axis), SUPPORT_UM, point.map(|mm| mm * 1000.0));
    let expected = [field(0, points[1]) / field(1, points[1]), field(1, points[0]) / field(0, points[0])];
    assert!((0..2).all(|at| (least[at] - expected[at]).abs() < 1e-12), "{least:?} is {expected:?}");
    // Turned and scaled, the same points of the source mean the same.
    bench.options.rotate_deg = [0.0, 0.0, 90.0];
    bench.options.scale = [2.0; 3];
    let (report, _) = bench.text(TEXT).expect("is packed");
    let turned = report.header.lattices().next().expect("it has one").joint;
    assert!(
        matches!(turned, Joint::Elliptic { least: found, .. } if (0..2).all(|at| (found[at] - least[at]).abs() < 1e-9))
    );
}

#[test]
fn points_that_say_nothing_are_refused() {
    let mut bench = Bench::new();
    for (points, told) in [
        (
            [[5.0, 0.5, 0.0], [0.5, 0.55, 0.0]],
            "at the first control point the fields of the two materials are 1.0000 and 0.0000",
        ),
        ([[0.62, 0.5, 0.0], [0.6, 0.5, 0.0]], "at the second control point"),
        ([[0.62, 0.5, 0.0], [f64::NAN, 0.5, 0.0]], "--control-points: NaN"),
    ] {
        bench.options.joint = choice(points);
        let found = said(bench.text(TEXT));
        assert!(found.contains(told), "{found}");
        assert!(!bench.path("out.layerd").exists());
    }
    bench.options.joint = choice([[0.62, 0.5, 0.0], [0.5, 0.55, 0.0]]);
    let found = said(bench.text("1 0.5 0 0\n-10 0 0 10 0 0 0.5 a\n"));
    assert!(found.contains("for two materials, and the part has 1"), "{found}");
}
