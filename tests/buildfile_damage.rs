//! Damaged, truncated and hostile build files: each is refused, with the file's name and what is wrong.

mod buildfile_common;
mod properties;

use std::path::Path;

use buildfile_common::{any_struts, lattice, only, read, settings, write};
use layerd::buildfile::{BodySettings, BuildFile, Caps, Joint, Shares, Strut, Writer, WriterSettings};
use proptest::prelude::*;

proptest! {
    #![proptest_config(properties::cases(24))]

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
        // Behind prelude and quantum; and before radii, three counts and whether it is graded.
        Self { part: 20 + 8, body: 20 + length - 1 - 24 - 8 - 24 }
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
    let strut = Strut {
        a: [0; 3],
        b: [0, 0, 500],
        radius_a: 77,
        radius_b: 99,
        caps: Caps::default(),
        shares: Shares::default(),
    };
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
    let up = |x: i32| Strut {
        a: [x, 0, 0],
        b: [x, 0, 500],
        radius_a: 77,
        radius_b: 99,
        caps: Caps::default(),
        shares: Shares::default(),
    };
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
    assert!(error.contains("states at most 1 active primitives, but there are 2"), "{error}");
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

#[test]
fn a_bottom_that_the_struts_contradict_is_refused() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let up = Strut {
        a: [0; 3],
        b: [0, 0, 500],
        radius_a: 77,
        radius_b: 99,
        caps: Caps::default(),
        shares: Shares::default(),
    };
    for (joint, bottom_um, told) in [
        (Joint::Union, -76.0, "it says that the lowest solid point lies at -76 µm, but it lies at -77 µm"),
        (Joint::Union, -78.0, "bottom_um = -78: allowed is -77 to 599"),
        (Joint::Union, f64::NAN, "bottom_um = NaN"),
        (Joint::Convolution { support_um: 150.0 }, -151.0, "bottom_um = -151: allowed is -150 to 672"),
    ] {
        let mut writer = Writer::create(
            &path,
            WriterSettings { bodies: vec![BodySettings::Lattice { joint, largest_radius: 99 }], ..settings(joint) },
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
