//! The volume that `pack` and `info` tell, against plain mathematics.

mod support;

use std::f64::consts::PI;
use std::fs;
use std::sync::Arc;

use layerd::buildfile::{BuildFile, Cap, Caps, Joint, Shares, Strut};
use layerd::slice::{Estimate, Volume};
use layerd::solid::reference::beam_field;
use layerd::solid::{self, Beam, ISOVALUE};
use support::part::write_part;
use support::{Bench, Setup, real_data};

const FLAT: Caps = Caps { a: Cap::Butt, b: Cap::Butt };

fn strut(a: [i32; 3], b: [i32; 3], radius_a: u32, radius_b: u32, caps: Caps) -> Strut {
    Strut { a, b, radius_a, radius_b, caps, shares: Shares::default() }
}

/// Of struts in ascending order, micrometres.
fn sampled(struts: &[Strut], joint: Joint, threads: usize) -> Volume {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    write_part(&path, struts, joint);
    Volume::sample(&Arc::new(BuildFile::open(&path).expect("is whole")), threads).expect("can be sampled")
}

/// Three standard errors hold nearly always; what is told is two.
fn assert_near(what: &str, found: Estimate, truth: f64, most_error_share: f64) {
    eprintln!("{what}: {:.4} ± {:.4} for {truth:.4}", found.value, found.error);
    assert!((found.value - truth).abs() <= 1.5 * found.error, "{what}: {found:?} for {truth}");
    assert!(found.error <= most_error_share * truth, "{what}: {found:?} is told too coarsely");
}

#[test]
fn bodies_of_known_volume() {
    let ball = sampled(&[strut([0; 3], [0; 3], 1500, 1500, Caps::default())], Joint::Union, 1);
    assert_near("a ball", ball.solid_mm3, 4.0 / 3.0 * PI * 1.5f64.powi(3), 0.005);
    assert_eq!((ball.union_mm3, ball.excess_percent), (None, None), "it is the union");
    let leaning = sampled(&[strut([0; 3], [3000, 0, 4000], 400, 400, FLAT)], Joint::Union, 1);
    assert_near("a leaning cylinder", leaning.solid_mm3, PI * 0.16 * 5.0, 0.01);
    let cone = sampled(&[strut([0; 3], [6000, 0, 0], 200, 800, FLAT)], Joint::Union, 1);
    assert_near("a lying cone", cone.solid_mm3, PI * 2.0 * (0.04 + 0.16 + 0.64), 0.01);
    let capsule = sampled(&[strut([0; 3], [0, 0, 5000], 300, 300, Caps::default())], Joint::Union, 1);
    assert_near("a capsule", capsule.solid_mm3, PI * 0.09 * 5.0 + 4.0 / 3.0 * PI * 0.027, 0.01);
    // In step with each other, and with any raster of a whole number of pixels a millimetre.
    let posts: Vec<_> = (0..100).map(|k| [k % 10 * 1000, k / 10 * 1000, 0]).collect();
    let posts: Vec<_> = posts.iter().map(|&[x, y, z]| strut([x, y, z], [x, y, 4000], 150, 150, FLAT)).collect();
    assert_near("100 posts", sampled(&posts, Joint::Union, 1).solid_mm3, 100.0 * PI * 0.0225 * 4.0, 0.02);
    // Floors at one distance.
    let floors: Vec<_> = (0..40).map(|k| strut([0, 0, k * 500], [8000, 0, k * 500], 100, 100, FLAT)).collect();
    assert_near("40 floors", sampled(&floors, Joint::Union, 1).solid_mm3, 40.0 * PI * 0.01 * 8.0, 0.05);
}

#[test]
fn slabs_add_up_from_the_bottom_and_keep_within_their_memory() {
    // A post of 4 mm on a foot that is four times as wide and 1 mm high.
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let posts = [strut([0, 0, 0], [0, 0, 1000], 2000, 2000, FLAT), strut([0, 0, 1000], [0, 0, 5000], 1000, 1000, FLAT)];
    write_part(&path, &posts, Joint::Union);
    let file = Arc::new(BuildFile::open(&path).expect("is whole"));
    let mut rests = 0;
    let slabs = Volume::slabs(&file, 8 << 20, || rests += 1).expect("can be sampled");
    assert!(slabs.len() == rests && (64..=256).contains(&rests), "{rests}");
    let below = |share: f64| slabs[..(slabs.len() as f64 * share) as usize].iter().sum::<f64>();
    // Layers go up to the bounds, which have the struts' radii beyond their ends: 6 mm.
    for (share, truth) in [(0.5 / 6.0, 2.0 * PI), (0.5, 6.0 * PI), (1.0, 8.0 * PI)] {
        // One slab more or less, as slabs do not end where the foot does.
        let slack = 4.0 * PI * 5.0 / slabs.len() as f64 + 0.02 * truth;
        assert!((below(share) - truth).abs() < slack, "{} for {truth} at {share}", below(share));
    }
    let refused = Volume::slabs(&file, 1000, || {}).expect_err("too little memory").to_string();
    assert!(refused.contains("memory budget"), "{refused}");
}

/// Two lying cylinders of radius 0.3 and length 3 mm that cross, and an upright one of 2 mm on their crossing: plane by plane.
fn cross_mm3() -> f64 {
    const STEPS: u32 = 2000;
    let (radius, step) = (0.3f64, 0.6 / f64::from(STEPS));
    let area = |z: f64| {
        let half = (radius * radius - z * z).sqrt();
        // What of the upright one's disc lies outside both bands: four corners.
        let end = (radius * radius - half * half).max(0.0).sqrt();
        let slice = (end - half).max(0.0) / 500.0;
        let corner = (0..500).map(|k| half + (f64::from(k) + 0.5) * slice);
        let corner: f64 = corner.map(|x| ((radius * radius - x * x).sqrt() - half).max(0.0) * slice).sum();
        12.0 * half - 4.0 * half * half + if z > 0.0 { 4.0 * corner } else { 0.0 }
    };
    let crossing: f64 = (0..STEPS).map(|k| area((f64::from(k) + 0.5) * step - radius) * step).sum();
    crossing + PI * radius * radius * (2.0 - radius)
}

#[test]
fn a_convolution_and_how_far_it_exceeds_the_union() {
    let cross = [
        strut([0, -1500, 0], [0, 1500, 0], 300, 300, FLAT),
        strut([-1500, 0, 0], [1500, 0, 0], 300, 300, FLAT),
        strut([0, 0, 0], [0, 0, 2000], 300, 300, FLAT),
    ];
    let support_um = 900.0;
    let found = sampled(&cross, Joint::Convolution { support_um }, 1);
    let beams = cross.map(|strut| Beam {
        a: strut.a.map(f64::from),
        b: strut.b.map(f64::from),
        radius_a: 300.0,
        radius_b: 300.0,
        caps: [solid::Cap::Butt; 2],
    });
    const STEP_UM: f64 = 25.0;
    const RISE_UM: f64 = 5.0;
    // Shifted from plane to plane, as the bodies would keep step with the points. Nothing is solid 600 µm from all struts.
    let along = |end: f64, shift: f64| {
        (0..(2.0 * end / STEP_UM) as u32).map(move |k| (f64::from(k) + shift.fract()) * STEP_UM - end)
    };
    let mut field_count = 0u32;
    for plane in 0..640 {
        let z = (f64::from(plane) + 0.5) * RISE_UM - 600.0;
        let end = if z > 600.0 { 600.0 } else { 2100.0 };
        let [right, down] = [0.618, 0.414].map(|step| f64::from(plane) * step);
        for y in along(end, down) {
            for x in along(end, right).filter(|x| x.abs() < 600.0 || y.abs() < 600.0) {
                let field = beams.iter().map(|beam| beam_field(beam, support_um, [x, y, z])).sum::<f64>();
                field_count += u32::from(field >= ISOVALUE);
            }
        }
    }
    let field_mm3 = f64::from(field_count) * STEP_UM * STEP_UM * RISE_UM * 1e-9;
    let union_mm3 = cross_mm3();
    assert_near("a cross", found.solid_mm3, field_mm3, 0.02);
    assert_near("its union, flat ends and all", found.union_mm3.expect("a convolution"), union_mm3, 0.02);
    let excess = found.excess_percent.expect("a convolution");
    let truth = (field_mm3 / union_mm3 - 1.0) * 100.0;
    eprintln!("excess {excess:?} for {truth} %");
    assert!((excess.value - truth).abs() <= 1.5 * excess.error + 0.1 && excess.error < 2.0, "{excess:?} for {truth}");
    assert_eq!(found, sampled(&cross, Joint::Convolution { support_um }, 3), "threads change nothing");
}

#[test]
fn pack_and_info_tell_it() {
    let bench = Bench::prepare(Setup::default());
    fs::write(bench.path("part.txt"), "1 0.5 0 0\n0 0 0 0 0 20\n").expect("written");
    let told = bench.ok(&["pack", "part.txt", "--joint", "union", "-o", "part.layerd"]);
    let info = bench.json(&["info", "part.layerd"]);
    let number = |key: &str| info[key].as_f64().unwrap_or_else(|| panic!("{key} in {info}"));
    let truth = PI * 0.25 * 20.0 + 4.0 / 3.0 * PI * 0.125;
    assert!((number("volume_mm3") - truth).abs() <= 1.5 * number("volume_error_mm3"), "{info}");
    assert!(number("volume_error_mm3") < 0.01 * truth && number("volume_planes") == 1024.0, "{info}");
    assert_eq!(number("resin_ml"), number("volume_mm3") / 1000.0);
    assert_eq!(info["excess_percent"], serde_json::Value::Null);
    let volume = told.split("volume        ").nth(1).and_then(|rest| rest.split(" ±").next()?.parse::<f64>().ok());
    let is_near = volume.is_some_and(|volume| (volume - number("volume_mm3")).abs() < 0.1 * number("volume_error_mm3"));
    assert!(is_near && told.contains("ml of resin"), "{told}");
    assert!(!told.contains("exact union   "), "{told}");
    let told = bench.ok(&["pack", "part.txt", "-o", "part.layerd"]);
    let info = bench.json(&["info", "part.layerd"]);
    let excess = info["excess_percent"].as_f64().expect("a number");
    // A lone strut's ends are shorter than its balls.
    assert!((-5.0..0.0).contains(&excess) && told.contains("falls short of it by"), "{told}{info}");
    let Some(pyramid) = real_data("pyramid.3mf") else { return };
    let pyramid = pyramid.to_str().expect("UTF-8");
    let told = bench.ok(&["pack", pyramid, "--joint", "convolution", "-o", "pyramid.layerd"]);
    let info = bench.json(&["info", "pyramid.layerd"]);
    let excess = info["excess_percent"].as_f64().expect("a number");
    eprintln!("the pyramid as a convolution exceeds the exact union by {excess} %");
    assert!((55.0..65.0).contains(&excess) && told.contains("exceeds it by"), "{told}");
}
