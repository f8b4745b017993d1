//! Narrow and small regions: centre lines, points, and parts with contours alone.

use layerd::layer::{Mark, MarkClass, Run};
use layerd::slice::scan::{HatchStrategy, Region, ScanSettings};

use crate::measure::off_um;
use crate::scan_samples::{disc, dumb_bell, rectangle, settings, with_hole};
use crate::{class_count, filled};

#[test]
fn a_web_between_wide_parts_gets_a_centre_line_that_joins_their_contours() {
    let regions = [dumb_bell([2000.0, 2000.0], 400.0, 1600.0, 80.0)];
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &regions);
    assert_eq!((counts.centre_lines, counts.points, counts.unmarked), (1, 0, 0));
    for step in 0..=160 {
        let at = [2000.0 + 10.0 * f64::from(step), 2000.0];
        let mut borders = vectors.marks().filter(|mark| mark.class != MarkClass::Hatch);
        let near = borders.any(|mark| off_um(at, mark.from_um.map(f64::from), mark.to_um.map(f64::from)) <= 30.0);
        let in_discs = !(2350.0..3250.0).contains(&at[0]);
        assert!(near || in_discs, "nothing melts {at:?}");
    }
    for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Thin) {
        let off_um = [mark.from_um, mark.to_um].map(|point| (point[1] - 2000).abs());
        assert!(off_um.iter().all(|um| *um <= 6), "{mark:?} leaves the middle");
    }
}

#[test]
fn a_web_of_middle_width_gets_contours_and_no_hatches() {
    let regions = [dumb_bell([2000.0, 2000.0], 500.0, 1800.0, 200.0)];
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &regions);
    assert_eq!((counts.contours_only, counts.centre_lines), (1, 0));
    for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Hatch) {
        for x in [mark.from_um[0], mark.to_um[0]] {
            assert!(!(2560..3240).contains(&x), "{mark:?} is in the web");
        }
    }
}

/// A square of 1 mm with a tip or a web at its right side, `length_um` long and `width_um` wide. Its end is round.
fn stub(length_um: f64, width_um: f64, is_web: bool) -> Region {
    let (low, high) = (1500.0 - width_um / 2.0, 1500.0 + width_um / 2.0);
    let mut outer = vec![[1000.0, 1000.0], [2000.0, 1000.0], [2000.0, low]];
    let end = 2000.0 + length_um;
    if is_web {
        let far = end + 1000.0;
        outer.extend([[end, low], [end, 1000.0], [far, 1000.0], [far, 2000.0], [end, 2000.0], [end, high]]);
    } else {
        let angle = |step: u32| std::f64::consts::PI * (f64::from(step) / 16.0 - 0.5);
        let radius = width_um / 2.0;
        outer.extend(
            (0..=16).map(|step| [end - radius + radius * angle(step).cos(), 1500.0 + radius * angle(step).sin()]),
        );
    }
    outer.extend([[2000.0, high], [2000.0, 2000.0], [1000.0, 2000.0]]);
    Region { outer, holes: Vec::new() }
}

#[test]
fn the_line_of_a_short_tip_or_web_runs_along_it() {
    for is_web in [false, true] {
        for (length_um, width_um) in [(60.0, 110.0), (70.0, 100.0), (90.0, 110.0), (100.0, 80.0), (140.0, 110.0)] {
            let region = stub(length_um, width_um, is_web);
            let (vectors, _) = filled(&settings(HatchStrategy::Zigzag), 0, &[region]);
            let thin: Vec<_> = vectors.marks().filter(|mark| mark.class == MarkClass::Thin).collect();
            for mark in &thin {
                for [_, y] in [mark.from_um, mark.to_um] {
                    assert!((1485..=1515).contains(&y), "{length_um} × {width_um} µm, web: {is_web}: {thin:?}");
                }
            }
            assert!(!thin.is_empty() || length_um < 90.0, "{length_um} × {width_um} µm, web: {is_web}");
        }
    }
}

#[test]
fn thin_rings_and_strips_are_marked_along_their_middle() {
    let ring = with_hole(disc([2000.0, 2000.0], 500.0), disc([2000.0, 2000.0], 420.0));
    let strip = rectangle([3000.0, 2000.0], [4000.0, 2070.0]);
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &[ring, strip]);
    assert_eq!((counts.centre_lines, counts.unmarked), (2, 0));
    let mut ends = Vec::new();
    for (class, run) in vectors.runs() {
        let (MarkClass::Thin, Run::Path(points)) = (class, run) else { panic!("{class:?} {run:?}") };
        for point in points {
            let [x, y] = point.map(f64::from);
            let radius = (x - 2000.0).hypot(y - 2000.0);
            assert!((radius - 460.0).abs() < 8.0 || (y - 2035.0).abs() < 8.0, "{point:?} is not in the middle");
        }
        ends.push([points[0], points[points.len() - 1]]);
    }
    let strips: Vec<_> = ends.iter().filter(|[a, b]| a != b).collect();
    let [[a, b]] = strips[..] else { panic!("{ends:?}") };
    // Half a beam before the border.
    let (low, high) = (a[0].min(b[0]), a[0].max(b[0]));
    assert!((low - 3030).abs() <= 10 && (high - 3970).abs() <= 10, "{ends:?}");
}

#[test]
fn however_small_a_region_is_it_is_marked() {
    let regions = [
        rectangle([1000.0, 1000.0], [1005.0, 1005.0]),
        rectangle([1100.0, 1000.0], [1101.0, 2000.0]),
        disc([1500.0, 1500.0], 30.0),
        Region { outer: vec![[2000.0, 2000.0], [2100.0, 2000.0], [2000.0, 2100.0]], holes: Vec::new() },
        rectangle([2500.0, 2500.0], [2560.0, 2560.0]),
        rectangle([3000.0, 2500.0], [3120.0, 2620.0]),
    ];
    let (vectors, counts) = filled(&settings(HatchStrategy::Zigzag), 0, &regions);
    assert_eq!((counts.regions, counts.unmarked), (6, 0));
    for region in &regions {
        let near = |mark: &Mark| {
            let [a, b] = [mark.from_um, mark.to_um].map(|point| point.map(f64::from));
            region.outer.iter().any(|point| off_um(*point, a, b) < 90.0)
        };
        assert!(vectors.marks().any(|mark| near(&mark)), "nothing near {region:?}");
    }
    assert!(class_count(&vectors, MarkClass::Point) >= 3);
}

#[test]
fn what_gets_no_mark_is_counted() {
    let settings = ScanSettings { contour_count: 0, hatch: None, ..settings(HatchStrategy::Zigzag) };
    let (vectors, counts) = filled(&settings, 0, &[disc([1000.0, 1000.0], 500.0), disc([3000.0, 1000.0], 50.0)]);
    assert_eq!((counts.regions, counts.unmarked, vectors.mark_count()), (2, 1, 1));
}
