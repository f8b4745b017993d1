//! Clips in build files that do not make sense, and what damage does to them.

use layerd::buildfile::{BodySettings, Joint, Keeps, Placement, WriteError, Writer, WriterSettings};
use layerd::layer::{Depth, Mirror};

use crate::Clipped;
use crate::shapes::ball;
use crate::slice_part::{drawn, strut};

#[test]
fn damage_never_crashes_and_lies_are_refused() {
    let struts = [strut([0, 0, 0], [900, 0, 400], 100, 60)];
    let whole = Clipped::new(&struts, Joint::Union, Keeps::Inside, &ball([400.0, 0.0, 200.0], 300.0, 2)).packed();
    let whole = whole.expect("something is left");
    let bytes = std::fs::read(whole.file.path()).expect("it is there");
    let path = whole.file.path().with_file_name("damaged.layerd");
    let plan = whole.plan(Depth::Grey, Mirror::default(), 50.0);
    let length = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
    let changed = |at: usize, change: u8| {
        let mut changed = bytes.clone();
        changed[20 + at] ^= change;
        let crc = crc32fast::hash(&changed[20..20 + length]);
        changed[16..20].copy_from_slice(&crc.to_le_bytes());
        std::fs::write(&path, &changed).expect("can be written");
        drawn(&path, &plan)
    };
    changed(0, 0).expect("it is whole");
    for at in 0..length {
        // Some of it cannot be checked, such as the digest of the source.
        let _ = changed(at, 0x41);
    }
    // The clip is the last body: its number, what it keeps, two boxes of six numbers, and a count.
    let clip = length - 64;
    for at in [clip, clip + 4] {
        changed(at, 2).expect_err("there is no such kind, and no such side");
    }
    for number in 0..12 {
        changed(clip + 8 + 4 * number + 3, 0x40).expect_err("a box far too large, or of nothing");
    }
    changed(clip + 56, 1).expect_err("a wrong count");
    for at in (0..bytes.len()).step_by(7) {
        std::fs::write(&path, &bytes[..at]).expect("can be written");
        drawn(&path, &plan).expect_err("a file that is cut short is found");
    }
}

#[test]
fn a_clip_follows_a_lattice() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let lattice = || BodySettings::Lattice { joint: Joint::Union, largest_radius: 9 };
    let clip = || BodySettings::Clip { keeps: Keeps::Inside };
    for bodies in [vec![clip()], vec![BodySettings::Surface, clip()], vec![lattice(), clip(), clip()]] {
        let settings = WriterSettings {
            materials: None,
            quantum_um: 1.0,
            placement: Placement::Centred,
            source_digest: [0; 32],
            source_name: String::new(),
            bodies,
        };
        let error = Writer::create(&directory.path().join("no.layerd"), settings).err().expect("is refused");
        assert!(matches!(&error, WriteError::Refused { problem, .. } if problem.contains("is a clip, but")), "{error}");
    }
}
