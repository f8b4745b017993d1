//! The build file through its public interface: what is written is read back, and the writer refuses what no reader would take.

mod buildfile_common;
mod properties;

use buildfile_common::{any_struts, key, lattice, only, read, settings, write};
use layerd::buildfile::{BodySettings, BuildFile, Caps, Joint, Shares, Strut, Writer, WriterSettings};
use proptest::prelude::*;

proptest! {
    #![proptest_config(properties::cases(24))]

    #[test]
    fn what_goes_in_comes_out(struts in any_struts()) {
        let directory = tempfile::tempdir().expect("temporary directory");
        let path = directory.path().join("part.layerd");
        let header = write(&path, &struts);
        prop_assert_eq!(read(&path).expect("is whole"), struts.clone());
        let file = BuildFile::open(&path).expect("is whole");
        prop_assert_eq!(file.header(), &header);
        let nodes: std::collections::HashSet<_> = struts.iter().flat_map(|strut| [strut.a, strut.b]).collect();
        prop_assert_eq!(only(&header).node_count, nodes.len() as u64);
        prop_assert_eq!(only(&header).ball_count, struts.iter().filter(|strut| strut.is_ball()).count() as u64);
    }

    #[test]
    fn the_profile_bounds_the_active_set(struts in any_struts(), at in -80_000.0..80_000.0f64) {
        let directory = tempfile::tempdir().expect("temporary directory");
        let path = directory.path().join("part.layerd");
        let reach = f64::from(only(&write(&path, &struts)).radius_range[1]);
        let file = BuildFile::open(&path).expect("is whole");
        let active = |z: f64| {
            let reaches = |strut: &&Strut| f64::from(strut.a[2]) - reach <= z && z <= f64::from(strut.b[2]) + reach;
            struts.iter().filter(reaches).count() as u64
        };
        prop_assert!(active(at) <= file.peak_active());
        prop_assert!(file.peak_active() <= struts.len() as u64);
    }
}

#[test]
fn struts_of_many_chunks_ascend_and_share_nodes() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    lattice(&path, 40_000);
    let file = BuildFile::open(&path).expect("is whole");
    assert!(file.chunks().len() > 3, "the test needs several chunks");
    let struts = read(&path).expect("is whole");
    assert_eq!(struts.len() as u64, only(file.header()).strut_count);
    assert!(struts.is_sorted_by_key(|strut| (key(strut.a), key(strut.b))));
    let per_strut = file.file_bytes() as f64 / struts.len() as f64;
    assert!(per_strut < 10.0, "{per_strut} bytes a strut");
    let again = directory.path().join("again.layerd");
    lattice(&again, 40_000);
    assert_eq!(std::fs::read(&path).expect("there"), std::fs::read(&again).expect("there"), "same seed, same file");
}

/// Two lattices that overlap, one of several chunks: each is read as it was written.
#[test]
fn a_part_of_several_bodies_is_read_body_by_body() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let posts = |count: i32, z: i32, radius: u32| -> Vec<Strut> {
        let post = |x: i32| Strut {
            a: [7 * x, 0, z],
            b: [7 * x, 0, z + 500],
            radius_a: radius,
            radius_b: radius,
            caps: Caps::default(),
            shares: Shares::default(),
        };
        (0..count).map(post).collect()
    };
    let written = [posts(20_000, 100, 90), posts(30, 0, 50)];
    let bodies = [(Joint::Union, 90), (Joint::Convolution { support_um: 75.0 }, 50)]
        .map(|(joint, largest_radius)| BodySettings::Lattice { joint, largest_radius });
    let settings = || WriterSettings { bodies: bodies.to_vec(), ..settings(Joint::Union) };
    let mut writer = Writer::create(&path, settings()).expect("can be created");
    written[0].iter().for_each(|strut| writer.push(*strut).expect("in order"));
    writer.next_body().expect("one more");
    written[1].iter().for_each(|strut| writer.push(*strut).expect("lower than the other body, which does not matter"));
    assert!(writer.next_body().expect_err("none is left").to_string().contains("no more bodies"));
    let header = writer.finish().expect("is whole");
    let file = BuildFile::open(&path).expect("is whole");
    file.verify().expect("is true");
    assert_eq!(file.header(), &header);
    for (body, struts) in written.iter().enumerate() {
        let mut read = Vec::new();
        file.body_chunks(body).for_each(|chunk| file.read_chunk(chunk, &mut read).expect("is whole"));
        assert_eq!(&read, struts, "body {body}");
        assert_eq!(file.body_peak_active(body), struts.len() as u64);
    }
    assert_eq!(header.bounds.min, [-90, -90, -50], "of both");
    // The convolution begins lowest: its posts stand close, so it reaches farther down than their radius.
    assert!((-75.0..-50.0).contains(&header.bottom_um), "{} µm", header.bottom_um);

    let mut unfinished = Writer::create(&path, settings()).expect("can be created");
    unfinished.push(written[0][0]).expect("in order");
    assert!(unfinished.finish().expect_err("a body is missing").to_string().contains("1 of its bodies are missing"));
    let mut empty = Writer::create(&path, settings()).expect("can be created");
    assert!(empty.next_body().expect_err("an empty body").to_string().contains("body 0 is empty"));
    let none = Writer::create(&path, WriterSettings { bodies: vec![], ..settings() });
    assert!(none.err().expect("no body").to_string().contains("allowed are 1 to"));
}

#[test]
fn a_writer_refuses_what_no_reader_would_take_and_leaves_nothing() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let strut = |z: i32, radius: u32| Strut {
        a: [0, 0, z],
        b: [0, 0, z + 5],
        radius_a: radius,
        radius_b: radius,
        caps: Caps::default(),
        shares: Shares::default(),
    };
    let mut writer = Writer::create(&path, settings(Joint::Union)).expect("can be created");
    writer.push(strut(10, 5)).expect("is fine");
    assert!(writer.push(strut(9, 5)).is_err(), "out of order");
    assert!(writer.push(strut(11, 0)).is_err(), "no radius");
    assert!(writer.push(strut(11, 3001)).is_err(), "thicker than announced");
    let ball = Strut { b: [0, 0, 10], radius_b: 6, ..strut(10, 5) };
    assert!(writer.push(ball).is_err(), "a ball of two radii");
    assert!(writer.push(Strut { b: [700, 0, i32::MAX], ..strut(11, 5) }).is_err(), "beyond all coordinates");
    assert_eq!(writer.finish().expect("the first strut stands").bounds.max, [5, 5, 20], "the others left no mark");
    std::fs::remove_file(&path).expect("is there");
    let empty = Writer::create(&path, settings(Joint::Union)).expect("can be created");
    assert!(empty.finish().is_err(), "nothing to print");
    let singular = settings(Joint::Convolution { support_um: 3000.0 / 0.95 });
    assert!(Writer::create(&path, singular).is_err(), "radius is 0.95 R");
    assert!(Writer::create(directory.path(), settings(Joint::Union)).is_err(), "a directory");
    assert_eq!(std::fs::read_dir(directory.path()).expect("is there").count(), 0, "nothing stays behind");
}
