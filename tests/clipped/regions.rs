//! Clipped lattices as regions, for lasers.

use layerd::buildfile::{Joint, Keeps};
use layerd::layer::{Depth, Mirror};
use layerd::slice::BodySource;
use layerd::slice::scan::Contours;
use layerd::stream::MemoryBudget;

use crate::shapes::ball;
use crate::slice_part::strut;
use crate::{Clipped, Packed};

/// The points of all rings of each layer, micrometres from the corner of the picture.
fn rings(packed: &Packed, threads: usize) -> Vec<Vec<Vec<[f64; 2]>>> {
    let plan = packed.plan(Depth::Bit, Mirror::default(), 60.0);
    let memory = Contours::memory_bytes(&BodySource::of(&packed.file), &plan, threads) + (16 << 20);
    let budget = MemoryBudget::new(memory);
    let mut contours = Contours::new(BodySource::of(&packed.file), plan, 0.0, threads, 0, &budget).expect("contours");
    let mut layers = Vec::new();
    while let Some(layer) = contours.next_layer().expect("a layer") {
        layers.push(layer.regions().iter().flat_map(|region| region.rings().cloned()).collect());
    }
    layers
}

#[test]
fn the_border_of_a_clipped_strut_lies_on_strut_and_clip() {
    let (centre, radius_um) = ([700.0, 600.0, 500.0], 500.0);
    let lying = [strut([0, 650, 520], [1500, 650, 520], 250, 250)];
    for keeps in [Keeps::Inside, Keeps::Outside] {
        let packed = Clipped::new(&lying, Joint::Union, keeps, &ball(centre, radius_um, 5)).packed().expect("some");
        let plan = packed.plan(Depth::Bit, Mirror::default(), 60.0);
        let corner_um = [0, 1].map(|axis| plan.origin_um[axis] - plan.raster.pixel_um[axis] / 2.0);
        let layers = rings(&packed, 1);
        assert!(layers == rings(&packed, 3));
        let (mut on_clip, mut on_strut) = (0, 0);
        for (layer, rings) in layers.iter().enumerate() {
            let z = plan.layer_z_um(layer as u32);
            // The middle of the last layer may lie above the part.
            assert!(!rings.is_empty() || z > f64::from(packed.header().bounds.max[2]), "layer {layer}");
            for [x, y] in rings.iter().flatten() {
                let [x, y] = [x + corner_um[0], y + corner_um[1]];
                let off_clip = (x - centre[0]).hypot(y - centre[1]).hypot(z - centre[2]) - radius_um;
                // From the axis, which ends in balls.
                let along = (x - x.clamp(0.0, 1500.0)).hypot(y - 650.0);
                let off_strut = along.hypot(z - 520.0) - 250.0;
                let is_left = if keeps == Keeps::Inside { off_clip < 3.0 } else { off_clip > -3.0 };
                // Where both meet at a sharp angle, a corner is cut by less than a pixel.
                let near_both = off_clip.abs() < 48.0 && off_strut.abs() < 48.0;
                assert!(is_left && off_strut < 3.0 || near_both, "{x}, {y}, {z}: {off_clip}, {off_strut}");
                assert!(
                    off_clip.abs() < 3.0 || off_strut.abs() < 3.0 || near_both,
                    "{x}, {y}, {z}: {off_clip}, {off_strut}"
                );
                on_clip += usize::from(off_clip.abs() < 3.0 && off_strut < -48.0);
                on_strut += usize::from(off_strut.abs() < 3.0 && off_clip.abs() > 48.0);
            }
        }
        assert!(on_clip > 50 && on_strut > 50, "{on_clip}, {on_strut}");
    }
}
