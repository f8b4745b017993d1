//! How evenly halftones distribute materials: figures of a ramp, of constant shares, and of columns of layers.

use layerd::buildfile::{BodyHeader, Joint, Materials, Shares, Split, Strut};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, JoinedLattice, MaskSlicer, MaskSources, MemoryStruts, SlicePlan};
use layerd::stream::MemoryBudget;

use crate::slice_part::{header, lit, strut};

const WIDTH: u32 = 512;
const HEIGHT: u32 = 128;

/// Layers of a thick strut along the rows that covers the whole picture, whose shares of two materials go from `from` to `to`.
fn layers(from: f64, to: f64, layer_height_um: f64) -> Vec<Vec<Bitmap>> {
    let length = 10 * WIDTH as i32;
    let shares = |material: usize| {
        let [a, b] = [from, to].map(|share| if material == 0 { share } else { 1.0 - share });
        let parts = [a, b].map(|share| (share * f64::from(Shares::WHOLE)).round() as u16);
        Shares { a: parts[0], b: parts[1] }
    };
    let whole = strut([0, 0, 0], [length, 0, 0], 4000, 4000);
    let member = |material: usize| {
        let struts = vec![Strut { shares: shares(material), ..whole }];
        let mut header = header(&struts, Joint::Union);
        let Some(BodyHeader::Lattice(mut lattice)) = header.bodies.pop() else { panic!("it is a lattice") };
        lattice.is_graded = true;
        JoinedLattice { lattice: Box::new(MemoryStruts::new(1.0, lattice, struts, 1)), material: material as u8 }
    };
    let raster = Raster {
        width_px: WIDTH,
        height_px: HEIGHT,
        pixel_um: [10.0; 2],
        build_height_um: 1e6,
        mirror: Mirror::default(),
    };
    // The strut is much wider than the picture: only the layers in its middle count.
    let plan = SlicePlan {
        raster,
        depth: Depth::Bit,
        layer_height_um,
        layer_count: 64,
        z0_um: -32.0 * layer_height_um,
        origin_um: [5.0, -5.0 * f64::from(HEIGHT)],
    };
    let names = vec!["one".into(), "two".into()];
    let materials = Materials { names, of_bodies: vec![0], split: Split::Halftone };
    let sources = MaskSources::new(vec![(BodySource::Joined(vec![member(0), member(1)]), 0)], Some(&materials));
    let budget = MemoryBudget::new(MaskSlicer::memory_bytes(&sources, &plan, 1));
    let mut slicer = MaskSlicer::new(sources, plan, 1, 0, &budget).expect("a slicer");
    let mut masks = slicer.dark_masks();
    let mut layers = Vec::new();
    while slicer.next_layer(&mut masks).expect("a layer").is_some() {
        layers.push(masks.clone());
    }
    layers
}

/// Root of the mean square of the difference between the share of a window's pixels and the share that they should have.
fn rms(mask: &Bitmap, window: u32, share: impl Fn(u32) -> f64) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for top in (0..=HEIGHT - window).step_by(3) {
        for left in (0..=WIDTH - window).step_by(3) {
            let pixels = (top..top + window).flat_map(|y| (left..left + window).map(move |x| (x, y)));
            let found = pixels.filter(|(x, y)| lit(mask, *x, *y)).count() as f64;
            let wanted = (left..left + window).map(&share).sum::<f64>() * f64::from(window);
            squares += ((found - wanted) / f64::from(window * window)).powi(2);
            count += 1.0;
        }
    }
    (squares / count).sqrt()
}

#[test]
fn a_ramp_is_even_in_windows_of_every_size() {
    let layers = layers(0.0, 1.0, 20.0);
    let share = |x: u32| (f64::from(x) + 0.5) / f64::from(WIDTH);
    let mut figures = Vec::new();
    for (window, most) in [(4, 0.054), (8, 0.021), (16, 0.0078), (32, 0.0030)] {
        // The 20th layer has another phase than the first.
        let found = [0, 20].map(|layer| rms(&layers[layer][0], window, share));
        figures.push((window, found));
        assert!(found.iter().all(|rms| *rms <= most), "windows of {window}: {found:?}, {most} is allowed");
    }
    eprintln!("RMS errors of a ramp, by window: {figures:?}");
}

#[test]
fn constant_shares_are_exact_in_every_tile_and_even_in_every_column() {
    for share in [0.1, 0.3, 0.5, 0.77] {
        let layers = layers(share, share, 20.0);
        for masks in &layers {
            for left in (0..WIDTH - 63).step_by(64) {
                let pixels = (0..64).flat_map(|y| (left..left + 64).map(move |x| (x, y)));
                let found = pixels.filter(|(x, y)| lit(&masks[0], *x, *y)).count() as f64;
                assert!((found - share * 4096.0).abs() <= 1.5, "{found} of 4096 pixels for a share of {share}");
            }
        }
        let mut squares = 0.0;
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let found = layers.iter().filter(|masks| lit(&masks[0], x, y)).count() as f64 / 64.0;
            // The largest that any 64 successive multiples of the golden ratio miss any share by.
            assert!((found - share).abs() <= 0.0401, "{found} of 64 layers at {x}, {y} for a share of {share}");
            squares += (found - share).powi(2);
        }
        let rms = (squares / f64::from(WIDTH * HEIGHT)).sqrt();
        assert!(rms < 0.0135, "{rms} for a share of {share}");
    }
}

/// No pattern of rows, columns or diagonals: neighbours of a sparse pixel are not set.
#[test]
fn sparse_pixels_keep_apart() {
    let layers = layers(0.05, 0.05, 20.0);
    let mask = &layers[7][0];
    let mut touching = 0;
    let mut lit_count = 0;
    for (x, y) in (1..HEIGHT - 1).flat_map(|y| (1..WIDTH - 1).map(move |x| (x, y))) {
        if lit(mask, x, y) {
            lit_count += 1;
            touching += usize::from(lit(mask, x + 1, y) || lit(mask, x, y + 1) || lit(mask, x + 1, y + 1));
        }
    }
    assert!(lit_count > 2000, "{lit_count}");
    assert_eq!(touching, 0, "of {lit_count}");
}
