//! Where hatches lie, those of skins too.

use layerd::layer::{MarkClass, Vectors};
use layerd::slice::scan::{Fill, HatchSettings, HatchStrategy, Neighbours, ScanSettings};

use crate::measure::far_um;
use crate::scan_samples::{disc, rectangle, settings};
use crate::{STRATEGIES, budget, class_count, filled, plate};

#[test]
fn spacing_and_angle_are_exact_in_each_layer_and_lines_do_not_depend_on_the_region() {
    for layer in [0, 1, 2, 1000, 1_000_000] {
        let regions = [plate(), disc([300_000.0, 200_000.0], 700.0)];
        let (vectors, _) = filled(&settings(HatchStrategy::Zigzag), layer, &regions);
        let (sin, cos) = (57.0 + 67.0 * f64::from(layer)).to_radians().sin_cos();
        let mut lines = 0;
        for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Hatch) {
            let across = |point: [i32; 2]| (cos * f64::from(point[1]) - sin * f64::from(point[0])) / 60.0;
            let line = across(mark.from_um).round();
            for end in [mark.from_um, mark.to_um] {
                // Rounding to whole micrometres takes up to 0.71.
                assert!((across(end) - line).abs() * 60.0 < 0.72, "layer {layer}: {mark:?}");
            }
            lines += 1;
        }
        assert!(lines > 60, "layer {layer}: {lines}");
    }
}

#[test]
fn unidirectional_hatches_run_one_way_and_stripes_are_no_longer_than_their_width() {
    let (vectors, _) = filled(&settings(STRATEGIES[1]), 0, &[plate()]);
    let (sin, cos) = 57.0_f64.to_radians().sin_cos();
    for mark in vectors.marks().filter(|mark| mark.class == MarkClass::Hatch) {
        let along = |point: [i32; 2]| cos * f64::from(point[0]) + sin * f64::from(point[1]);
        assert!(along(mark.to_um) > along(mark.from_um), "{mark:?}");
    }
    // A remainder shorter than the shortest mark of 30 µm is added to its neighbour, at either end.
    for (strategy, longest_um) in [(STRATEGIES[2], 700.0 + 60.0), (STRATEGIES[3], 600.0)] {
        let (vectors, _) = filled(&settings(strategy), 0, &[plate()]);
        let hatches = vectors.marks().filter(|mark| mark.class == MarkClass::Hatch);
        let longest = hatches.map(|mark| far_um(mark.from_um, mark.to_um)).fold(0.0, f64::max);
        assert!(longest > 0.9 * 600.0 && longest <= longest_um + 2.0, "{strategy:?}: {longest}");
    }
}

#[test]
fn short_hatches_are_counted() {
    let long = ScanSettings { shortest_mark_um: 300.0, ..settings(HatchStrategy::Zigzag) };
    let (vectors, counts) = filled(&long, 0, &[disc([2000.0, 2000.0], 400.0)]);
    assert!(counts.dropped_hatches > 0);
    let lines = counts.dropped_hatches + class_count(&vectors, MarkClass::Hatch) as u64;
    assert!((11..=13).contains(&lines), "{lines} lines in 710 µm");
    let hatch = settings(HatchStrategy::Stripes { width_um: 500.0, overlap_um: 20.0 }).hatch;
    let (_, counts) = filled(&ScanSettings { hatch, ..long }, 0, &[plate()]);
    assert!(counts.merged_hatches > 0, "{counts:?}");
}

#[test]
fn skins_have_their_own_class_lines_and_place() {
    let of = |strategy, spacing_um| HatchSettings { spacing_um, ..settings(strategy).hatch.expect("hatches") };
    let both = ScanSettings {
        up_skin: Some(of(HatchStrategy::Unidirectional, 50.0)),
        down_skin: Some(of(HatchStrategy::Zigzag, 40.0)),
        ..settings(HatchStrategy::Zigzag)
    };
    let region = [rectangle([1000.0, 1000.0], [4000.0, 3000.0])];
    let above = [rectangle([0.0, 0.0], [2000.0, 9000.0])];
    let below = [rectangle([3000.0, 0.0], [9000.0, 9000.0]), rectangle([900.0, 0.0], [2500.0, 9000.0])];
    let mut fill = Fill::new(both, 1, &budget()).expect("good settings");
    let mut vectors = Vectors::default();
    fill.layer(0, &region, Neighbours { above: Some(&above), below: Some(&below) }, &mut vectors).expect("it fits");
    for mark in vectors.marks() {
        for x in [mark.from_um[0], mark.to_um[0]] {
            let good = match mark.class {
                MarkClass::DownSkin => (2498..=3002).contains(&x),
                MarkClass::UpSkin => (1998..=2502).contains(&x) || x >= 2998,
                MarkClass::Hatch => x <= 2002,
                _ => true,
            };
            assert!(good, "{mark:?}");
        }
    }
    for class in [MarkClass::DownSkin, MarkClass::UpSkin, MarkClass::Hatch] {
        assert!(class_count(&vectors, class) > 5, "{class:?}");
    }
    // The first layer has nothing below, the last nothing above. Of rounded corners some may remain.
    let mut share = |above, below, class| {
        vectors.clear();
        fill.layer(0, &region, Neighbours { above, below }, &mut vectors).expect("it fits");
        let contours = class_count(&vectors, MarkClass::Contour) as u64;
        class_count(&vectors, class) as f64 / (vectors.mark_count() - contours) as f64
    };
    assert!(share(Some(&region[..]), None, MarkClass::DownSkin) > 0.95);
    assert!(share(None, Some(&region[..]), MarkClass::UpSkin) > 0.95);
    assert_eq!(share(Some(&region[..]), Some(&region[..]), MarkClass::Hatch), 1.0);
}
