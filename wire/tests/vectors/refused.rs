//! What decoders and encoders refuse: each broken rule has its error.

use layerd_wire::encoding::{
    HatchFrame, HatchLine, LayerSum, MAX_FIELD_UM, MarkClass, VectorEncodeError, VectorEncoder, VectorEncoding,
    VectorError,
};

use crate::{BOTH, FIELD_UM, Run, encoded, finished, table};

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
fn a_field_is_at_most_two_metres_wide() {
    let mut bytes = Vec::new();
    let mut encoder = VectorEncoder::new(VectorEncoding::Plain, [u32::MAX; 2], &table(), &mut bytes).expect("a table");
    let corner = MAX_FIELD_UM as i32;
    encoder.path(MarkClass::Thin, &[[corner, 0], [0, corner]]).expect("the last point of the longest field");
    assert!(encoder.path(MarkClass::Thin, &[[corner + 1, 0]]).is_err());
}
