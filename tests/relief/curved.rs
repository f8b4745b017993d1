//! Curved triangles.

use layerd::buildfile::BodyHeader;
use layerd::layer::Depth;

use crate::objects::{ball_of_80, cuboid};
use crate::{LAYER_UM, PIXEL_UM, PLAIN, Part, Recipe};

const RADIUS: f64 = 3.0;

#[test]
fn a_ball_of_curved_triangles_is_nine_times_nearer_to_the_sphere() {
    for object in [ball_of_80(RADIUS), ball_of_80(RADIUS).without_normals()] {
        let off = |is_curved: bool| {
            let part = Part::new(&object, &Recipe { is_curved, ..PLAIN });
            let plan = part.plan(Depth::Bit);
            part.farthest_mm(&plan, |at| RADIUS - at.length())
        };
        let (flat, curved) = (off(false), off(true));
        assert!(curved * 9.0 < flat, "{flat} mm flat, {curved} mm curved");
    }
}

#[test]
fn normals_that_make_no_curve_are_told() {
    let part = Part::new(&cuboid([1.0; 3]), &Recipe { is_curved: true, ..PLAIN });
    let note = part.report.notes.join("\n");
    assert!(note.contains("--curved changes nothing"), "{note}");
    assert!(matches!(&part.file.header().bodies[0], BodyHeader::Relief(relief) if !relief.is_curved));
    let plan = part.plan(Depth::Bit);
    let expected = 1.0;
    let found = part.volume_mm3(&plan);
    let margin = (PIXEL_UM[0] + PIXEL_UM[1] + LAYER_UM) / 1000.0;
    assert!((found - expected).abs() < margin, "{found} mm³");
}
