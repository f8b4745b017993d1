//! How fast build files are made and read: struts a second.

use std::path::Path;

use divan::Bencher;
use divan::counter::ItemsCount;
use layerd::buildfile::{
    BlendChoice, BuildFile, GenerateOptions, Height, Kind, PackOptions, Placement, generate, pack,
};

const STRUTS: u64 = 1_000_000;

fn main() {
    divan::main();
}

fn lattice(directory: &Path) -> BuildFile {
    let path = directory.join("part.layerd");
    let options = GenerateOptions {
        kind: Kind::Random,
        struts: STRUTS,
        footprint_mm: [100.0; 2],
        height: Height::Mm(100.0),
        radius_mm: None,
        seed: 1,
    };
    generate(&path, &options, &mut |_, _| {}).expect("can be generated");
    BuildFile::open(&path).expect("is whole")
}

/// Reading every chunk on one core.
#[divan::bench(sample_count = 20)]
fn decode(bencher: Bencher<'_, '_>) {
    let directory = tempfile::tempdir().expect("temporary directory");
    let file = lattice(directory.path());
    let count = file.header().strut_count;
    let mut struts = Vec::new();
    bencher.counter(ItemsCount::new(count)).bench_local(|| {
        for index in 0..file.chunks().len() {
            struts.clear();
            file.read_chunk(index, &mut struts).expect("is whole");
        }
        struts.len()
    });
}

/// Edge text to build file: in memory, and sorted out of core in 4 MiB.
#[divan::bench(sample_count = 3, args = [256 << 20, 4 << 20])]
fn pack_edge_text(bencher: Bencher<'_, '_>, memory_bytes: u64) {
    let directory = tempfile::tempdir().expect("temporary directory");
    let file = lattice(directory.path());
    let mut struts = Vec::new();
    (0..file.chunks().len()).for_each(|index| file.read_chunk(index, &mut struts).expect("is whole"));
    struts.sort_unstable_by_key(|strut| strut.a[0]);
    let mut text = format!("{} 0.1 0.15 0\n", struts.len());
    for strut in &struts {
        let [[x1, y1, z1], [x2, y2, z2]] = [strut.a, strut.b].map(|node| node.map(|value| f64::from(value) / 1000.0));
        text += &format!("{x1} {y1} {z1} {x2} {y2} {z2} {}\n", f64::from(strut.radius_a) / 1000.0);
    }
    let input = directory.path().join("in.txt");
    std::fs::write(&input, text).expect("can be written");
    let options = PackOptions {
        lattice_only: false,
        blend: BlendChoice::Convolution { support_mm: None },
        rotate_deg: [0.0; 3],
        scale: 1.0,
        placement: Placement::Centred,
        memory_bytes,
    };
    let output = directory.path().join("out.layerd");
    bencher.counter(ItemsCount::new(struts.len())).bench_local(|| {
        pack(std::slice::from_ref(&input), &output, &options, &mut |_| {}).expect("is fine");
    });
}
