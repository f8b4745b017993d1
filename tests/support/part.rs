//! Build files of struts that a test names one by one.

use std::path::Path;

use layerd::buildfile::{BodySettings, BuildFile, Header, Joint, Placement, Strut, Writer, WriterSettings};

/// Writes struts, in any order, at a quantum of 1 µm; the header read back.
pub(crate) fn write_part(path: &Path, struts: &[Strut], joint: Joint) -> Header {
    let mut struts = struts.to_vec();
    struts.sort_by_key(|strut| [strut.a, strut.b].map(|[x, y, z]| [z, y, x]));
    let largest_radius = struts.iter().map(|strut| strut.radius_a.max(strut.radius_b)).max().expect("struts");
    let settings = WriterSettings {
        materials: None,
        quantum_um: 1.0,
        placement: Placement::Centred,
        source_digest: [0; 32],
        source_name: "test".into(),
        bodies: vec![BodySettings::Lattice { joint, largest_radius }],
    };
    let mut writer = Writer::create(path, settings).expect("can be created");
    struts.iter().for_each(|strut| writer.push(*strut).expect("in order"));
    let written = writer.finish().expect("is whole");
    let file = BuildFile::open(path).expect("is whole");
    file.verify().expect("is true");
    assert_eq!(&written, file.header());
    written
}
