//! A part that is sliced, filled, encoded, sent and marked: what is melted is what `slice` draws of the same layer.

use layerd::buildfile::Joint;
use layerd::device::sim::MeltSettings;
use layerd::layer::{Depth, Mirror, Raster, Vectors};
use layerd::link::message::Encoding;
use layerd::slice::scan::{Contours, Fill, HatchStrategy, Neighbours};
use layerd::stream::MemoryBudget;

use crate::device_common::powder::{LASER, Powder, sent_with};
use crate::scan_samples::settings;
use crate::slice_part::{HEIGHT, Part, WIDTH, lit, strut};

/// Memory that these layers fit.
const BUDGET_BYTES: u64 = 64 << 20;

#[test]
fn what_is_melted_is_the_picture_of_the_layer() {
    let raster = Raster {
        width_px: WIDTH,
        height_px: HEIGHT,
        pixel_um: [30.0; 2],
        build_height_um: 50_000.0,
        mirror: Mirror::default(),
    };
    // Nothing about it is symmetric.
    let struts = [
        strut([500, 400, 0], [2300, 700, 200], 250, 200),
        strut([500, 400, 0], [700, 1600, 200], 250, 150),
        strut([2300, 700, 200], [1500, 1100, 0], 200, 300),
    ];
    let part = Part::on(raster, &struts, Joint::Union, Depth::Bit, 50.0);
    let budget = MemoryBudget::new(BUDGET_BYTES);
    let mut contours = Contours::new(part.bodies(), part.plan.clone(), 5.0, 1, 0, &budget).expect("contours");
    let mut fill = Fill::new(settings(HatchStrategy::Zigzag), 1, &budget).expect("good settings");
    let (mut solid, mut missing, mut beside) = (0, 0, 0);
    for (layer, picture) in part.layers(1, 0).iter().enumerate() {
        let regions = contours.next_layer().expect("a layer").expect("as many as pictures");
        let mut vectors = Vectors::default();
        fill.layer(layer as u32, regions.regions(), Neighbours::default(), &mut vectors).expect("it lies in the field");
        let mut powder = Powder::drawing(MeltSettings { raster, beam_um: 60.0 });
        powder.mark_whole(&sent_with(&vectors, Encoding::VectorsCoded, LASER));
        let [(_, melted)] = &powder.pictures[..] else { panic!("one picture") };
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let [is_solid, is_melted] = [lit(picture, x, y), lit(melted, x, y)];
            solid += u32::from(is_solid);
            missing += u32::from(is_solid && !is_melted);
            beside += u32::from(!is_solid && is_melted);
        }
    }
    // Hatches leave slivers between their round ends and the contour.
    assert!(missing * 100 <= solid * 2 && beside * 100 <= solid, "{missing} and {beside} of {solid}");
    assert!(solid > 10_000, "{solid}");
}
