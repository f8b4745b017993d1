//! The build file through its public interface: what goes in comes out, and damaged files are refused.

mod properties;

use std::path::Path;

use layerd::buildfile::{
    Blend, BodySettings, BuildFile, BuildFileError, Cap, Caps, GenerateOptions, Header, Height, Kind, Lattice,
    Placement, Strut, Writer, WriterSettings, generate,
};
use proptest::prelude::*;

fn settings(blend: Blend) -> WriterSettings {
    WriterSettings {
        quantum_um: 1.0,
        placement: Placement::At { x_mm: 3.0, y_mm: 4.5 },
        source_digest: [7; 32],
        source_name: "test".into(),
        bodies: vec![BodySettings::Lattice { blend, largest_radius: 3000 }],
    }
}

/// The one lattice of a part.
fn only(header: &Header) -> &Lattice {
    header.lattices().next().expect("it has one")
}

fn write(path: &Path, struts: &[Strut]) -> Header {
    let mut writer = Writer::create(path, settings(Blend::Union)).expect("can be created");
    struts.iter().for_each(|strut| writer.push(*strut).expect("is in order"));
    writer.finish().expect("can be finished")
}

fn read(path: &Path) -> Result<Vec<Strut>, BuildFileError> {
    let file = BuildFile::open(path)?;
    let mut struts = Vec::new();
    (0..file.chunks().len()).try_for_each(|index| file.read_chunk(index, &mut struts))?;
    Ok(struts)
}

fn key(node: [i32; 3]) -> [i32; 3] {
    [node[2], node[1], node[0]]
}

fn any_cap() -> impl Strategy<Value = Cap> {
    prop_oneof![Just(Cap::Sphere), Just(Cap::Hemisphere), Just(Cap::Butt)]
}

fn any_strut() -> impl Strategy<Value = Strut> {
    let node = || {
        prop_oneof![
            [-50..50i32, -50..50i32, -50..50i32],
            [-1_000_000_000..1_000_000_000i32, -9..9i32, -70_000..70_000i32]
        ]
    };
    (node(), node(), 1..3000u32, 1..3000u32, any_cap(), any_cap()).prop_map(
        |(p, q, radius_a, radius_b, cap_a, cap_b)| {
            let (a, b) = if key(p) <= key(q) { (p, q) } else { (q, p) };
            let radius_b = if a == b { radius_a } else { radius_b };
            Strut { a, b, radius_a, radius_b, caps: Caps { a: cap_a, b: cap_b } }
        },
    )
}

fn any_struts() -> impl Strategy<Value = Vec<Strut>> {
    prop::collection::vec(any_strut(), 1..200).prop_map(|mut struts| {
        struts.sort_by_key(|strut| (key(strut.a), key(strut.b)));
        struts
    })
}

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

    #[test]
    fn a_chunk_with_true_checksums_and_other_bytes_is_refused_or_within_the_header(
        struts in any_struts(),
        place in any::<prop::sample::Index>(),
        other in any::<[u8; 4]>(),
        length in 1..=4usize,
    ) {
        let directory = tempfile::tempdir().expect("temporary directory");
        let path = directory.path().join("part.layerd");
        let header = write(&path, &struts);
        replace_chunk(&path, |bytes| {
            // Half of the time in the head, whose every byte steers the columns.
            let place = if other[0] % 2 == 0 { place.index(38) } else { place.index(bytes.len()) };
            bytes.iter_mut().skip(place).zip(&other[..length]).for_each(|(byte, other)| *byte = *other);
        });
        if let Ok(found) = read(&path) {
            prop_assert_eq!(found.len(), struts.len());
            for strut in found {
                let within = |node: [i32; 3]| (0..3).all(|axis| {
                    (header.bounds.min[axis]..=header.bounds.max[axis]).contains(&node[axis])
                });
                prop_assert!(within(strut.a) && within(strut.b) && strut.a[2] <= strut.b[2], "{:?}", strut);
                let range = only(&header).radius_range[0]..=only(&header).radius_range[1];
                prop_assert!(range.contains(&strut.radius_a) && range.contains(&strut.radius_b), "{:?}", strut);
                prop_assert!(!strut.is_ball() || strut.radius_a == strut.radius_b, "{:?}", strut);
            }
        }
    }

    #[test]
    fn a_flipped_bit_is_found_or_harmless(struts in any_struts(), place in any::<prop::sample::Index>(), bit in 0..8u8) {
        let directory = tempfile::tempdir().expect("temporary directory");
        let path = directory.path().join("part.layerd");
        write(&path, &struts);
        let mut bytes = std::fs::read(&path).expect("is there");
        let place = place.index(bytes.len());
        bytes[place] ^= 1 << bit;
        std::fs::write(&path, bytes).expect("can be written");
        let error = read(&path).expect_err("every byte is covered by a CRC or a magic number");
        prop_assert!(error.to_string().contains("part.layerd"), "{error}");
    }
}

/// Makes the checksums of an index of one entry and of the footer true again.
fn seal_footer(bytes: &mut [u8]) {
    let footer = bytes.len() - 36;
    let index = index_offset(bytes);
    let crc = crc32fast::hash(&bytes[index..index + 40]);
    bytes[footer + 12..footer + 16].copy_from_slice(&crc.to_le_bytes());
    let crc = crc32fast::hash(&bytes[footer..footer + 24]);
    bytes[footer + 24..footer + 28].copy_from_slice(&crc.to_le_bytes());
}

fn index_offset(bytes: &[u8]) -> usize {
    let footer = bytes.len() - 36;
    u64::from_le_bytes(bytes[footer..footer + 8].try_into().expect("8 bytes")) as usize
}

/// Replaces the only chunk of a file by what `change` makes of its unpacked bytes, and makes every checksum true again.
fn replace_chunk(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let file = BuildFile::open(path).expect("is whole");
    let [entry] = file.chunks() else { panic!("the test needs one chunk") };
    let mut bytes = std::fs::read(path).expect("is there");
    let (begin, end) = (entry.offset as usize, entry.offset as usize + entry.packed_bytes as usize);
    let mut chunk = zstd::bulk::decompress(&bytes[begin..end], 1 << 20).expect("is whole");
    change(&mut chunk);
    let packed = zstd::bulk::compress(&chunk, 1).expect("can be packed");
    let index = begin + packed.len();
    bytes.splice(begin..end, packed.iter().copied());
    bytes[index + 8..index + 12].copy_from_slice(&(packed.len() as u32).to_le_bytes());
    bytes[index + 16..index + 20].copy_from_slice(&crc32fast::hash(&packed).to_le_bytes());
    let footer = bytes.len() - 36;
    bytes[footer..footer + 8].copy_from_slice(&(index as u64).to_le_bytes());
    seal_footer(&mut bytes);
    std::fs::write(path, bytes).expect("can be written");
}

#[test]
fn a_replaced_chunk_is_read_where_nothing_was_changed() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    lattice(&path, 500);
    let struts = read(&path).expect("is whole");
    replace_chunk(&path, |_| {});
    assert_eq!(read(&path).expect("its checksums are true"), struts);
    replace_chunk(&path, |bytes| bytes.push(0));
    let error = read(&path).expect_err("longer than the index says").to_string();
    assert!(error.contains("chunk 0 of 1"), "{error}");
}

fn lattice(path: &Path, struts: u64) {
    let options = GenerateOptions {
        kind: Kind::Random,
        struts,
        footprint_mm: [20.0; 2],
        height: Height::Mm(20.0),
        radius_mm: None,
        seed: 1,
    };
    generate(path, &options, &mut |_, _| {}).expect("can be generated");
}

#[test]
fn a_file_cut_short_anywhere_is_an_error() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    lattice(&path, 500);
    assert!(read(&path).is_ok());
    let file = std::fs::OpenOptions::new().write(true).open(&path).expect("is there");
    for length in (0..file.metadata().expect("is there").len()).rev() {
        file.set_len(length).expect("can be cut");
        let error = read(&path).expect_err("a part is missing");
        assert!(error.to_string().contains("part.layerd"), "{error}");
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

#[test]
fn a_lying_index_with_a_true_checksum_is_refused() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    lattice(&path, 500);
    let good = std::fs::read(&path).expect("is there");
    let index = index_offset(&good);
    // Every field of the only entry but its CRC, with the checksums of index and footer made true again.
    for (at, name) in [
        (0, "offset"),
        (8, "packed"),
        (12, "unpacked"),
        (20, "struts"),
        (24, "balls and body"),
        (28, "z"),
        (32, "z"),
        (36, "z"),
    ] {
        for value in [0u32, 1, 0x7fff_ffff, u32::MAX] {
            let mut bytes = good.clone();
            if bytes[index + at..index + at + 4] == value.to_le_bytes() {
                continue;
            }
            bytes[index + at..index + at + 4].copy_from_slice(&value.to_le_bytes());
            seal_footer(&mut bytes);
            std::fs::write(&path, bytes).expect("can be written");
            assert!(read(&path).is_err(), "{name} = {value} was believed");
        }
    }
}

/// Makes the checksum of the header true again.
fn seal_header(bytes: &mut [u8]) {
    let length = u32::from_le_bytes(bytes[12..16].try_into().expect("4 bytes")) as usize;
    let crc = crc32fast::hash(&bytes[20..20 + length]);
    bytes[16..20].copy_from_slice(&crc.to_le_bytes());
}

/// Where the bounds of a part of one union stand in its header: its own, and those of its body, followed by the radii.
struct HeaderLayout {
    part: usize,
    body: usize,
}

impl HeaderLayout {
    fn of(bytes: &[u8]) -> Self {
        let length = u32::from_le_bytes(bytes[12..16].try_into().expect("4 bytes")) as usize;
        // Behind prelude and quantum; and before radii and three counts.
        Self { part: 20 + 8, body: 20 + length - 24 - 8 - 24 }
    }

    /// The file with another value in the bounds, of the part as well, or in the radii; its checksum is true.
    fn with(&self, good: &[u8], at: usize, value: i32) -> Vec<u8> {
        let mut bytes = good.to_vec();
        bytes[self.body + at..self.body + at + 4].copy_from_slice(&value.to_le_bytes());
        if at < 24 {
            bytes[self.part + at..self.part + at + 4].copy_from_slice(&value.to_le_bytes());
        }
        seal_header(&mut bytes);
        bytes
    }
}

#[test]
fn a_lying_header_with_a_true_checksum_is_refused() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let strut = Strut { a: [0; 3], b: [0, 0, 500], radius_a: 77, radius_b: 99, caps: Caps::default() };
    write(&path, &[strut]);
    let good = std::fs::read(&path).expect("is there");
    let layout = HeaderLayout::of(&good);
    assert_eq!(good[layout.body + 24..layout.body + 32], [77, 0, 0, 0, 99, 0, 0, 0], "the test knows the layout");
    for (at, value, told) in [
        (24, 0, "radius_range"),
        (28, 76, "radius_range"),
        (28, 1 << 30, "radius_range"),
        (28, 100, "too narrow"),
        (0, -98, "too narrow"),
        (20, -200, "too narrow"),
    ] {
        let bytes = layout.with(&good, at, value);
        std::fs::write(&path, bytes).expect("can be written");
        let error = read(&path).expect_err("a lie").to_string();
        assert!(error.contains(told), "{value} at {at}: {error}");
    }
}

/// Struts that reading alone cannot convict: `verify`, before a print, compares them with what the frame says.
#[test]
fn what_the_struts_contradict_is_found_by_verify() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let up = |x: i32| Strut { a: [x, 0, 0], b: [x, 0, 500], radius_a: 77, radius_b: 99, caps: Caps::default() };
    write(&path, &[up(0), up(9)]);
    let verified = || BuildFile::open(&path).and_then(|file| file.verify());
    verified().expect("as written");
    let good = std::fs::read(&path).expect("is there");
    let layout = HeaderLayout::of(&good);
    for (at, value, told) in [(8, -400, "header"), (20, 900, "header"), (24, 76, "header"), (12, 109, "header")] {
        let bytes = layout.with(&good, at, value);
        std::fs::write(&path, bytes).expect("can be written");
        let error = verified().expect_err("a lie").to_string();
        assert!(error.contains(told) && error.contains("pack the part again"), "{value} at {at}: {error}");
    }
    // A profile that has the first strut end before the second begins.
    let words: [i64; 7] = [2, -99, 1024, 1, 1, 1, 1];
    let lying: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    replace_profile(&path, &good, &lying);
    assert_eq!(BuildFile::open(&path).expect("its sums are right").peak_active(), 1);
    let error = verified().expect_err("both are active at once").to_string();
    assert!(error.contains("promises 1 active struts at most, but there are 2"), "{error}");
}

#[test]
fn another_version_is_refused_with_the_remedy() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    lattice(&path, 10);
    let mut bytes = std::fs::read(&path).expect("is there");
    bytes[8] = 1;
    std::fs::write(&path, bytes).expect("can be written");
    let error = BuildFile::open(&path).expect_err("of another version").to_string();
    assert!(error.contains("version 1") && error.contains("pack the part again"), "{error}");
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
        };
        (0..count).map(post).collect()
    };
    let written = [posts(20_000, 100, 90), posts(30, 0, 50)];
    let bodies = [(Blend::Union, 90), (Blend::Convolution { support_um: 75.0 }, 50)]
        .map(|(blend, largest_radius)| BodySettings::Lattice { blend, largest_radius });
    let settings = || WriterSettings { bodies: bodies.to_vec(), ..settings(Blend::Union) };
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
    assert!(empty.next_body().expect_err("an empty body").to_string().contains("body 0 has no struts"));
    let none = Writer::create(&path, WriterSettings { bodies: vec![], ..settings() });
    assert!(none.err().expect("no body").to_string().contains("allowed are 1 to"));
}

#[test]
fn a_bottom_that_the_struts_contradict_is_refused() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let up = Strut { a: [0; 3], b: [0, 0, 500], radius_a: 77, radius_b: 99, caps: Caps::default() };
    for (blend, bottom_um, told) in [
        (Blend::Union, -76.0, "it says that the lowest solid point lies at -76 µm, but it lies at -77 µm"),
        (Blend::Union, -78.0, "bottom_um = -78: allowed is -77 to 599"),
        (Blend::Union, f64::NAN, "bottom_um = NaN"),
        (Blend::Convolution { support_um: 150.0 }, -151.0, "bottom_um = -151: allowed is -150 to 672"),
    ] {
        let mut writer = Writer::create(
            &path,
            WriterSettings { bodies: vec![BodySettings::Lattice { blend, largest_radius: 99 }], ..settings(blend) },
        )
        .expect("can be");
        writer.push(up).expect("in order");
        writer.finish().expect("is whole");
        let mut bytes = std::fs::read(&path).expect("is there");
        // Behind prelude, quantum and bounds.
        bytes[52..60].copy_from_slice(&f64::to_le_bytes(bottom_um));
        seal_header(&mut bytes);
        std::fs::write(&path, bytes).expect("can be written");
        let error = BuildFile::open(&path).and_then(|file| file.verify()).expect_err("a lie").to_string();
        assert!(error.contains(told), "{error}");
    }
}

/// Writes `file`, a whole build file, with another profile and true checksums.
fn replace_profile(path: &Path, file: &[u8], profile: &[u8]) {
    let footer = file.len() - 36;
    let profile_bytes = u32::from_le_bytes(file[footer + 16..footer + 20].try_into().expect("4 bytes")) as usize;
    let mut bytes = file[..footer - profile_bytes].to_vec();
    let packed = zstd::bulk::compress(profile, 1).expect("can be packed");
    bytes.extend(&packed);
    bytes.extend(&file[footer..]);
    let footer = bytes.len() - 36;
    bytes[footer + 16..footer + 20].copy_from_slice(&(packed.len() as u32).to_le_bytes());
    bytes[footer + 20..footer + 24].copy_from_slice(&crc32fast::hash(&packed).to_le_bytes());
    seal_footer(&mut bytes);
    std::fs::write(path, bytes).expect("can be written");
}

#[test]
fn a_gap_before_the_first_chunk_is_refused() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    lattice(&path, 500);
    let first = BuildFile::open(&path).expect("is whole").chunks()[0].offset as usize;
    let mut bytes = std::fs::read(&path).expect("is there");
    bytes.splice(first..first, [0; 8]);
    let footer = bytes.len() - 36;
    let index = index_offset(&bytes) + 8;
    bytes[footer..footer + 8].copy_from_slice(&(index as u64).to_le_bytes());
    bytes[index..index + 8].copy_from_slice(&(first as u64 + 8).to_le_bytes());
    seal_footer(&mut bytes);
    std::fs::write(&path, bytes).expect("can be written");
    let error = read(&path).expect_err("eight bytes belong to nothing").to_string();
    assert!(error.contains(&format!("what is before it ends at {first}")), "{error}");
}

#[test]
fn foreign_files_are_named_for_what_they_are() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("picture.layerd");
    std::fs::write(&path, vec![b'x'; 4096]).expect("can be written");
    assert!(read(&path).expect_err("no build file").to_string().contains("layerctl pack"));
    lattice(&path, 100);
    let mut bytes = std::fs::read(&path).expect("is there");
    bytes[8] = 9;
    std::fs::write(&path, bytes).expect("can be written");
    assert!(read(&path).expect_err("unknown version").to_string().contains("version 9"));
    assert!(read(directory.path()).expect_err("a directory").to_string().contains("not a regular file"));
    let pipe = directory.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo runs").success());
    // A reader that opens it would wait; this end lets it go on, and fail.
    let _writer = std::fs::OpenOptions::new().read(true).write(true).open(&pipe).expect("is there");
    assert!(read(&pipe).expect_err("nobody writes to it").to_string().contains("not a regular file"));
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
    };
    let mut writer = Writer::create(&path, settings(Blend::Union)).expect("can be created");
    writer.push(strut(10, 5)).expect("is fine");
    assert!(writer.push(strut(9, 5)).is_err(), "out of order");
    assert!(writer.push(strut(11, 0)).is_err(), "no radius");
    assert!(writer.push(strut(11, 3001)).is_err(), "thicker than announced");
    let ball = Strut { b: [0, 0, 10], radius_b: 6, ..strut(10, 5) };
    assert!(writer.push(ball).is_err(), "a ball of two radii");
    assert!(writer.push(Strut { b: [700, 0, i32::MAX], ..strut(11, 5) }).is_err(), "beyond all coordinates");
    assert_eq!(writer.finish().expect("the first strut stands").bounds.max, [5, 5, 20], "the others left no mark");
    std::fs::remove_file(&path).expect("is there");
    let empty = Writer::create(&path, settings(Blend::Union)).expect("can be created");
    assert!(empty.finish().is_err(), "nothing to print");
    let singular = settings(Blend::Convolution { support_um: 3000.0 / 0.95 });
    assert!(Writer::create(&path, singular).is_err(), "radius is 0.95 R");
    assert!(Writer::create(directory.path(), settings(Blend::Union)).is_err(), "a directory");
    assert_eq!(std::fs::read_dir(directory.path()).expect("is there").count(), 0, "nothing stays behind");
}
