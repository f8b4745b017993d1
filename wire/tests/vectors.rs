//! Layers of scan vectors: what goes in comes out, in any split; the bytes are the documented ones; bad bytes end in an error.

#[path = "../../tests/properties/mod.rs"]
mod properties;

use layerd_wire::encoding::{
    HatchFrame, HatchLine, LaserParameters, LayerSum, MAX_FIELD_UM, MarkClass, Vector, VectorDecoder,
    VectorEncodeError, VectorEncoder, VectorEncoding, VectorError, largest_vectors_bytes,
};
use proptest::prelude::*;

const BOTH: [VectorEncoding; 2] = [VectorEncoding::Plain, VectorEncoding::Coded];
const FIELD_UM: [u32; 2] = [100_000, 80_000];

/// A run of vectors.
#[derive(Clone, Debug)]
enum Run {
    Path(MarkClass, Vec<[i32; 2]>),
    Hatches(MarkClass, HatchFrame, Vec<HatchLine>),
}

fn laser(number: u32) -> LaserParameters {
    LaserParameters {
        power_mw: 100_000 + number,
        mark_speed_um_s: 800_000,
        jump_speed_um_s: 5_000_000,
        focus_um: -20 * number as i32,
        jump_delay_us: 100,
        mark_delay_us: 50,
        polygon_delay_us: 20,
        point_time_us: 400,
    }
}

fn table() -> Vec<(MarkClass, LaserParameters)> {
    MarkClass::ALL.into_iter().map(|class| (class, laser(class as u32))).collect()
}

fn write(encoder: &mut VectorEncoder<'_>, runs: &[Run]) -> Result<(), VectorEncodeError> {
    runs.iter().try_for_each(|run| match run {
        Run::Path(class, points) => encoder.path(*class, points),
        Run::Hatches(class, frame, lines) => encoder.hatches(*class, frame, lines.iter().copied()),
    })
}

fn encoded(encoding: VectorEncoding, runs: &[Run]) -> Result<(Vec<u8>, LayerSum), VectorEncodeError> {
    let mut bytes = vec![7; 3];
    let mut encoder = VectorEncoder::new(encoding, FIELD_UM, &table(), &mut bytes)?;
    write(&mut encoder, runs)?;
    let sum = encoder.finish();
    Ok((bytes, sum))
}

fn decoded(
    encoding: VectorEncoding,
    bytes: &[u8],
    announced: usize,
    piece: usize,
) -> Result<(Vec<Vector>, LayerSum), VectorError> {
    let mut decoder = VectorDecoder::new(encoding, FIELD_UM, announced as u32);
    let mut vectors = Vec::new();
    for mut piece in bytes.chunks(piece) {
        while let Some(vector) = decoder.next(&mut piece)? {
            vectors.push(vector);
        }
        assert!(piece.is_empty(), "all bytes are taken");
    }
    // A layer that ends with its announced bytes has no more vectors, and no other answer.
    assert_eq!(decoder.next(&mut &[][..]), Ok(None));
    for (class, laser) in table() {
        assert_eq!(decoder.parameters(class), Some(&laser));
    }
    decoder.finish().map(|sum| (vectors, sum))
}

/// The vectors of runs, by plain means.
fn expected(runs: &[Run]) -> Vec<Vector> {
    let mut vectors = Vec::new();
    for run in runs {
        let (class, ends): (_, Vec<_>) = match run {
            Run::Path(class, points) if points.len() == 1 => (*class, vec![[points[0]; 2]]),
            Run::Path(class, points) => (*class, points.windows(2).map(|pair| [pair[0], pair[1]]).collect()),
            Run::Hatches(class, frame, lines) => {
                let ends = |hatch: &HatchLine| [hatch.from_um, hatch.to_um].map(|at| point_um(frame, hatch.line, at));
                (*class, lines.iter().map(ends).collect())
            }
        };
        for [from_um, to_um] in ends {
            vectors.push(Vector { number: vectors.len() as u32, class, from_um, to_um });
        }
    }
    vectors
}

/// A point of a frame, with numbers of 128 bits.
fn point_um(frame: &HatchFrame, line: i32, along_um: i32) -> [i32; 2] {
    let [ux, uy] = frame.along.map(i128::from);
    let (along_nm, across_nm) = (i128::from(along_um) * 1000, i128::from(line) * i128::from(frame.spacing_nm));
    let round = |scaled: i128| (scaled + (500 << 30)).div_euclid(1000 << 30) as i32;
    [
        frame.origin_um[0] + round(ux * along_nm - uy * across_nm),
        frame.origin_um[1] + round(uy * along_nm + ux * across_nm),
    ]
}

/// The documented checksum, written once more.
fn sum_of(vectors: &[Vector]) -> LayerSum {
    let mut bytes = Vec::new();
    for (class, laser) in table() {
        bytes.push(class as u8);
        for number in [laser.power_mw, laser.mark_speed_um_s, laser.jump_speed_um_s, laser.focus_um as u32] {
            bytes.extend(number.to_le_bytes());
        }
        for number in [laser.jump_delay_us, laser.mark_delay_us, laser.polygon_delay_us, laser.point_time_us] {
            bytes.extend(number.to_le_bytes());
        }
    }
    for vector in vectors {
        bytes.push(vector.class as u8);
        bytes.extend([vector.from_um, vector.to_um].as_flattened().iter().flat_map(|number| number.to_le_bytes()));
    }
    LayerSum { vectors: vectors.len() as u32, crc32: layerd_wire::encoding::rows_crc32(&bytes) }
}

fn class() -> impl Strategy<Value = MarkClass> {
    prop::sample::select(&MarkClass::ALL)
}

/// Near points and far ones, and some at the field's corners.
fn path() -> impl Strategy<Value = Vec<[i32; 2]>> {
    let [right, top] = FIELD_UM.map(|side_um| side_um as i32);
    let begin = prop_oneof![8 => (0..=right, 0..=top), 1 => Just((0, 0)), 1 => Just((right, top))];
    let step = prop_oneof![6 => (-90..90, -90..90), 1 => (-right..=right, -top..=top), 1 => Just((0, 0))];
    (begin, prop::collection::vec(step, 0..30), any::<bool>()).prop_map(move |(begin, steps, closes)| {
        let mut points = vec![[begin.0, begin.1]];
        for (x, y) in steps {
            let [x0, y0] = points[points.len() - 1];
            points.push([(x0 + x).clamp(0, right), (y0 + y).clamp(0, top)]);
        }
        if closes {
            points.push(points[0]);
        }
        points
    })
}

fn frame() -> impl Strategy<Value = HatchFrame> {
    (-20_000..120_000, -20_000..100_000, -7.0..7.0, 1000..200_000_u32).prop_map(
        |(x, y, turn, spacing_nm): (_, _, f64, _)| {
            let along = [turn.cos(), turn.sin()].map(|share| (share * f64::from(1 << 30)).round() as i32);
            HatchFrame { origin_um: [x, y], along, spacing_nm }
        },
    )
}

/// Hatches that lie in the field: mostly line by line, in one direction or alternating.
fn hatches() -> impl Strategy<Value = (HatchFrame, Vec<HatchLine>)> {
    let line = (prop_oneof![6 => Just(1), 2 => Just(-1), 2 => -50..50], -200..200, 1..400, any::<bool>());
    (frame(), prop::collection::vec(line, 1..25), any::<bool>()).prop_map(|(frame, lines, zigzag)| {
        // The line through the middle of the field.
        let middle = [0, 1].map(|axis| f64::from(FIELD_UM[axis]) / 2.0 - f64::from(frame.origin_um[axis]));
        let [ux, uy] = frame.along.map(|share| f64::from(share) / f64::from(1 << 30));
        let along_um = (middle[0] * ux + middle[1] * uy) as i32;
        let mut line = ((middle[1] * ux - middle[0] * uy) * 1000.0 / f64::from(frame.spacing_nm)) as i32;
        let mut hatches = Vec::new();
        for (index, (step, from, length, odd)) in lines.into_iter().enumerate() {
            line += step;
            let ends = (along_um + from, along_um + from + length);
            let (from_um, to_um) =
                if (zigzag && index % 2 == 1) != (odd && index % 5 == 0) { (ends.1, ends.0) } else { ends };
            hatches.push(HatchLine { line, from_um, to_um });
        }
        (frame, hatches)
    })
}

fn runs() -> impl Strategy<Value = Vec<Run>> {
    let run = prop_oneof![
        3 => (class(), path()).prop_map(|(class, points)| Run::Path(class, points)),
        2 => (class(), hatches()).prop_map(|(class, (frame, lines))| Run::Hatches(class, frame, lines)),
    ];
    prop::collection::vec(run, 0..30)
}

proptest! {
    #![proptest_config(properties::cases(300))]

    #[test]
    fn every_layer_comes_back_in_any_split(runs in runs(), piece in 1usize..40) {
        let vectors = expected(&runs);
        for encoding in BOTH {
            let (bytes, sum) = encoded(encoding, &runs).expect("all lies in the field");
            prop_assert_eq!(sum, sum_of(&vectors));
            prop_assert!(bytes.len() as u64 <= largest_vectors_bytes(vectors.len() as u64, runs.len() as u64));
            let read = decoded(encoding, &bytes, bytes.len(), piece);
            prop_assert_eq!(read, Ok((vectors.clone(), sum)), "{:?}", encoding);
        }
    }

    #[test]
    fn every_cut_and_every_surplus_byte_is_an_error(runs in prop::collection::vec(
        (class(), hatches()).prop_map(|(class, (frame, lines))| Run::Hatches(class, frame, lines)), 0..3,
    ), points in path(), byte: u8) {
        let runs = [runs, vec![Run::Path(MarkClass::Thin, points)]].concat();
        for encoding in BOTH {
            let (bytes, _) = encoded(encoding, &runs).expect("all lies in the field");
            for length in 0..bytes.len() {
                // A layer announced shorter, and one whose bytes did not all arrive.
                prop_assert!(finished(encoding, &bytes[..length], length).is_err(), "{:?} cut to {}", encoding, length);
                prop_assert!(finished(encoding, &bytes[..length], bytes.len()).is_err(), "{:?}, {} came", encoding, length);
            }
            let longer = [&bytes[..], &[byte]].concat();
            prop_assert!(finished(encoding, &longer, longer.len()).is_err(), "{:?} longer", encoding);
            prop_assert_eq!(finished(encoding, &longer, bytes.len()), Err(VectorError::TooManyBytes));
        }
    }

    #[test]
    fn a_damaged_byte_is_an_error_or_another_sum(runs in runs(), place: prop::sample::Index, flip in 1u8..) {
        let vectors = expected(&runs);
        for encoding in BOTH {
            let (mut bytes, sum) = encoded(encoding, &runs).expect("all lies in the field");
            let place = place.index(bytes.len());
            bytes[place] ^= flip;
            let mut decoder = VectorDecoder::new(encoding, FIELD_UM, bytes.len() as u32);
            let (mut rest, mut read) = (&bytes[..], Vec::new());
            while let Ok(Some(vector)) = decoder.next(&mut rest) {
                read.push(vector);
            }
            // The same vectors can be written in other ways: a ring as a path, or a frame in another slot.
            prop_assert!(decoder.finish() != Ok(sum) || read == vectors, "{:?}", encoding);
        }
    }

    #[test]
    fn random_bytes_end_in_an_error_or_in_vectors_within_the_field(
        bytes in prop::collection::vec(any::<u8>(), 0..600), piece in 1usize..50, begins_well: bool,
    ) {
        for encoding in BOTH {
            // Behind a good table, random bytes get further.
            let mut all = if begins_well { encoded(encoding, &[]).expect("no vector").0 } else { Vec::new() };
            all.truncate(all.len().saturating_sub(if encoding == VectorEncoding::Plain { 1 } else { 4 }));
            all.extend(&bytes);
            let mut decoder = VectorDecoder::new(encoding, FIELD_UM, all.len() as u32);
            'layer: for mut piece in all.chunks(piece) {
                loop {
                    match decoder.next(&mut piece) {
                        Ok(Some(Vector { from_um, to_um, .. })) => {
                            for [x, y] in [from_um, to_um] {
                                prop_assert!(x >= 0 && y >= 0 && x as u32 <= FIELD_UM[0] && y as u32 <= FIELD_UM[1]);
                            }
                        }
                        Ok(None) => break,
                        Err(error) => {
                            // It stays an error.
                            prop_assert_eq!(decoder.next(&mut &[][..]), Err(error));
                            break 'layer;
                        }
                    }
                }
            }
            let _ = decoder.finish();
        }
    }
}

/// What a device learns of bytes in the end.
fn finished(encoding: VectorEncoding, mut bytes: &[u8], announced: usize) -> Result<LayerSum, VectorError> {
    let mut decoder = VectorDecoder::new(encoding, FIELD_UM, announced as u32);
    while decoder.next(&mut bytes)?.is_some() {}
    decoder.finish()
}

/// Bytes of the plain encoding: a table with contours alone, then these numbers.
fn plain(numbers: &[u32]) -> Vec<u8> {
    let mut bytes = vec![1, 0, 1, 1, 1, 0, 0, 0, 0, 0];
    for number in numbers {
        let mut number = *number;
        while number > 0x7f {
            bytes.push(number as u8 | 0x80);
            number >>= 7;
        }
        bytes.push(number as u8);
    }
    bytes
}

#[test]
fn each_rule_that_is_broken_has_its_error() {
    let path = 1 << 5;
    let hatches = 1 << 5 | 3 << 3;
    let unit = 2 << 30; // zigzag of 2³⁰
    let frame = [1, 0, 0, 0, unit, 0, 60_000];
    let with = |numbers: &[u32]| [&frame[..], numbers, &[0]].concat();
    for (numbers, error) in [
        (vec![path | 1, 0, 0, 2, 2, 0], VectorError::NoParameters),
        (vec![path | 6, 0, 0, 2, 2, 0], VectorError::BadCode),
        (vec![3, 0], VectorError::BadCode),
        (vec![path, 1, 0, 2, 2, 0], VectorError::OutsideField),
        (vec![path, 200_002, 0, 2, 2, 0], VectorError::OutsideField),
        (vec![path, 0, 0, 0, 1, 0], VectorError::OutsideField),
        (vec![path, u32::MAX, u32::MAX, 0, 0, 0], VectorError::OutsideField),
        (vec![path, 0, 0, u32::MAX - 1, u32::MAX - 1, 0], VectorError::OutsideField),
        // A ring of one vector.
        (vec![path | 1 << 3, 0, 0, 0], VectorError::BadCode),
        (vec![hatches, 0, 200, 0], VectorError::BadFrame),
        (vec![2, 0, 0], VectorError::BadFrame),
        (vec![1, 16, 0, 0, unit, 0, 60_000, 0], VectorError::BadFrame),
        (vec![1, 0, 0, 0, unit, 2 << 20, 60_000, 0], VectorError::BadFrame),
        (vec![1, 0, 0, 0, u32::MAX, u32::MAX, 60_000, 0], VectorError::BadFrame),
        (vec![1, 0, 0, 0, unit, 0, 999, 0], VectorError::BadFrame),
        (vec![1, 0, (1 << 22) + 2, 0, unit, 0, 60_000, 0], VectorError::BadFrame),
        // Without length, below 0, beyond the field, a line far away.
        (with(&[hatches, 0, 0]), VectorError::OutsideField),
        (with(&[hatches, 2, 200]), VectorError::OutsideField),
        (with(&[hatches, 0, 1 << 24]), VectorError::OutsideField),
        (with(&[hatches, 0, u32::MAX]), VectorError::OutsideField),
        (with(&[hatches, 1, u32::MAX, 200]), VectorError::OutsideField),
    ] {
        let bytes = plain(&numbers);
        assert_eq!(finished(VectorEncoding::Plain, &bytes, bytes.len()), Err(error), "{numbers:?}");
    }
    assert!(finished(VectorEncoding::Plain, &plain(&with(&[hatches, 0, 200])), 10 + 15 + 5).is_err());
    let good = plain(&with(&[hatches, 0, 200]));
    assert_eq!(finished(VectorEncoding::Plain, &good, good.len()).map(|sum| sum.vectors), Ok(1));

    // Tables: too many classes, a class twice, an unknown one; numbers with a needless digit, with a sixth, above 32 bits.
    let entry = [0, 1, 1, 1, 0, 0, 0, 0, 0];
    for bytes in [
        vec![7],
        [&[2][..], &entry, &entry, &[0]].concat(),
        vec![1, 6],
        vec![0x80, 0],
        vec![0x80, 0x80, 0x80, 0x80, 0x80, 1],
        vec![0xff, 0xff, 0xff, 0xff, 0x10],
    ] {
        assert_eq!(finished(VectorEncoding::Plain, &bytes, bytes.len()), Err(VectorError::BadCode), "{bytes:?}");
    }
    assert_eq!(finished(VectorEncoding::Plain, &[0, 0], 2), Ok(LayerSum { vectors: 0, crc32: 0 }));
}

#[test]
fn what_no_device_would_take_is_refused_by_the_encoder() {
    let contour = MarkClass::Contour;
    let frame = HatchFrame { origin_um: [0, 0], along: [1 << 30, 0], spacing_nm: 60_000 };
    let line = |line, from_um, to_um| vec![HatchLine { line, from_um, to_um }];
    let outside = |point_um| VectorEncodeError::OutsideField { point_um, field_um: FIELD_UM };
    let bad = |change: &dyn Fn(&mut HatchFrame)| {
        let mut frame = frame;
        change(&mut frame);
        Run::Hatches(contour, frame, line(0, 0, 9))
    };
    for (run, error) in [
        (Run::Path(contour, vec![[0, 0], [100_001, 5]]), outside([100_001, 5])),
        (Run::Path(contour, vec![[0, -1]]), outside([0, -1])),
        (Run::Path(contour, vec![[i32::MIN, i32::MAX], [0, 0]]), outside([i32::MIN, i32::MAX])),
        (Run::Path(contour, vec![[0, 0], [0, i32::MAX], [0, i32::MIN]]), outside([0, i32::MAX])),
        (Run::Hatches(contour, frame, line(0, 50, 100_001)), outside([100_001, 0])),
        (Run::Hatches(contour, frame, line(-1, 0, 50)), outside([0, -60])),
        (Run::Hatches(contour, frame, line(0, 7, 7)), VectorEncodeError::BadHatch),
        (Run::Hatches(contour, frame, line(i32::MAX, 7, 8)), VectorEncodeError::BadHatch),
        (Run::Hatches(contour, frame, line(0, i32::MIN, i32::MAX)), VectorEncodeError::BadHatch),
        (bad(&|frame| frame.spacing_nm = 999), VectorEncodeError::BadFrame),
        (bad(&|frame| frame.along = [1 << 30, 1 << 20]), VectorEncodeError::BadFrame),
        (bad(&|frame| frame.along = [0, 0]), VectorEncodeError::BadFrame),
        (bad(&|frame| frame.along = [i32::MIN, i32::MIN]), VectorEncodeError::BadFrame),
        (bad(&|frame| frame.origin_um = [0, i32::MIN]), VectorEncodeError::BadFrame),
    ] {
        for encoding in BOTH {
            assert_eq!(encoded(encoding, std::slice::from_ref(&run)), Err(error), "{run:?}");
        }
    }
    let mut bytes = Vec::new();
    let mut encoder = VectorEncoder::new(VectorEncoding::Plain, FIELD_UM, &table()[1..], &mut bytes).expect("a table");
    let no_parameters = VectorEncodeError::NoParameters(contour);
    assert_eq!(encoder.path(contour, &[[0, 0]]), Err(no_parameters));
    assert_eq!(no_parameters.to_string(), "a vector of class Contour, which has no laser parameters");
    let twice = [table()[0], table()[0]];
    let error = VectorEncoder::new(VectorEncoding::Plain, FIELD_UM, &twice, &mut bytes).expect_err("a class twice");
    assert_eq!(error, VectorEncodeError::BadTable);
    assert_eq!(outside([3, -4]).to_string(), "the point (3 µm, -4 µm) lies outside the field of 100000 µm × 80000 µm");
}

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

#[test]
fn a_field_is_at_most_two_metres_wide() {
    let mut bytes = Vec::new();
    let mut encoder = VectorEncoder::new(VectorEncoding::Plain, [u32::MAX; 2], &table(), &mut bytes).expect("a table");
    let corner = MAX_FIELD_UM as i32;
    encoder.path(MarkClass::Thin, &[[corner, 0], [0, corner]]).expect("the last point of the longest field");
    assert!(encoder.path(MarkClass::Thin, &[[corner + 1, 0]]).is_err());
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
    let frozen = include_str!("../../tests/vectors/layers.txt");
    let frozen: String = frozen.lines().filter(|line| !line.starts_with('#')).map(|line| format!("{line}\n")).collect();
    assert_eq!(written, frozen);
    let document = include_str!("../../docs/encodings.md");
    for line in frozen.lines().filter(|line| line.starts_with("example")) {
        let fields: Vec<_> = line.split(' ').collect();
        let bytes: Vec<_> = fields[4].as_bytes().chunks(2).map(|pair| String::from_utf8_lossy(pair)).collect();
        let rows: Vec<_> = bytes.chunks(40).map(|row| format!("    {}\n", row.join(" "))).collect();
        assert!(document.contains(&rows.concat()), "docs/encodings.md gives other bytes");
        assert!(document.contains(fields[2]), "docs/encodings.md gives another CRC");
    }
}
