//! How fast build files are made and read: struts a second, on a stand-in of shuffled edge text.
//!
//! With `LAYERD_STANDIN=FILE` this writes such text instead, of `LAYERD_STANDIN_STRUTS` struts (default 101,500,000, 7 GB),
//! for `layerctl pack` to be measured by hand:
//!
//! ```text
//! LAYERD_STANDIN=big.txt cargo bench --bench buildfile
//! command time -v layerctl pack big.txt -o big.layerd
//! ```

mod standin;

use std::path::{Path, PathBuf};

use divan::Bencher;
use divan::counter::{BytesCount, ItemsCount};
use layerd::buildfile::{BuildFile, PackOptions, pack};

/// Struts of each benchmark: 64 MB of text.
const STRUTS: u64 = 1_000_000;

/// Struts of the largest lattice of Liu et al. 2021, table 4.
const MAX_STRUTS: u64 = 101_500_000;

fn main() {
    let Some(path) = std::env::var_os("LAYERD_STANDIN").map(PathBuf::from) else { return divan::main() };
    let struts = std::env::var("LAYERD_STANDIN_STRUTS").ok();
    let struts = struts.map_or(MAX_STRUTS, |struts| struts.parse().expect("LAYERD_STANDIN_STRUTS is a whole number"));
    standin::write(&path, struts).expect("can be written");
}

fn pack_standin(directory: &Path, memory_bytes: u64) -> PathBuf {
    let output = directory.join("out.layerd");
    let threads = std::thread::available_parallelism().expect("is known");
    let options = PackOptions { memory_bytes, threads, ..PackOptions::default() };
    pack(&[directory.join("in.txt")], &output, &options, &mut |_| {}).expect("is fine");
    output
}

fn standin_directory() -> tempfile::TempDir {
    let directory = tempfile::tempdir().expect("temporary directory");
    standin::write(&directory.path().join("in.txt"), STRUTS).expect("can be written");
    directory
}

/// Reading every chunk on one core; bytes are those of the file.
#[divan::bench(sample_count = 20)]
fn decode(bencher: Bencher<'_, '_>) {
    let directory = standin_directory();
    let file = BuildFile::open(&pack_standin(directory.path(), 256 << 20)).expect("is whole");
    let mut struts = Vec::new();
    bencher.counter(ItemsCount::new(STRUTS)).counter(BytesCount::new(file.file_bytes())).bench_local(|| {
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
    let directory = standin_directory();
    bencher.counter(ItemsCount::new(STRUTS)).bench_local(|| pack_standin(directory.path(), memory_bytes));
}
