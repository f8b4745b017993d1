//! Build files for tests: written from struts, read back, and generated.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

use std::path::Path;

use layerd::buildfile::{
    BodySettings, BuildFile, BuildFileError, Cap, Caps, GenerateOptions, Header, Height, Joint, Kind, Lattice,
    Placement, Shares, Strut, Writer, WriterSettings, generate,
};
use proptest::prelude::*;

pub fn settings(joint: Joint) -> WriterSettings {
    WriterSettings {
        materials: None,
        quantum_um: 1.0,
        placement: Placement::At { x_mm: 3.0, y_mm: 4.5 },
        source_digest: [7; 32],
        source_name: "test".into(),
        bodies: vec![BodySettings::Lattice { joint, largest_radius: 3000 }],
    }
}

/// The one lattice of a part.
pub fn only(header: &Header) -> &Lattice {
    header.lattices().next().expect("it has one")
}

pub fn write(path: &Path, struts: &[Strut]) -> Header {
    let mut writer = Writer::create(path, settings(Joint::Union)).expect("can be created");
    struts.iter().for_each(|strut| writer.push(*strut).expect("is in order"));
    writer.finish().expect("can be finished")
}

pub fn read(path: &Path) -> Result<Vec<Strut>, BuildFileError> {
    let file = BuildFile::open(path)?;
    let mut struts = Vec::new();
    (0..file.chunks().len()).try_for_each(|index| file.read_chunk(index, &mut struts))?;
    Ok(struts)
}

pub fn key(node: [i32; 3]) -> [i32; 3] {
    [node[2], node[1], node[0]]
}

pub fn any_cap() -> impl Strategy<Value = Cap> {
    prop_oneof![Just(Cap::Sphere), Just(Cap::Hemisphere), Just(Cap::Butt)]
}

pub fn any_strut() -> impl Strategy<Value = Strut> {
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
            Strut { a, b, radius_a, radius_b, caps: Caps { a: cap_a, b: cap_b }, shares: Shares::default() }
        },
    )
}

pub fn any_struts() -> impl Strategy<Value = Vec<Strut>> {
    prop::collection::vec(any_strut(), 1..200).prop_map(|mut struts| {
        struts.sort_by_key(|strut| (key(strut.a), key(strut.b)));
        struts
    })
}

pub fn lattice(path: &Path, struts: u64) {
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
