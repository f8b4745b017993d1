//! Generated lattices: exactly what was asked for, the same every time.

use std::collections::HashMap;
use std::path::Path;

use layerd::buildfile::{BuildFile, GenerateOptions, Height, Kind, Lattice, Strut, generate};

const KINDS: [Kind; 3] = [Kind::Bcc, Kind::Octet, Kind::Random];

fn lattice(file: &BuildFile) -> &Lattice {
    file.header().lattices().next().expect("it has one")
}

fn options(kind: Kind, struts: u64) -> GenerateOptions {
    GenerateOptions { kind, struts, footprint_mm: [24.0, 16.0], height: Height::Mm(5.0), radius_mm: Some(0.1), seed: 3 }
}

fn made(options: &GenerateOptions) -> (BuildFile, Vec<Strut>, Vec<u8>) {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    generate(&path, options, &mut |_, _| {}).expect("can be generated");
    let file = BuildFile::open(&path).expect("is whole");
    let mut struts = Vec::new();
    (0..file.chunks().len()).for_each(|index| file.read_chunk(index, &mut struts).expect("is whole"));
    let bytes = std::fs::read(&path).expect("is there");
    (file, struts, bytes)
}

fn said(options: &GenerateOptions) -> String {
    let directory = tempfile::tempdir().expect("temporary directory");
    let error = generate(&directory.path().join("part.layerd"), options, &mut |_, _| {}).expect_err("is refused");
    assert_eq!(std::fs::read_dir(directory.path()).expect("is there").count(), 0, "nothing stays behind");
    error.to_string()
}

#[test]
fn every_kind_has_exactly_the_struts_asked_for_inside_the_box() {
    for kind in KINDS {
        for count in [1, 7, 300, 3600, 12_345] {
            let (file, struts, _) = made(&options(kind, count));
            assert_eq!((lattice(&file).strut_count, struts.len() as u64), (count, count), "{kind:?}");
            let inside = |node: [i32; 3]| (0..3).all(|axis| (0..=[24_000, 16_000, 5000][axis]).contains(&node[axis]));
            assert!(struts.iter().all(|strut| inside(strut.a) && inside(strut.b) && strut.a != strut.b), "{kind:?}");
        }
    }
}

#[test]
fn whole_cells_stay_whole_where_they_have_as_many_struts() {
    let (_, struts, _) = made(&options(Kind::Bcc, 15 * 10 * 3 * 8));
    let mut degrees: HashMap<[i32; 3], u32> = HashMap::new();
    struts.iter().flat_map(|strut| [strut.a, strut.b]).for_each(|node| *degrees.entry(node).or_default() += 1);
    assert_eq!(degrees.len(), 16 * 11 * 4 + 15 * 10 * 3);
    assert_eq!(degrees.values().filter(|degree| **degree == 8).count(), 15 * 10 * 3 + 14 * 9 * 2, "all inner nodes");
}

#[test]
fn the_same_options_give_the_same_file_and_another_seed_another() {
    for kind in KINDS {
        let given = options(kind, 2000);
        let (_, _, first) = made(&given);
        assert_eq!(first, made(&given).2, "{kind:?}");
        assert_ne!(made(&GenerateOptions { seed: 4, ..given }).1, made(&given).1, "{kind:?}");
    }
}

#[test]
fn random_is_as_irregular_as_a_tetrahedral_mesh() {
    let (_, struts, _) = made(&GenerateOptions { height: Height::Mm(16.0), ..options(Kind::Random, 40_000) });
    let mut degrees: HashMap<[i32; 3], u32> = HashMap::new();
    struts.iter().flat_map(|strut| [strut.a, strut.b]).for_each(|node| *degrees.entry(node).or_default() += 1);
    let inner = |node: &[i32; 3]| (0..3).all(|axis| (2000..[22_000, 14_000, 14_000][axis]).contains(&node[axis]));
    let inner: Vec<f64> =
        degrees.iter().filter(|(node, _)| inner(node)).map(|(_, degree)| f64::from(*degree)).collect();
    let mean = inner.iter().sum::<f64>() / inner.len() as f64;
    assert!((13.0..=14.0).contains(&mean), "{mean} struts at an inner node");

    let radii: Vec<u32> = struts.iter().map(|strut| strut.radius_a).collect();
    let (least, most) = (radii.iter().min().expect("some"), radii.iter().max().expect("some"));
    assert_eq!((*least, *most), (50, 150), "three times as thick");
    let mean = radii.iter().sum::<u32>() as f64 / radii.len() as f64;
    assert!((99.0..101.0).contains(&mean), "{mean} µm");
    assert!(struts.iter().all(|strut| strut.radius_a == strut.radius_b));

    let length = |strut: &Strut| {
        let across = [0, 1, 2].map(|axis| f64::from(strut.b[axis] - strut.a[axis]));
        across.iter().map(|x| x * x).sum::<f64>().sqrt()
    };
    let mut lengths: Vec<f64> = struts.iter().map(length).collect();
    lengths.sort_by(f64::total_cmp);
    let [short, long] = [1, 9].map(|tenth| lengths[lengths.len() * tenth / 10]);
    assert!(long > 1.4 * short, "from {short} to {long} µm");
}

/// Most struts that reach any plane of a fine comb.
fn busiest(file: &BuildFile, struts: &[Strut]) -> usize {
    let reach = lattice(file).reach_um(file.header().quantum_um);
    let top = f64::from(file.header().bounds.max[2]);
    let active = |z: f64| {
        let reaches = |strut: &&Strut| f64::from(strut.a[2]) - reach <= z && z <= f64::from(strut.b[2]) + reach;
        struts.iter().filter(reaches).count()
    };
    (0..200).map(|step| active(top * f64::from(step) / 200.0)).max().unwrap_or(0)
}

#[test]
fn the_height_follows_from_the_struts_that_are_to_be_active() {
    for (kind, active) in
        [(Kind::Random, 1500), (Kind::Random, 4000), (Kind::Random, 5000), (Kind::Bcc, 2000), (Kind::Octet, 2750)]
    {
        let (file, struts, _) =
            made(&GenerateOptions { height: Height::Active(active), radius_mm: None, ..options(kind, 20_000) });
        assert_eq!(struts.len(), 20_000);
        let within = |found: f64| (0.95..=1.05).contains(&(found / active as f64));
        let counted = busiest(&file, &struts);
        assert!(within(counted as f64), "{kind:?}: {counted} active, {active} asked for");
        assert!(within(file.peak_active() as f64), "{kind:?}: {} by the index", file.peak_active());
    }
}

#[test]
fn what_cannot_be_made_is_refused_with_a_remedy() {
    let good = options(Kind::Random, 5000);
    let cases = [
        (GenerateOptions { struts: 0, ..good }, "1 to 1000000000"),
        (GenerateOptions { footprint_mm: [20.0, f64::NAN], ..good }, "NaN mm"),
        (GenerateOptions { height: Height::Mm(0.0), ..good }, "0.1 to 10000 mm"),
        (GenerateOptions { struts: 1_000_000_000, footprint_mm: [2.0; 2], ..good }, "larger --box"),
        (GenerateOptions { radius_mm: Some(0.0), ..good }, "--radius 0"),
        (GenerateOptions { height: Height::Active(5001), ..good }, "only 5000 struts"),
        (GenerateOptions { height: Height::Active(1), ..good }, "reach at best"),
        (GenerateOptions { height: Height::Active(900), struts: 1_000_000_000, ..good }, "--active 900"),
    ];
    for (options, expected) in cases {
        let found = said(&options);
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
    }
}

#[test]
fn a_generated_file_is_named_after_its_making() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let header = generate(&directory.path().join("a.layerd"), &options(Kind::Octet, 50), &mut |done, total| {
        assert!(done <= total);
    });
    assert_eq!(header.expect("is fine").source_name, "generated octet, seed 3");
    assert!(generate(Path::new("/nowhere/at/all.layerd"), &options(Kind::Bcc, 50), &mut |_, _| {}).is_err());
}
