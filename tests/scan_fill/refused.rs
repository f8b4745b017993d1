//! What is refused: layers outside every field, bad settings, and layers that take more memory than the budget has.

use layerd::layer::Vectors;
use layerd::slice::SliceError;
use layerd::slice::scan::{Fill, FillError, HatchSettings, HatchStrategy, Neighbours, ScanSettings};
use layerd::stream::MemoryBudget;

use crate::scan_samples::{disc, islands, settings};
use crate::{STRATEGIES, budget, plate};

#[test]
fn a_layer_outside_every_field_and_bad_settings_are_refused() {
    let mut fill = Fill::new(settings(HatchStrategy::Zigzag), 1, &budget()).expect("good settings");
    for at_um in [-1.0, 1_000_001.0, f64::NAN, f64::INFINITY] {
        let mut region = disc([1000.0, 1000.0], 500.0);
        region.outer[3][1] = at_um;
        let refused = fill.layer(0, &[region], Neighbours::default(), &mut Vectors::default());
        assert!(matches!(refused, Err(FillError::OutsideField { .. })), "{at_um}: {refused:?}");
    }
    let bad = ScanSettings { beam_diameter_um: 0.0, ..settings(HatchStrategy::Zigzag) };
    assert!(matches!(Fill::new(bad, 1, &budget()), Err(FillError::Settings(_))));
}

#[test]
fn memory_is_charged_and_a_layer_that_does_not_fit_is_refused() {
    let fine = HatchSettings { spacing_um: 5.0, ..settings(STRATEGIES[3]).hatch.expect("hatches") };
    let many = ScanSettings { contour_count: 8, contour_spacing_um: 20.0, ..settings(STRATEGIES[0]) };
    for (settings, regions) in [
        (settings(STRATEGIES[0]), islands(300, 40.0, 400.0, 3)),
        (ScanSettings { hatch: Some(fine), ..settings(STRATEGIES[3]) }, vec![plate()]),
        (many, islands(100, 100.0, 900.0, 5)),
    ] {
        let budget = budget();
        let mut fill = Fill::new(settings.clone(), 2, &budget).expect("good settings");
        let mut vectors = Vectors::default();
        let counts = fill.layer(7, &regions, Neighbours::default(), &mut vectors).expect("it fits");
        assert!(budget.used_bytes() >= vectors.memory_bytes() as u64, "{}", budget.used_bytes());
        drop(fill);
        assert_eq!(budget.used_bytes(), 0);

        // The vectors do not depend on the budget.
        let just = MemoryBudget::new(budget.peak_bytes());
        let mut fill = Fill::new(settings.clone(), 2, &just).expect("good settings");
        let mut again = Vectors::default();
        assert_eq!(fill.layer(7, &regions, Neighbours::default(), &mut again).expect("it just fits"), counts);
        assert_eq!(again, vectors);

        let small = MemoryBudget::new(budget.peak_bytes() - 1);
        let mut fill = Fill::new(settings, 2, &small).expect("good settings");
        let refused = fill.layer(7, &regions, Neighbours::default(), &mut Vectors::default()).expect_err("too complex");
        let FillError::Slice(SliceError::TooComplex { layer: 7, exceeded }) = &refused else { panic!("{refused}") };
        assert!(exceeded.need_bytes > exceeded.free_bytes && exceeded.limit_bytes == small.limit_bytes());
        assert_eq!(small.used_bytes(), 0);
        assert!(refused.to_string().starts_with("layer 7 is too complex: "), "{refused}");
        fill.layer(8, &regions[..0], Neighbours::default(), &mut Vectors::default()).expect("nothing fits");
    }
}
