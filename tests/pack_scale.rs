//! Packing out of core and on several threads: the file is the same, errors are the same, and nothing is left behind.

mod properties;
mod skip;

use std::fs;
use std::io::Write;
use std::num::NonZero;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use layerd::buildfile::{BuildFile, PackError, PackOptions, PackProgress, PackReport, pack};
use proptest::prelude::*;
use skip::skipped;

fn options(memory_bytes: u64, threads: usize) -> PackOptions {
    PackOptions { memory_bytes, threads: NonZero::new(threads).expect("at least one"), ..PackOptions::default() }
}

/// Packs `text` in `directory`; the steps of progress are returned, too.
fn packed(directory: &Path, text: &str, options: &PackOptions) -> Result<(PackReport, Vec<PackProgress>), PackError> {
    let input = directory.join("in.txt");
    fs::write(&input, text).expect("can be written");
    let mut steps = Vec::new();
    let report = pack(&[input], &directory.join("out.layerd"), options, &mut |step| steps.push(step))?;
    Ok((report, steps))
}

/// Everything in the file but its header: the header has the digest of the source's bytes, which differs with their order.
fn body(directory: &Path) -> Vec<u8> {
    let path = directory.join("out.layerd");
    let first = BuildFile::open(&path).expect("is whole").chunks()[0].offset;
    fs::read(&path).expect("is there").split_off(first as usize)
}

/// `count` lines of struts, a few micrometres to a few millimetres long, some of them equal.
fn lines(count: u64, seed: u64) -> Vec<String> {
    let mut state = seed;
    let mut below = |limit: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % limit
    };
    let mut lines: Vec<String> = (0..count)
        .map(|_| {
            let [x, y, z] = [below(40_000), below(40_000), below(9_000)];
            format!("{} {} {}.{} -{} {} 11 0.{}", x / 7, y, z, below(10), x / 7, y, below(9) + 1)
        })
        .collect();
    for line in 0..lines.len() / 50 {
        lines.push(lines[line * 7 % count as usize].clone());
    }
    lines
}

fn text(lines: &[String]) -> String {
    format!("{} 0.1 0.15 0\n{}\n", lines.len(), lines.join("\n"))
}

proptest! {
    #![proptest_config(properties::cases(12))]

    #[test]
    fn order_memory_and_threads_change_nothing(
        seed in any::<u64>(),
        count in 1u64..12_000,
        kibibytes in 64u64..400,
        threads in 1usize..5,
        order in any::<u64>(),
    ) {
        let directory = tempfile::tempdir().expect("temporary directory");
        let mut lines = lines(count, seed);
        let (first, _) = packed(directory.path(), &text(&lines), &options(64 << 20, 1)).expect("is fine");
        let expected = body(directory.path());
        // A stride without a common divisor visits every line once.
        let stride = (1 + order % 1000..).find(|stride| lines.len() == 1 || gcd(*stride, lines.len() as u64) == 1);
        let stride = stride.expect("one of them has no common divisor") as usize;
        lines = (0..lines.len()).map(|number| lines[number * stride % lines.len()].clone()).collect();
        let (again, _) = packed(directory.path(), &text(&lines), &options(kibibytes << 10, threads)).expect("is fine");
        prop_assert!(expected == body(directory.path()), "{} KiB, {} threads", kibibytes, threads);
        prop_assert_eq!(entries(directory.path()).len(), 2, "source and build file, no temporary files");
        prop_assert_eq!(&first.notes, &again.notes);
        let digest = again.header.source_digest;
        prop_assert_eq!(layerd::buildfile::Header { source_digest: digest, ..first.header }, again.header);
    }
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[test]
fn the_first_error_in_the_file_is_told_whichever_thread_finds_it() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let good = lines(60_000, 3);
    let told = |lines: &[String], announced: usize, threads| {
        let text = format!("\n{announced} 0.1 0.15 0\r\n\n{}", lines.join("\n"));
        let error = packed(directory.path(), &text, &options(1 << 20, threads)).expect_err("must be refused");
        assert_eq!(fs::read_dir(directory.path()).expect("there").count(), 1, "only the source is left");
        error.to_string()
    };
    for threads in [1, 3] {
        let mut bad = good.clone();
        // The last first, and far enough apart to lie in blocks of different threads.
        for (line, wrong) in [(59_000, "1 2 3 4 5 6 7 8"), (40_321, "1 2 3 4 5 six"), (20_000, "0 0 0 0 0 7 1e400")] {
            bad[line] = wrong.into();
            let found = told(&bad, bad.len(), threads);
            // The first strut stands in line 4.
            assert!(found.contains(&format!("in.txt:{}: ", line + 4)) && found.contains(wrong), "{found}");
        }
        let found = told(&bad, 15_000, threads);
        assert!(found.contains("in.txt:15004: the first line announces 15000 struts, but there are more"), "{found}");
        let found = told(&good, good.len() + 1, threads);
        assert!(found.contains(&format!("announces {} struts, but {} follow", good.len() + 1, good.len())), "{found}");
        bad[10_000] = "1".repeat(300 << 10);
        let found = told(&bad, bad.len(), threads);
        assert!(found.contains("in.txt:10004: the line is longer than 1024 bytes"), "{found}");
    }
}

#[test]
fn temporary_space_is_told_before_it_is_taken_and_each_phase_is_shown_to_its_end() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let lines = lines(40_000, 4);
    let count = lines.len() as u64;
    let (_, steps) = packed(directory.path(), &text(&lines), &options(2 << 20, 2)).expect("is fine");
    let PackProgress::Space { temporary_bytes, output_bytes, free_bytes } = steps[0] else { panic!("{:?}", steps[0]) };
    assert_eq!(temporary_bytes, 32 * count);
    assert!(output_bytes >= fs::metadata(directory.path().join("out.layerd")).expect("there").len());
    assert!(free_bytes > temporary_bytes);
    let length = fs::metadata(directory.path().join("in.txt")).expect("there").len();
    assert!(steps.contains(&PackProgress::Reading { done: length, total: length }), "{steps:?}");
    assert_eq!(steps.last(), Some(&PackProgress::Writing { done: count, total: count }));
    // In 64 KiB only three runs can be merged at once: there are passes before the last, and room for two copies.
    let (_, steps) = packed(directory.path(), &text(&lines), &options(64 << 10, 2)).expect("is fine");
    assert!(matches!(steps[0], PackProgress::Space { temporary_bytes, .. } if temporary_bytes == 64 * count));
    let joined: Vec<_> = steps.iter().filter(|step| matches!(step, PackProgress::Joining { .. })).collect();
    let Some(PackProgress::Joining { done, total }) = joined.last() else { panic!("{steps:?}") };
    assert_eq!(done, total);
    let (_, steps) = packed(directory.path(), &text(&lines), &options(64 << 20, 2)).expect("is fine");
    assert!(!steps.iter().any(|step| matches!(step, PackProgress::Space { .. })), "all fits memory");
}

/// `layerctl pack` with a source that waits: a named pipe, whose other end is returned.
fn waiting_pack(directory: &Path, announced: usize) -> (Child, fs::File) {
    let pipe = directory.join("in.txt");
    let made = Command::new("mkfifo").arg(&pipe).status().expect("mkfifo runs");
    assert!(made.success());
    let mut command = Command::new(env!("CARGO_BIN_EXE_layerctl"));
    command.arg("pack").arg(&pipe).arg("-o").arg(directory.join("out/part.layerd")).args(["--memory", "1MiB"]);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("starts");
    // Without waiting for a reader that may never come; held until the pipe is open for good.
    let _first = loop {
        match fs::OpenOptions::new().write(true).custom_flags(libc::O_NONBLOCK).open(&pipe) {
            Ok(first) => break first,
            Err(_) => assert!(child.try_wait().expect("is ours").is_none(), "it ended before it read"),
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    };
    let mut source = fs::OpenOptions::new().write(true).open(&pipe).expect("its reader has opened it");
    writeln!(source, "{announced} 0.1 0.15 0").expect("is read");
    (child, source)
}

fn entries(directory: &Path) -> Vec<PathBuf> {
    fs::read_dir(directory).expect("is there").map(|entry| entry.expect("is there").path()).collect()
}

#[test]
fn an_interrupted_pack_leaves_the_directory_as_it_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let out = directory.path().join("out");
    fs::create_dir(&out).expect("can be made");
    fs::write(out.join("part.layerd"), "what was there before").expect("can be written");
    let lines = lines(100_000, 5);
    let (mut child, mut source) = waiting_pack(directory.path(), 2 * lines.len());
    // Three times the memory: when all this was taken, runs have been spilled.
    source.write_all(lines.join("\n").as_bytes()).expect("is read");
    // The shell's own: small systems have no program of that name. Not SIGINT: a job in the background of a shell may ignore it.
    let interrupted = Command::new("sh").args(["-c", &format!("kill -TERM {}", child.id())]).status().expect("sh runs");
    assert!(interrupted.success());
    assert!(!child.wait().expect("ends").success());
    assert_eq!(entries(&out), [out.join("part.layerd")], "nothing new");
    assert_eq!(fs::read(out.join("part.layerd")).expect("there"), b"what was there before");
}

/// A file system of its own, small enough to fill.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: &Path, size: &str) -> Option<Self> {
        let size = format!("size={size}");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(at).output().ok()?;
        mount.status.success().then(|| Self(at.into()))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[test]
fn too_little_space_is_refused_at_the_start_and_its_end_on_the_way_is_told() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let out = directory.path().join("out");
    fs::create_dir(&out).expect("can be made");
    let Some(disk) = SmallDisk::mount(&out, "4m") else {
        return skipped("mounting a small disk takes root");
    };
    let lines = lines(150_000, 6);
    let input = directory.path().join("large.txt");
    fs::write(&input, text(&lines)).expect("can be written");
    let error = pack(&[input], &out.join("part.layerd"), &options(1 << 20, 2), &mut |_| {}).expect_err("no room");
    assert!(error.to_string().contains("4.7 MiB more are needed, but 4.0 MiB are free; make room"), "{error}");
    assert!(error.to_string().contains("out"), "{error}");

    // What an earlier source took is not asked for again.
    drop(disk);
    let _disk = SmallDisk::mount(&out, "6m").expect("could be mounted a moment ago");
    let sources = [&lines[..100_000], &lines[100_000..120_000]].map(|lines| {
        let input = directory.path().join(format!("{}.txt", lines.len()));
        fs::write(&input, text(lines)).expect("can be written");
        input
    });
    pack(&sources, &out.join("part.layerd"), &options(512 << 10, 2), &mut |_| {}).expect("there is room for both");
    fs::remove_file(out.join("part.layerd")).expect("is there");

    let (child, mut source) = waiting_pack(directory.path(), 80_000);
    fs::write(out.join("filler"), vec![0; 5 << 20]).expect("can be written");
    // The pack may be gone before it has taken everything.
    let _ = source.write_all(lines[..80_000].join("\n").as_bytes());
    drop(source);
    let output = child.wait_with_output().expect("ends");
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("cannot write beside the build file") && told.contains("make room"), "{told}");
    assert_eq!(entries(&out), [out.join("filler")], "nothing is left behind");
}
