//! The contours of a real lattice against its field in `f64`. Skipped where the lattice is not there.

use std::path::{Path, PathBuf};

use layerd::buildfile::{Joint, Strut};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::scan::{Contours, Region};
use layerd::slice::{SlicePlan, Slicer};
use layerd::solid::Beam;
use layerd::solid::reference::beam_field;
use layerd::stream::MemoryBudget;

use crate::rings::{Point, crossing, segments};
use crate::skip::skipped;
use crate::slice_part::{Part, beam, body, lattice, strut};

/// Support of the file's convolution: 1.5 times the largest radius.
const SUPPORT_SHARE: f64 = 1.5;

const PITCH_UM: f64 = 30.0;

/// How far linear interpolation on this grid is off, for 99 % of the length: figure of plain marching squares.
const INTERPOLATION_UM: f64 = 3.3;

fn struts() -> Option<Vec<Strut>> {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let path = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from).join("spot_lattice.txt");
    let Ok(text) = std::fs::read_to_string(&path) else {
        skipped(&format!("there is no {}", path.display()));
        return None;
    };
    let of_line = |line: &str| {
        let um = |word: &str| (word.parse::<f64>().expect("a number") * 1000.0).round() as i32;
        let [x1, y1, z1, x2, y2, z2, radius] = line.split_whitespace().map(um).collect::<Vec<_>>()[..] else {
            panic!("{line}")
        };
        strut([x1, y1, z1], [x2, y2, z2], radius.unsigned_abs(), radius.unsigned_abs())
    };
    Some(text.lines().skip(1).map(of_line).collect())
}

/// The struts near a layer, in squares of a support's width.
struct Near {
    beams: Vec<Beam>,
    support_um: f64,
    squares: std::collections::HashMap<[i64; 2], Vec<usize>>,
    z_um: f64,
}

impl Near {
    fn new(struts: &[Strut], support_um: f64, z_um: f64) -> Self {
        let reaches =
            |one: &&Strut| f64::from(one.a[2]) - support_um <= z_um && z_um <= f64::from(one.b[2]) + support_um;
        let beams: Vec<Beam> = struts.iter().filter(reaches).map(beam).collect();
        let mut squares = std::collections::HashMap::<_, Vec<usize>>::new();
        for (at, one) in beams.iter().enumerate() {
            let range = |axis: usize| {
                let square = |um: f64| (um / support_um).floor() as i64;
                square(one.a[axis].min(one.b[axis])) - 1..=square(one.a[axis].max(one.b[axis])) + 1
            };
            for (x, y) in range(0).flat_map(|x| range(1).map(move |y| (x, y))) {
                squares.entry([x, y]).or_default().push(at);
            }
        }
        Self { beams, support_um, squares, z_um }
    }

    fn field(&self, [x, y]: Point) -> f64 {
        let square = [x, y].map(|um| (um / self.support_um).floor() as i64);
        let near = self.squares.get(&square).map_or(&[][..], Vec::as_slice);
        near.iter().map(|at| beam_field(&self.beams[*at], self.support_um, [x, y, self.z_um])).sum()
    }

    /// Distance from the border, to first order.
    fn distance_um(&self, [x, y]: Point) -> f64 {
        let step = 0.01;
        let slope = [
            (self.field([x + step, y]) - self.field([x - step, y])) / (2.0 * step),
            (self.field([x, y + step]) - self.field([x, y - step])) / (2.0 * step),
        ];
        (self.field([x, y]) - 1.0).abs() / slope[0].hypot(slope[1])
    }
}

/// The regions of a layer.
fn layer_regions(part: &Part, plan: &SlicePlan, layer: u32, tolerance_um: f64) -> Vec<Region> {
    let bodies = || body(lattice(&part.header), &part.struts, 8192);
    let budget = MemoryBudget::new(256 << 20);
    let mut contours = Contours::new(bodies(), plan.clone(), tolerance_um, 2, layer, &budget).expect("contours");
    let found = contours.next_layer().expect("a layer").expect("a layer").regions().to_vec();
    println!("memory {} of {} KiB", budget.peak_bytes() >> 10, Contours::memory_bytes(&bodies(), plan, 2) >> 10);
    found
}

/// Solid area by counting pixels of half the pitch, µm².
fn counted_area_um2(part: &Part, plan: &SlicePlan, layer: u32) -> f64 {
    let [width_px, height_px] = [plan.raster.width_px * 2, plan.raster.height_px * 2];
    let pitch = PITCH_UM / 2.0;
    let raster = Raster { width_px, height_px, pixel_um: [pitch; 2], ..plan.raster };
    let origin_um = plan.origin_um.map(|um| um - pitch / 2.0);
    let fine = SlicePlan { raster, origin_um, ..plan.clone() };
    let budget = MemoryBudget::new(256 << 20);
    let bodies = body(lattice(&part.header), &part.struts, 8192);
    let mut slicer = Slicer::new(bodies, fine, 2, layer, &budget).expect("a slicer");
    let mut bitmap = Bitmap::new(width_px, height_px, Depth::Bit);
    slicer.next_layer(&mut bitmap).expect("a layer");
    let count: u32 = bitmap.data().iter().map(|byte| byte.count_ones()).sum();
    f64::from(count) * pitch * pitch
}

#[test]
fn contours_follow_the_field_and_keep_its_area() {
    let Some(struts) = struts() else { return };
    let largest_um = struts.iter().map(|strut| f64::from(strut.radius_a)).fold(0.0, f64::max);
    let support_um = SUPPORT_SHARE * largest_um;
    let raster = Raster {
        width_px: 2200,
        height_px: 3600,
        pixel_um: [PITCH_UM; 2],
        build_height_um: 100_000.0,
        mirror: Mirror::default(),
    };
    let part = Part::on(raster, &struts, Joint::Convolution { support_um }, Depth::Bit, PITCH_UM);
    let corner_um = part.plan.origin_um.map(|um| um - PITCH_UM / 2.0);
    for z_um in [12_000.0, 30_000.0] {
        let layer = (z_um / PITCH_UM) as u32;
        let exact = layer_regions(&part, &part.plan, layer, 0.0);
        let simple = layer_regions(&part, &part.plan, layer, 5.0);
        let point_count = |regions: &[Region]| regions.iter().flat_map(Region::rings).map(Vec::len).sum::<usize>();
        let near = Near::new(&struts, support_um, part.plan.layer_z_um(layer));
        // Distances of points along the segments, with the lengths that they stand for.
        let mut found = Vec::new();
        for [a, b] in simple.iter().flat_map(|region| region.rings().flat_map(|ring| segments(ring))).step_by(3) {
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            for share in [0.1, 0.3, 0.5, 0.7, 0.9] {
                let at = [0, 1].map(|axis| a[axis] + share * (b[axis] - a[axis]) + corner_um[axis]);
                found.push((near.distance_um(at), length / 5.0));
            }
        }
        found.sort_by(|one, other| one.0.total_cmp(&other.0));
        let total: f64 = found.iter().map(|(_, length)| length).sum();
        let mut so_far = 0.0;
        let at_99 = found.iter().find(|(_, length)| {
            so_far += length;
            so_far >= 0.99 * total
        });
        let at_99 = at_99.expect("contours").0;
        let areas = [&exact, &simple].map(|regions| regions.iter().map(Region::area_um2).sum::<f64>());
        let counted = counted_area_um2(&part, &part.plan, layer);
        let shares = areas.map(|area| (area / counted - 1.0) * 100.0);
        println!(
            "z {z_um}: {} regions, {} points, {} simplified; area {:.3} %, {:.3} % simplified; 99 % within {at_99:.2} µm",
            simple.len(),
            point_count(&exact),
            point_count(&simple),
            shares[0],
            shares[1]
        );
        assert!(simple.len() > 100 && point_count(&simple) * 2 < point_count(&exact));
        assert!(at_99 <= 5.0 + INTERPOLATION_UM, "{at_99} µm");
        assert!(shares.iter().all(|share| share.abs() < 0.5), "{shares:?} %");
        assert_eq!(crossing(&simple), None);
    }
}
