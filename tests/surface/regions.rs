//! Surfaces as regions, for lasers.

use layerd::layer::Depth;
use layerd::slice::scan::Contours;
use layerd::stream::MemoryBudget;

use crate::shapes::{ball, cuboid};
use crate::{Part, UPRIGHT};

/// The points of all rings of each layer, micrometres from the corner of the picture.
fn rings(part: &Part) -> Vec<Vec<Vec<[f64; 2]>>> {
    let memory = Contours::memory_bytes(&part.bodies(), &part.plan, 1) + (16 << 20);
    let budget = MemoryBudget::new(memory);
    let mut contours = Contours::new(part.bodies(), part.plan.clone(), 0.0, 1, 0, &budget).expect("contours");
    let mut layers = Vec::new();
    while let Some(layer) = contours.next_layer().expect("a layer") {
        let regions = layer.regions();
        layers.push(regions.iter().flat_map(|region| region.rings().cloned()).collect());
    }
    layers
}

#[test]
fn the_border_of_a_ball_lies_on_it() {
    let (centre, radius) = ([1200.0, 1080.0, 700.0], 600.0);
    let part = Part::new(&ball(centre, radius, 5), Depth::Bit, UPRIGHT, 60.0);
    let mut worst_um: f64 = 0.0;
    for (layer, rings) in rings(&part).iter().enumerate() {
        let z = part.plan.layer_z_um(layer as u32) - centre[2];
        assert_eq!(rings.len(), 1, "layer {layer}");
        for [x, y] in rings.iter().flatten() {
            let away = (x - centre[0]).hypot(y - centre[1]).hypot(z);
            worst_um = worst_um.max((away - radius).abs());
        }
    }
    // Chords of pixels of 24 µm on the smallest circles, and facets.
    assert!(worst_um < 2.0, "{worst_um} µm");
}

#[test]
fn flat_sides_are_exact_and_inner_walls_leave_no_trace() {
    let one = cuboid([300.0, 400.0, 0.0], [1000.0, 1000.0, 600.0]);
    let other = cuboid([800.0, 500.0, 0.0], [1700.0, 900.0, 600.0]);
    let part = Part::new(&one.and(&other), Depth::Bit, UPRIGHT, 60.0);
    for rings in rings(&part) {
        assert_eq!(rings.len(), 1, "{rings:?}");
        for [x, y] in &rings[0] {
            let off = |low: [f64; 2], high: [f64; 2]| {
                let outside = [low[0] - x, x - high[0], low[1] - y, y - high[1]];
                outside.into_iter().fold(f64::MIN, f64::max)
            };
            let away_um = off([300.0, 400.0], [1000.0, 1000.0]).min(off([800.0, 500.0], [1700.0, 900.0]));
            // Crossings are kept to 1/256 of a pixel. Corners are cut by less than a pixel.
            let near_corner = [
                [300.0, 400.0],
                [1000.0, 400.0],
                [1000.0, 500.0],
                [1700.0, 500.0],
                [1700.0, 900.0],
                [1000.0, 900.0],
                [1000.0, 1000.0],
                [300.0, 1000.0],
            ]
            .iter()
            .any(|[cx, cy]| (x - cx).abs() < 48.0 && (y - cy).abs() < 48.0);
            assert!(away_um.abs() < 0.15 || near_corner && away_um.abs() < 24.0, "{x}, {y}: {away_um} µm");
        }
    }
}
