//! The frozen bytes of `tests/vectors/layers.txt`, which `docs/encodings.md` shows.

use layerd_wire::encoding::{HatchFrame, HatchLine, LaserParameters, MarkClass, VectorEncoder};

use crate::{BOTH, FIELD_UM, Run, finished, laser, write};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The layers of `tests/vectors/layers.txt`.
fn documented() -> Vec<(&'static str, Vec<Run>)> {
    let (contour, hatch) = (MarkClass::Contour, MarkClass::Hatch);
    let ring = vec![[1000, 1000], [1060, 1000], [1030, 1040], [1000, 1000]];
    let level = HatchFrame { origin_um: [1000, 1000], along: [1 << 30, 0], spacing_nm: 10_000 };
    let slanted = HatchFrame { origin_um: [50_000, -7], along: [-1_002_424_350, -384_794_656], spacing_nm: 61_235 };
    let line = |line, from_um, to_um| HatchLine { line, from_um, to_um };
    let example = vec![
        Run::Path(contour, ring.clone()),
        Run::Hatches(hatch, level, vec![line(1, 8, 50), line(2, 44, 16), line(3, 25, 38)]),
    ];
    let all = vec![
        Run::Path(MarkClass::Thin, vec![[0, 0], [100_000, 80_000], [99_990, 79_000]]),
        Run::Path(MarkClass::Point, vec![[5, 5]]),
        Run::Path(MarkClass::Point, vec![[600, 7]]),
        Run::Hatches(MarkClass::UpSkin, level, vec![line(-4, 500, 900), line(-4, 1900, 2200), line(-5, 900, 500)]),
        Run::Hatches(MarkClass::DownSkin, slanted, vec![line(3, -40_000, -20_000), line(-2, -30_000, -40_000)]),
        Run::Path(contour, ring),
        Run::Hatches(MarkClass::UpSkin, level, vec![line(-6, 500, 900)]),
        Run::Path(contour, vec![[7, 7], [7, 7]]),
    ];
    vec![("empty", vec![]), ("example", example), ("all", all)]
}

/// Do not change these bytes: devices in the field decode them. Lines of the file: name, encoding, CRC-32, number of vectors, bytes.
#[test]
fn golden_bytes() {
    let mut written = String::new();
    let lasers =
        |class: MarkClass| LaserParameters { focus_um: if class == MarkClass::Hatch { -50 } else { 0 }, ..laser(0) };
    for (name, runs) in documented() {
        for encoding in BOTH {
            let used = |class: &MarkClass| {
                runs.iter().any(|run| matches!(run, Run::Path(of, _) | Run::Hatches(of, ..) if of == class))
            };
            let table: Vec<_> = MarkClass::ALL.into_iter().filter(used).map(|class| (class, lasers(class))).collect();
            let mut bytes = Vec::new();
            let mut encoder = VectorEncoder::new(encoding, FIELD_UM, &table, &mut bytes).expect("a table");
            write(&mut encoder, &runs).expect("all lies in the field");
            let sum = encoder.finish();
            assert_eq!(finished(encoding, &bytes, bytes.len()), Ok(sum), "{name}");
            written += &format!("{name} {encoding:?} {} {} {}\n", sum.crc32, sum.vectors, hex(&bytes));
        }
    }
    let frozen = include_str!("../../../tests/vectors/layers.txt");
    let frozen: String = frozen.lines().filter(|line| !line.starts_with('#')).map(|line| format!("{line}\n")).collect();
    assert_eq!(written, frozen);
    let document = include_str!("../../../docs/encodings.md");
    for line in frozen.lines().filter(|line| line.starts_with("example")) {
        let fields: Vec<_> = line.split(' ').collect();
        let bytes: Vec<_> = fields[4].as_bytes().chunks(2).map(|pair| String::from_utf8_lossy(pair)).collect();
        let rows: Vec<_> = bytes.chunks(40).map(|row| format!("    {}\n", row.join(" "))).collect();
        assert!(document.contains(&rows.concat()), "docs/encodings.md gives other bytes");
        assert!(document.contains(fields[2]), "docs/encodings.md gives another CRC");
    }
}
