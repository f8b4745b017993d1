//! What tracks cover and what they spill.

use layerd::layer::{MarkClass, Run};
use layerd::slice::scan::HatchStrategy;
use proptest::prelude::*;

use crate::measure::{Melted, assert_hatches_inside, depth_um, melted};
use crate::properties::cases;
use crate::scan_samples::{disc, islands, rectangle, settings, star, with_hole};
use crate::{STRATEGIES, filled, plate};

#[test]
fn wide_regions_are_covered_and_little_is_spilled() {
    let regions = [
        plate(),
        disc([7000.0, 2500.0], 900.0),
        with_hole(disc([9500.0, 2500.0], 1000.0), disc([9500.0, 2500.0], 400.0)),
    ];
    for strategy in STRATEGIES {
        for layer in 0..3 {
            let (vectors, counts) = filled(&settings(strategy), layer, &regions);
            let Melted { covered, spilled } = melted(&vectors, &regions, 60.0);
            assert!(covered >= 0.99, "{strategy:?}, layer {layer}: {covered} covered");
            assert!(spilled <= 0.005, "{strategy:?}, layer {layer}: {spilled} spilled");
            assert_eq!((counts.regions, counts.unmarked, counts.centre_lines, counts.points), (3, 0, 0, 0));
            assert_hatches_inside(&vectors, &regions, 45.0);
        }
    }
}

#[test]
fn islands_of_a_lattice_are_all_marked_and_covered() {
    let regions = islands(150, 40.0, 400.0, 7);
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 3, &regions);
    let Melted { covered, spilled } = melted(&vectors, &regions, 60.0);
    assert_eq!((counts.regions, counts.unmarked), (150, 0));
    assert!(counts.contours_only > 0 && counts.centre_lines > 0);
    assert!(covered >= 0.98, "{covered} covered");
    assert!(spilled <= 0.01, "{spilled} spilled");
    for region in &regions {
        let marked =
            vectors.marks().any(|mark| depth_um(std::slice::from_ref(region), mark.from_um.map(f64::from)) > 0.0);
        assert!(marked, "nothing in {region:?}");
    }
}

#[test]
fn compensation_taken_back_gives_the_area_of_the_region() {
    for region in [disc([2000.0, 2000.0], 300.0), rectangle([1000.0, 1000.0], [1900.0, 1450.0])] {
        let (vectors, _) = filled(&settings(HatchStrategy::Zigzag), 0, std::slice::from_ref(&region));
        let (_, run) = vectors.runs().find(|(class, _)| *class == MarkClass::Contour).expect("a contour");
        let Run::Path(points) = run else { panic!("{run:?}") };
        assert_eq!(points.first(), points.last());
        let (mut area_um2, mut length_um) = (0.0, 0.0);
        for pair in points.windows(2) {
            let [[x1, y1], [x2, y2]] = [pair[0], pair[1]].map(|point| point.map(f64::from));
            area_um2 += (x1 * y2 - x2 * y1) / 2.0;
            length_um += (x2 - x1).hypot(y2 - y1);
        }
        // A convex polygon grows by its length times the distance, and by a disc.
        let grown_um2 = area_um2 + length_um * 30.0 + std::f64::consts::PI * 30.0 * 30.0;
        let error = grown_um2 / region.area_um2() - 1.0;
        assert!(error.abs() < 0.01, "{error}");
    }
}

proptest! {
    #![proptest_config(cases(16))]

    #[test]
    fn stars_are_marked_inside(
        radii_um in prop::collection::vec(40.0..1500.0_f64, 5..24),
        layer in 0_u32..100,
        strategy in prop::sample::select(&STRATEGIES[..]),
    ) {
        let regions = [star([5000.0, 5000.0], &radii_um)];
        let (vectors, counts) = filled(&settings(strategy), layer, &regions);
        prop_assert_eq!((counts.regions, counts.unmarked), (1, 0));
        assert_hatches_inside(&vectors, &regions, 45.0);
        for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Contour) {
            let depth = depth_um(&regions, mark.from_um.map(f64::from));
            // Arcs and rounding take up to 2 µm.
            prop_assert!(depth >= 28.0, "{:?} is {} µm inside", mark, depth);
        }
        prop_assert_eq!(filled(&settings(strategy), layer, &regions), (vectors, counts));
    }

    #[test]
    fn rings_are_covered(outer_um in 400.0..1200.0_f64, wall in 0.3..0.9_f64, layer in 0_u32..9) {
        prop_assume!(outer_um * wall > 300.0);
        let centre = [2500.0, 2500.0];
        let regions = [with_hole(disc(centre, outer_um), disc(centre, outer_um * (1.0 - wall)))];
        let (vectors, _) = filled(&settings(HatchStrategy::Zigzag), layer, &regions);
        let Melted { covered, spilled } = melted(&vectors, &regions, 60.0);
        prop_assert!(covered > 0.985 && spilled < 0.005, "{} covered, {} spilled", covered, spilled);
    }
}
