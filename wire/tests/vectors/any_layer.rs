//! Random layers come back, and damaged ones end in an error.

use layerd_wire::encoding::{
    HatchFrame, HatchLine, LayerSum, MarkClass, Vector, VectorDecoder, VectorEncoding, VectorError,
    largest_vectors_bytes,
};
use proptest::prelude::*;

use crate::{BOTH, FIELD_UM, Run, decoded, encoded, expected, finished, properties, table};

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
