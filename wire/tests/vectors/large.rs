//! Layers with long runs and many frames, and the most bytes that a layer takes.

use layerd_wire::encoding::{HatchFrame, HatchLine, MarkClass, largest_vectors_bytes};

use crate::{BOTH, Run, decoded, encoded, expected};

#[test]
fn runs_longer_than_a_head_counts_and_more_frames_than_are_remembered_come_back() {
    let circle = |points: i32| {
        let angle = |index: i32| f64::from(index) * std::f64::consts::TAU / f64::from(points);
        let at = |index: i32| [50_000.0 + 30_000.0 * angle(index).cos(), 40_000.0 + 30_000.0 * angle(index).sin()];
        (0..points).map(|index| at(index).map(|um| um as i32)).chain([[80_000, 40_000]]).collect::<Vec<_>>()
    };
    let along = [0, 1 << 30];
    let frames = (0..40).map(|number| HatchFrame { origin_um: [1000 + number % 20, 5], along, spacing_nm: 50_000 });
    let lines: Vec<_> =
        (0..40_000).map(|number| HatchLine { line: -number / 50, from_um: number % 50, to_um: 90 }).collect();
    let mut runs = vec![
        Run::Path(MarkClass::Contour, circle(50_001)),
        Run::Path(MarkClass::Contour, circle(16_383)),
        Run::Path(MarkClass::Contour, circle(16_384)),
        Run::Hatches(MarkClass::UpSkin, HatchFrame { origin_um: [1, 2], along, spacing_nm: 60_000 }, lines),
    ];
    runs.extend(
        frames.map(|frame| Run::Hatches(MarkClass::Hatch, frame, vec![HatchLine { line: 0, from_um: 9, to_um: 4 }])),
    );
    let vectors = expected(&runs);
    for encoding in BOTH {
        let (bytes, sum) = encoded(encoding, &runs).expect("all lies in the field");
        assert_eq!(decoded(encoding, &bytes, bytes.len(), 1000), Ok((vectors.clone(), sum)), "{encoding:?}");
    }
}

/// Vectors from corner to corner, hatches far apart, and frames that change each time.
#[test]
fn no_layer_takes_more_than_the_stated_bytes() {
    let corners = |index: u32| [[0, 0], [100_000, 80_000], [99_999, 1], [3, 79_000]][(index * index / 3 % 4) as usize];
    let long = Run::Path(MarkClass::Thin, (0..5000).map(corners).collect());
    let points = (0..2000).map(|index| Run::Path(MarkClass::ALL[index as usize % 6], vec![corners(index)]));
    let along = [759_250_125, 759_250_125];
    let frame = |origin: i32| HatchFrame { origin_um: [origin, 0], along, spacing_nm: 1000 };
    let line = |index: i32| {
        let (line, at) = (index * 7919 % 40_000 - 20_000, 60_000 - index * 104_729 % 20_000);
        HatchLine { line, from_um: at, to_um: if index * index % 3 == 0 { at + 20_000 } else { at - 20_000 } }
    };
    let scattered = Run::Hatches(MarkClass::Hatch, frame(0), (0..5000).map(line).collect());
    let frames = (0..2000).map(|index| Run::Hatches(MarkClass::UpSkin, frame(index % 40 * 97), vec![line(index)]));
    for runs in [vec![long], points.collect(), vec![scattered], frames.collect()] {
        for encoding in BOTH {
            let vectors = expected(&runs).len() as u64;
            let (bytes, _) = encoded(encoding, &runs).expect("all lies in the field");
            let most = largest_vectors_bytes(vectors, runs.len() as u64);
            assert!(bytes.len() as u64 <= most, "{encoding:?}: {} of {most} bytes", bytes.len());
        }
    }
}
