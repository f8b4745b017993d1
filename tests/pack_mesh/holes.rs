//! Scans with holes: they are closed, and nothing beside them changes.

use layerd::buildfile::{BuildFile, PackReport, Triangle};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, SlicePlan};
use proptest::prelude::*;

use std::collections::HashMap;
use std::sync::Arc;

use crate::pack_bench::Bench;
use crate::slice_part::sliced;
use crate::stl::binary;
use crate::{BOX, cuboid, packed, properties, said, volume_mm3};

type Corner = [f32; 3];

const CENTRE_MM: f32 = 10.0;
const RADIUS_MM: f32 = 5.0;

/// Pixels and layers, micrometres.
const PIXEL_UM: f64 = 100.0;

/// Pixels along each side of the raster, which is wider than a ball.
const SIDE: u32 = 140;

/// A ball of `8 · 4^levels` triangles. Its corners on the axes are exact.
fn ball(levels: u32) -> Vec<[Corner; 3]> {
    let signs = [1.0, -1.0];
    let mut triangles: Vec<[[f64; 3]; 3]> = Vec::new();
    for (x, y, z) in signs.iter().flat_map(|x| signs.iter().flat_map(move |y| signs.map(|z| (*x, *y, z)))) {
        let mut corners = [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
        if x * y * z < 0.0 {
            corners.swap(0, 1);
        }
        triangles.push(corners);
    }
    let middle = |a: [f64; 3], b: [f64; 3]| {
        let sum = [0, 1, 2].map(|axis| a[axis] + b[axis]);
        let length = sum.iter().map(|at| at * at).sum::<f64>().sqrt();
        sum.map(|at| at / length)
    };
    for _ in 0..levels {
        let quarters = |[a, b, c]: [[f64; 3]; 3]| {
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(quarters).collect();
    }
    let place = |corner: [f64; 3]| corner.map(|at| CENTRE_MM + RADIUS_MM * at as f32);
    triangles.into_iter().map(|triangle| triangle.map(place)).collect()
}

fn key(corner: Corner) -> [u32; 3] {
    corner.map(f32::to_bits)
}

fn distance(a: [f64; 3], b: Corner) -> f64 {
    [0, 1, 2].map(|axis| (a[axis] - f64::from(b[axis])).powi(2)).iter().sum::<f64>().sqrt()
}

/// What packing these triangles reports, and writes.
fn pack(bench: &Bench, triangles: &[[Corner; 3]]) -> (PackReport, Vec<Triangle>) {
    packed(bench, &[bench.file("scan.stl", &binary(b"", triangles))]).unwrap_or_else(|error| panic!("{error}"))
}

/// The layers of what was packed, and where they are.
fn layers(bench: &Bench) -> (SlicePlan, Vec<Bitmap>) {
    let file = Arc::new(BuildFile::open(&bench.path("out.layerd")).expect("it is whole"));
    let raster = Raster {
        width_px: SIDE,
        height_px: SIDE,
        pixel_um: [PIXEL_UM; 2],
        build_height_um: 50_000.0,
        mirror: Mirror::default(),
    };
    let plan = SlicePlan::new(file.header(), raster, Depth::Bit, PIXEL_UM).expect("it fits");
    let layers = sliced(|| BodySource::of(&file), &plan, 1, 0);
    (plan, layers)
}

/// Triangles that touch, as the corners of each group.
fn groups(triangles: &[[Corner; 3]]) -> Vec<Vec<Corner>> {
    let mut groups: Vec<Vec<Corner>> = Vec::new();
    for triangle in triangles {
        let mut joined = triangle.to_vec();
        let touches = |group: &Vec<Corner>| group.iter().any(|corner| triangle.contains(corner));
        let (touching, apart): (Vec<_>, Vec<_>) = groups.into_iter().partition(touches);
        groups = apart;
        joined.extend(touching.concat());
        groups.push(joined);
    }
    groups
}

/// Compares what was packed with the layers of the whole: it differs only where triangles were changed, by no more than the width of a group.
fn assert_whole_but_near(bench: &Bench, (plan, whole): &(SlicePlan, Vec<Bitmap>), changed: &[[Corner; 3]]) -> usize {
    let (plan_here, found) = layers(bench);
    assert_eq!((plan_here.origin_um, found.len()), (plan.origin_um, whole.len()));
    let groups: Vec<_> = groups(changed)
        .into_iter()
        .map(|group| {
            let width = |a: &Corner| group.iter().map(|b| distance(a.map(f64::from), *b)).fold(0.0, f64::max);
            let width_mm = group.iter().map(width).fold(0.0, f64::max);
            (group, width_mm)
        })
        .collect();
    let mut differing = 0;
    for (layer, (found, whole)) in found.iter().zip(whole).enumerate() {
        for (y, x) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (y, x))) {
            let bit =
                |bitmap: &Bitmap| bitmap.data()[y as usize * bitmap.stride_bytes() + x as usize / 8] >> (7 - x % 8) & 1;
            if bit(found) == bit(whole) {
                continue;
            }
            differing += 1;
            let [dx, dy] = plan.step_um();
            let [x_um, y_um] = [plan.origin_um[0] + f64::from(x) * dx, plan.origin_um[1] + f64::from(y) * dy];
            let point = [x_um, y_um, plan.layer_z_um(layer as u32)].map(|um| um / 1000.0);
            let is_near =
                groups.iter().any(|(group, width_mm)| group.iter().any(|corner| distance(point, *corner) <= *width_mm));
            assert!(is_near, "layer {layer}, pixel {x}, {y}, at {point:?} mm");
        }
    }
    differing
}

/// Triangles of which no two share an edge; some share a corner.
fn apart(triangles: &[[Corner; 3]], every: usize) -> Vec<usize> {
    let mut edges = HashMap::new();
    let sides = |[a, b, c]: [Corner; 3]| {
        [[a, b], [b, c], [c, a]].map(|edge| {
            let mut edge = edge.map(key);
            edge.sort_unstable();
            edge
        })
    };
    let mut found = Vec::new();
    for (number, triangle) in triangles.iter().enumerate().step_by(every) {
        if sides(*triangle).iter().all(|edge| !edges.contains_key(edge)) {
            edges.extend(sides(*triangle).map(|edge| (edge, ())));
            found.push(number);
        }
    }
    found
}

fn without(triangles: &[[Corner; 3]], gone: &[usize]) -> Vec<[Corner; 3]> {
    let kept = (0..triangles.len()).filter(|number| !gone.contains(number));
    kept.map(|number| triangles[number]).collect()
}

#[test]
fn single_triangles_that_are_missing_come_back() {
    let bench = Bench::new();
    let whole = ball(3);
    let (report, expected) = pack(&bench, &whole);
    assert_eq!(report.notes, Vec::<String>::new());
    for every in [3, 7, 100] {
        let gone = apart(&whole, every);
        let (report, found) = pack(&bench, &without(&whole, &gone));
        assert!(found == expected, "{} of {}", gone.len(), whole.len());
        let said = format!("closed {} hole", gone.len());
        assert!(matches!(report.notes.as_slice(), [note] if note.starts_with(&said)), "{:?}", report.notes);
    }
}

#[test]
fn holes_that_touch_at_a_corner_are_two() {
    let bench = Bench::new();
    let whole = ball(3);
    let (_, expected) = pack(&bench, &whole);
    let peak = [CENTRE_MM, CENTRE_MM, CENTRE_MM + RADIUS_MM];
    let around: Vec<_> = (0..whole.len()).filter(|number| whole[*number].contains(&peak)).collect();
    assert_eq!(around.len(), 4);
    let opposite = (1..4)
        .find(|other| whole[around[0]].iter().filter(|corner| whole[around[*other]].contains(corner)).count() == 1);
    let gone = [around[0], around[opposite.expect("one of them")]];
    let (report, found) = pack(&bench, &without(&whole, &gone));
    assert!(found == expected && report.notes[0].starts_with("closed 2 holes with 2 triangles"), "{:?}", report.notes);
}

#[test]
fn doubled_and_flipped_triangles_change_no_pixel() {
    let bench = Bench::new();
    let whole = ball(3);
    pack(&bench, &whole);
    let expected = layers(&bench);
    let chosen = apart(&whole, 11);
    let mut doubled = whole.clone();
    doubled.extend(chosen.iter().map(|number| whole[*number]));
    pack(&bench, &doubled);
    assert_eq!(assert_whole_but_near(&bench, &expected, &[]), 0);
    let mut flipped = whole.clone();
    chosen.iter().for_each(|number| flipped[*number].swap(0, 1));
    let (report, _) = pack(&bench, &flipped);
    let said = format!("closed {0} holes with {0} triangles", 2 * chosen.len());
    assert!(report.notes[0].starts_with(&said), "{:?}", report.notes);
    assert_eq!(assert_whole_but_near(&bench, &expected, &[]), 0);
}

/// The triangles whose corners are all within a distance of a point on the ball.
fn patch(triangles: &[[Corner; 3]], direction: [f64; 3], reach_mm: f64) -> Vec<usize> {
    let length = direction.iter().map(|at| at * at).sum::<f64>().sqrt();
    let point = direction.map(|at| f64::from(CENTRE_MM) + f64::from(RADIUS_MM) * at / length);
    let is_near = |triangle: &[Corner; 3]| triangle.iter().all(|corner| distance(point, *corner) < reach_mm);
    // Those at the ends of the axes stay, so that the bounds do.
    let is_end = |triangle: &[Corner; 3]| {
        triangle.iter().any(|corner| corner.iter().filter(|at| **at == CENTRE_MM).count() == 2)
    };
    (0..triangles.len()).filter(|number| is_near(&triangles[*number]) && !is_end(&triangles[*number])).collect()
}

proptest! {
    #![proptest_config(properties::cases(12))]

    #[test]
    fn a_ball_with_holes_prints_like_the_whole_but_for_them(
        patches in proptest::collection::vec((prop::array::uniform3(-1.0..1.0), 0.6..2.0, any::<bool>()), 1..4),
        every in 20..200_usize,
    ) {
        let bench = Bench::new();
        let whole = ball(4);
        pack(&bench, &whole);
        let expected = layers(&bench);
        let is_end = |number: &usize| whole[*number].iter().any(|corner| corner.iter().filter(|at| **at == CENTRE_MM).count() == 2);
        let mut gone: Vec<_> = (0..whole.len()).step_by(every).filter(|number| !is_end(number)).collect();
        let mut scan = whole.clone();
        let mut changed: Vec<_> = gone.iter().map(|number| whole[*number]).collect();
        for (direction, reach_mm, is_flipped) in patches {
            let patch = patch(&whole, direction, reach_mm);
            changed.extend(patch.iter().map(|number| whole[*number]));
            if is_flipped {
                patch.iter().for_each(|number| scan[*number] = [whole[*number][1], whole[*number][0], whole[*number][2]]);
            } else {
                gone.extend(patch);
            }
        }
        let scan = without(&scan, &gone);
        let (report, packed) = pack(&bench, &scan);
        prop_assert!(report.notes[0].starts_with("closed "), "{:?}", report.notes);
        assert_whole_but_near(&bench, &expected, &changed);
        // The order of a file changes nothing.
        let backwards: Vec<_> = scan.iter().rev().map(|[a, b, c]| [*b, *c, *a]).collect();
        prop_assert!(pack(&bench, &backwards).1 == packed);
    }
}

#[test]
fn a_bowl_is_closed_with_a_lid_and_the_note_says_how_wide() {
    let bench = Bench::new();
    let lower: Vec<_> =
        ball(4).into_iter().filter(|triangle| triangle.iter().all(|corner| corner[2] <= CENTRE_MM)).collect();
    let (report, found) = pack(&bench, &lower);
    assert_eq!(found.len(), lower.len() + 64);
    let note = &report.notes[0];
    let expected = "closed 1 hole with 64 triangles; the widest is 10.000 mm wide, at 10.0000, 10.0000, 10.0000 mm of ";
    assert!(note.starts_with(expected) && note.contains("scan.stl"), "{note}");
    let half = 2.0 / 3.0 * std::f64::consts::PI * f64::from(RADIUS_MM).powi(3);
    assert!((volume_mm3(&bench) / half - 1.0).abs() < 0.02, "{} mm³", volume_mm3(&bench));
    assert_eq!(report.header.bounds.max[2], 10_000);
}

#[test]
fn a_crack_along_an_edge_that_one_side_divides_is_closed() {
    let bench = Bench::new();
    let mut triangles = cuboid(BOX.0, BOX.1);
    let (_, whole) = pack(&bench, &triangles);
    // One triangle becomes two, at the middle of an edge. Its neighbour keeps the whole edge.
    let [a, b, c] = triangles.remove(4);
    let middle = [0, 1, 2].map(|axis| (a[axis] + b[axis]) / 2.0);
    triangles.extend([[a, middle, c], [middle, b, c]]);
    let (report, found) = pack(&bench, &triangles);
    assert_eq!(found.len(), whole.len() + 2, "{:?}", report.notes);
    assert!((volume_mm3(&bench) - 9.0).abs() < 0.1, "{} mm³", volume_mm3(&bench));
}

#[test]
fn what_is_no_scan_with_holes_is_refused() {
    let bench = Bench::new();
    let whole = ball(3);
    let reversed = |triangles: &[[Corner; 3]]| triangles.iter().map(|[a, b, c]| [*b, *a, *c]).collect::<Vec<_>>();
    let towards =
        |corner: Corner, middle: Corner| [0, 1, 2].map(|axis| middle[axis] + 0.9 * (corner[axis] - middle[axis]));
    let soup: Vec<_> = whole
        .iter()
        .map(|triangle| {
            let middle = [0, 1, 2].map(|axis| triangle.iter().map(|corner| corner[axis]).sum::<f32>() / 3.0);
            triangle.map(|corner| towards(corner, middle))
        })
        .collect();
    let grid = |x: u16, y: u16| [f32::from(x), f32::from(y), 0.3 * f32::from(x) + 0.7 * f32::from(y)];
    let sheet: Vec<_> = (0..400_u16)
        .flat_map(|number| {
            let (x, y) = (number % 20, number / 20);
            let [a, b, c, d] = [grid(x, y), grid(x + 1, y), grid(x + 1, y + 1), grid(x, y + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    for (name, triangles, expected) in [
        ("soup.stl", soup, "open at 1536 edges, one of them from "),
        (
            "soup.stl",
            cuboid(BOX.0, BOX.1)[2..].to_vec(),
            "open at 4 edges, one of them from 1.0000, 2.0000, 0.1000 to 1.0000, 4.0000, 0.1000 mm",
        ),
        ("strip.stl", sheet[..40].to_vec(), "To close holes, pack adds up to one triangle for 3"),
        ("sheet.stl", sheet.clone(), "encloses nothing"),
        ("sheet.stl", reversed(&sheet), "encloses nothing"),
        ("inside_out.stl", reversed(&whole[5..]), "inside out"),
    ] {
        let found = said(&bench, name, &binary(b"", &triangles));
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
    }
}
