//! The picture of what was melted, against plain mathematics: the distance of each pixel's centre from each vector.

use layerd::device::sim::MeltSettings;
use layerd::layer::{Bitmap, HatchLine, Mark, MarkClass, Vectors, hatch_frame};

use crate::device_common::powder::{Powder, id, mark, melt_settings, sent};

/// A ring of many corners, hatches at an angle, horizontal and vertical vectors, a point, and vectors at the edges of the field.
fn vectors() -> Vectors {
    let mut vectors = Vectors::default();
    let corner = |number: i32| {
        let angle = f64::from(number % 37) / 37.0 * std::f64::consts::TAU;
        [3000 + (900.0 * angle.cos()).round() as i32, 4000 + (700.0 * angle.sin()).round() as i32]
    };
    vectors.push_path(MarkClass::Contour, &(0..=37).map(corner).collect::<Vec<_>>());
    let lines: Vec<_> = (-5..5).map(|line| HatchLine { line, from_um: -300 * (line % 3), to_um: 400 + line }).collect();
    vectors.push_hatches(MarkClass::Hatch, hatch_frame([9000, 5000], 67.0, 83_000), &lines);
    vectors.push_path(MarkClass::Thin, &[[12_000, 2000], [12_500, 2000], [12_500, 2600]]);
    vectors.push_path(MarkClass::Point, &[[15_017, 7011]]);
    vectors.push_path(MarkClass::Contour, &[[0, 0], [20_000, 10_000], [20_000, 0], [0, 0]]);
    vectors
}

fn is_lit(picture: &Bitmap, x: u32, y: u32) -> bool {
    picture.data()[y as usize * picture.stride_bytes() + x as usize / 8] & (0x80 >> (x % 8)) != 0
}

fn distance_um(mark: &Mark, point_um: [f64; 2]) -> f64 {
    let [from, to] = [mark.from_um, mark.to_um].map(|point| point.map(f64::from));
    let along = [to[0] - from[0], to[1] - from[1]];
    let away = [point_um[0] - from[0], point_um[1] - from[1]];
    let length2 = along[0] * along[0] + along[1] * along[1];
    let share =
        if length2 == 0.0 { 0.0 } else { ((away[0] * along[0] + away[1] * along[1]) / length2).clamp(0.0, 1.0) };
    (away[0] - share * along[0]).hypot(away[1] - share * along[1])
}

#[test]
fn a_pixel_is_melted_if_its_centre_was_under_the_beam() {
    let mut powder = Powder::ready();
    let layer = sent(&vectors());
    powder.load(0, id(4), &layer);
    powder.request(mark(id(4), 0, 10_000));
    powder.mark_to_its_end();
    let [(number, picture)] = &powder.pictures[..] else { panic!("one picture") };
    assert_eq!(*number, 4);
    let MeltSettings { raster, beam_um } = melt_settings();
    assert_eq!((picture.width_px(), picture.height_px()), (raster.width_px, raster.height_px));
    let mut lit = 0;
    for y in 0..raster.height_px {
        for x in 0..raster.width_px {
            let centre_um = [x, y].map(|place| (f64::from(place) + 0.5) * 30.0);
            let nearest = layer.marks.iter().map(|mark| distance_um(mark, centre_um)).fold(f64::INFINITY, f64::min);
            // Rounding may decide about centres that lie on the edge.
            if (nearest - beam_um / 2.0).abs() > 1e-6 {
                assert_eq!(is_lit(picture, x, y), nearest < beam_um / 2.0, "pixel ({x}, {y}), {nearest} µm away");
            }
            lit += u32::from(is_lit(picture, x, y));
        }
    }
    assert!(lit > 3000, "{lit}");
}
