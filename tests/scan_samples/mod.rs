//! Regions to test with, and usual settings. The tests and benches of scan vectors use them.

#![allow(dead_code, reason = "each test and bench uses some of them only")]

use layerd::slice::scan::{HatchSettings, HatchStrategy, Region, Ring, ScanSettings};

/// Settings for a beam of 60 µm.
pub(crate) fn settings(strategy: HatchStrategy) -> ScanSettings {
    let hatch = HatchSettings { strategy, spacing_um: 60.0, angle_deg: 57.0, rotation_deg: 67.0, end_offset_um: 15.0 };
    ScanSettings {
        beam_diameter_um: 60.0,
        simplify_tolerance_um: 5.0,
        contour_count: 1,
        contour_offset_um: 30.0,
        contour_spacing_um: 60.0,
        thin_below_um: 120.0,
        contour_only_below_um: 240.0,
        point_below_um: 60.0,
        shortest_mark_um: 30.0,
        hatch: Some(hatch),
        up_skin: None,
        down_skin: None,
    }
}

/// A polygon of 2° steps.
pub(crate) fn disc(centre: [f64; 2], radius_um: f64) -> Region {
    Region { outer: ellipse(centre, [radius_um; 2], 0.0, 180), holes: Vec::new() }
}

/// An ellipse with half axes, turned by an angle in radians.
pub(crate) fn ellipse(centre: [f64; 2], half_axes: [f64; 2], turned: f64, points: u32) -> Ring {
    let (sin, cos) = turned.sin_cos();
    (0..points)
        .map(|number| {
            let angle = std::f64::consts::TAU * f64::from(number) / f64::from(points);
            let [x, y] = [half_axes[0] * angle.cos(), half_axes[1] * angle.sin()];
            [centre[0] + cos * x - sin * y, centre[1] + sin * x + cos * y]
        })
        .collect()
}

/// An upright rectangle.
pub(crate) fn rectangle(low: [f64; 2], high: [f64; 2]) -> Region {
    Region { outer: vec![low, [high[0], low[1]], high, [low[0], high[1]]], holes: Vec::new() }
}

/// A region with another taken out of it.
pub(crate) fn with_hole(mut region: Region, hole: Region) -> Region {
    let mut ring = hole.outer;
    ring.reverse();
    region.holes.push(ring);
    region
}

/// Two discs with a web between them. `length_um` is the distance of the centres.
pub(crate) fn dumb_bell(at: [f64; 2], radius_um: f64, length_um: f64, web_um: f64) -> Region {
    let open = (web_um / 2.0 / radius_um).asin();
    let arc = |centre: f64, from: f64| {
        (0..=100).map(move |number| {
            let angle = from + open + (std::f64::consts::TAU - 2.0 * open) * f64::from(number) / 100.0;
            [at[0] + centre + radius_um * angle.cos(), at[1] + radius_um * angle.sin()]
        })
    };
    let outer = arc(0.0, 0.0).chain(arc(length_um, std::f64::consts::PI)).collect();
    Region { outer, holes: Vec::new() }
}

/// The generator of Knuth's MMIX, begun with a seed. Its high bits are good enough to place islands.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// A number from `low` to less than `high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (self.0 >> 33) as f64 / (1u64 << 31) as f64
    }
}

/// Sections of struts as a lattice has them: ellipses, narrowest `narrow_um` and at most `wide_um`, on a grid with a random shift.
pub(crate) fn islands(count: u32, narrow_um: f64, wide_um: f64, seed: u64) -> Vec<Region> {
    let mut generator = Random(seed);
    let mut random = move || generator.between(0.0, 1.0);
    let side = f64::from(count).sqrt().ceil() as u32;
    let pitch = 2.0 * wide_um;
    (0..count)
        .map(|number| {
            let cell = [number % side, number / side].map(|at| (f64::from(at) + 0.75) * pitch);
            let centre = cell.map(|at| at + (random() - 0.5) * pitch * 0.3);
            let narrow = narrow_um + (wide_um - narrow_um) * random();
            let long = (narrow * (1.0 + random())).min(wide_um);
            let outer = ellipse(centre, [long / 2.0, narrow / 2.0], random() * 3.2, 24);
            Region { outer, holes: Vec::new() }
        })
        .collect()
}

/// A star with random spikes.
pub(crate) fn star(centre: [f64; 2], radii_um: &[f64]) -> Region {
    let outer = radii_um.iter().enumerate().map(|(number, radius)| {
        let angle = std::f64::consts::TAU * number as f64 / radii_um.len() as f64;
        [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
    });
    Region { outer: outer.collect(), holes: Vec::new() }
}
