//! Layer encodings: what goes in comes out, in any split; the bytes are the documented ones; garbage ends in an error.

#[path = "../../tests/properties/mod.rs"]
mod properties;

use layerd_wire::encoding::{
    DecodeError, Decoder, PartialRow, PictureEncoding, encode, largest_encoded_bytes, rows_crc32,
};
use proptest::prelude::*;

const ALL: [PictureEncoding; 4] = PictureEncoding::ALL;

/// A picture as its raw rows.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Picture {
    width_px: u32,
    height_px: u32,
    rows: Vec<u8>,
}

fn encoded(picture: &Picture, encoding: PictureEncoding) -> Vec<u8> {
    let mut bytes = vec![0xee; 3];
    encode(encoding, picture.width_px, &picture.rows, &mut bytes).expect("whole rows");
    bytes
}

fn decoded(
    bytes: &[u8],
    encoding: PictureEncoding,
    size: (u32, u32),
    piece: usize,
) -> Result<(Vec<u8>, u32), DecodeError> {
    let mut decoder = Decoder::new(encoding, size.0, size.1);
    for piece in bytes.chunks(piece) {
        decoder.push(piece)?;
    }
    decoder.finish()
}

/// The picture in the depth of an encoding: with 1 bit a pixel, values above 127 are lit.
fn from_pixels(width_px: u32, encoding: PictureEncoding, pixels: &[u8]) -> Picture {
    let height_px = pixels.len() as u32 / width_px;
    if encoding.bits_per_pixel() == 8 {
        return Picture { width_px, height_px, rows: pixels.to_vec() };
    }
    let row_bytes = encoding.row_bytes(width_px);
    let mut rows = vec![0; row_bytes * height_px as usize];
    for (index, _) in pixels.iter().enumerate().filter(|(_, pixel)| **pixel > 127) {
        let (x, y) = (index % width_px as usize, index / width_px as usize);
        rows[y * row_bytes + x / 8] |= 0x80 >> (x % 8);
    }
    Picture { width_px, height_px, rows }
}

/// Rows of runs, most of them like the row above with ends moved a little, as layers have them; and some noise.
fn pixels() -> impl Strategy<Value = (u32, Vec<u8>)> {
    let run = (0u32..90, prop_oneof![4 => Just(0u8), 4 => Just(255u8), 2 => any::<u8>()]);
    let row = prop::collection::vec(run, 1..12);
    let rows = prop::collection::vec((row, any::<bool>(), -4i32..5), 1..12);
    (1u32..300, rows).prop_map(|(width, rows)| {
        let mut pixels: Vec<u8> = Vec::new();
        for (runs, as_above, shift) in rows {
            let start = pixels.len();
            if as_above && start > 0 {
                let above = pixels[start - width as usize..].to_vec();
                let at = |x: i32| above.get(x as usize).copied().unwrap_or(0);
                pixels.extend((0..width as i32).map(|x| at(x - shift)));
            } else {
                pixels.extend(runs.iter().cycle().flat_map(|(n, v)| vec![*v; *n as usize + 1]).take(width as usize));
            }
        }
        (width, pixels)
    })
}

proptest! {
    #![proptest_config(properties::cases(400))]

    #[test]
    fn every_encoding_returns_the_picture_in_any_split((width, pixels) in pixels(), piece in 1usize..40) {
        for encoding in ALL {
            let bitmap = from_pixels(width, encoding, &pixels);
            let bytes = encoded(&bitmap, encoding);
            let size = (width, bitmap.height_px);
            prop_assert_eq!(decoded(&bytes, encoding, size, piece), Ok((bitmap.rows.clone(), rows_crc32(&bitmap.rows))));
            // A device of another height: an error, or at least another CRC (blank rows cost RunGrey no byte). A CRC whose
            // register is 0, so that it ends as all ones, does not see blank rows: that of four lit bytes, for one.
            for height in [size.1 - 1, size.1 + 1] {
                let other = decoded(&bytes, encoding, (width, height), piece);
                let crc32 = rows_crc32(&bitmap.rows);
                prop_assert!(crc32 == u32::MAX || other.map_or(true, |(_, other_crc32)| other_crc32 != crc32));
            }
            // A byte missing or one too many: always an error.
            prop_assert!(decoded(&bytes[..bytes.len() - 1], encoding, size, piece).is_err(), "{:?} cut", encoding);
            let longer = [&bytes[..], &[0]].concat();
            prop_assert!(decoded(&longer, encoding, size, piece).is_err(), "{:?} longer", encoding);
            prop_assert!(bytes.len() as u64 <= largest_encoded_bytes(encoding, bitmap.rows.len() as u64));
        }
    }

    #[test]
    fn group_4_is_what_another_coder_writes_and_reads((width, pixels) in pixels()) {
        use fax::{Color, VecWriter, decoder, encoder::Encoder};
        let bitmap = from_pixels(width, PictureEncoding::Group4, &pixels);
        let ours = encoded(&bitmap, PictureEncoding::Group4);

        let mut rows = Vec::new();
        let height = bitmap.height_px;
        let read = decoder::decode_g4(ours.iter().copied(), width, Some(height), |changes| {
            rows.extend(decoder::pels(changes, width).map(|color| if color == Color::Black { 255 } else { 0 }));
        });
        prop_assert!(read.is_some());
        prop_assert_eq!(from_pixels(width, PictureEncoding::Group4, &rows), bitmap.clone());

        let mut theirs = Encoder::new(VecWriter::new());
        for row in pixels.chunks(width as usize) {
            let colors = row.iter().map(|pixel| if *pixel > 127 { Color::Black } else { Color::White });
            let Ok(()) = theirs.encode_line(colors, width);
        }
        let Ok(writer) = theirs.finish();
        let read = decoded(&writer.finish(), PictureEncoding::Group4, (width, height), 7);
        prop_assert_eq!(read.map(|(rows, _)| rows), Ok(bitmap.rows));
    }

    #[test]
    fn garbage_ends_in_an_error_or_a_picture_never_a_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..400), piece in 1usize..50, width in 0u32..200, height in 0u32..20,
    ) {
        for encoding in ALL {
            let _ = decoded(&bytes, encoding, (width, height), piece);
        }
    }

    #[test]
    fn a_damaged_byte_is_an_error_or_another_crc((width, pixels) in pixels(), place: prop::sample::Index, flip in 1u8..) {
        for encoding in [PictureEncoding::Group4, PictureEncoding::RunGrey] {
            let bitmap = from_pixels(width, encoding, &pixels);
            let mut bytes = encoded(&bitmap, encoding);
            let place = place.index(bytes.len());
            bytes[place] ^= flip;
            if let Ok((rows, crc32)) = decoded(&bytes, encoding, (width, bitmap.height_px), 16) {
                prop_assert!(rows == bitmap.rows || crc32 != rows_crc32(&bitmap.rows));
            }
        }
    }
}

/// Do not change these bytes: devices in the field decode them. The picture is 12 × 4.
#[test]
fn golden_bytes() {
    #[rustfmt::skip]
    let pixels = [
        0, 0, 0, 0,   0,   0,   0,   0,   0, 0, 0, 0,
        0, 0, 0, 64,  255, 255, 255, 192, 0, 0, 0, 0,
        0, 0, 0, 128, 255, 255, 255, 128, 0, 0, 0, 255,
        0, 0, 0, 192, 255, 255, 255, 64,  0, 0, 9, 255,
    ];
    let bit = from_pixels(12, PictureEncoding::RawBit, &pixels);
    let grey = from_pixels(12, PictureEncoding::RawGrey, &pixels);
    assert_eq!(encoded(&grey, PictureEncoding::RawGrey), pixels);
    let documented = include_str!("../../docs/encodings.md");
    for (bitmap, encoding, golden) in [
        (&bit, PictureEncoding::RawBit, "00 00 0f 00 1f 10 1e 10"),
        (&bit, PictureEncoding::Group4, "9b 75 5a c0 04 00 40"),
        (&grey, PictureEncoding::RunGrey, "51 21 d9 fe 00 fc a9 1f 1b 23 05 80 76 af 1c c0 00 00"),
    ] {
        assert_eq!(hex(&encoded(bitmap, encoding)), golden, "{encoding:?}");
        assert!(documented.contains(&format!("`{golden}`")), "{encoding:?}: docs/encodings.md gives other bytes");
    }
    assert_eq!((rows_crc32(&bit.rows), rows_crc32(&grey.rows)), (1239328446, 3626837714));
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

#[test]
fn blank_and_straight_layers_take_next_to_nothing() {
    let blank = encoded(&from_pixels(3840, PictureEncoding::RunGrey, &vec![0; 3840 * 2160]), PictureEncoding::RunGrey);
    assert!(blank.len() <= 8, "{} bytes", blank.len());
    // Upright bars with grey edges: every row is the row above.
    let row: Vec<u8> = [vec![0; 20], vec![90], vec![255; 12], vec![201, 17]].concat();
    let row: Vec<u8> = row.into_iter().cycle().take(980).collect();
    let bars = encoded(&from_pixels(980, PictureEncoding::RunGrey, &row.repeat(500)), PictureEncoding::RunGrey);
    assert!(bars.len() < 2000, "{} bytes", bars.len());
}

#[test]
fn rows_longer_than_a_zone_come_back() {
    let mut row = vec![0; 200_001];
    row[70_000..199_000].fill(255);
    row[199_000] = 40;
    let mut other = row.clone();
    other[150_000] = 3;
    let bitmap = from_pixels(200_001, PictureEncoding::RunGrey, &[row.clone(), row, other].concat());
    let bytes = encoded(&bitmap, PictureEncoding::RunGrey);
    let read = decoded(&bytes, PictureEncoding::RunGrey, (200_001, 3), 5);
    assert_eq!(read.map(|(rows, _)| rows == bitmap.rows), Ok(true));
}

/// Pictures that no encoding was made for; the sizes include the narrowest, where a row's first code weighs most.
#[test]
fn no_picture_takes_more_than_the_stated_bytes() {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut noise = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u8
    };
    for (width, height) in [(1, 1), (1, 64), (2, 9), (7, 33), (8, 64), (16, 64), (17, 5), (640, 96), (4096, 16)] {
        let size = width as usize * height as usize;
        let at = |index: usize| (index % width as usize, index / width as usize);
        let drawn =
            |pixel: &dyn Fn(usize, usize) -> u8| -> Vec<u8> { (0..size).map(at).map(|(x, y)| pixel(x, y)).collect() };
        let lit = |is_lit: bool| if is_lit { 255 } else { 0 };
        let pictures = [
            (0..size).map(|_| noise()).collect(),
            (0..size).map(|_| noise() | 1).collect(),
            (0..size).map(|_| lit(noise() > 127)).collect(),
            (0..size).map(|_| if noise() > 200 { noise() } else { 0 }).collect(),
            drawn(&|x, _| lit(x % 2 == 0)),
            drawn(&|x, _| lit(x % 2 == 1)),
            drawn(&|x, y| lit((x + y) % 2 == 0)),
            drawn(&|x, y| lit(y % 2 == 0 && x % 2 == 0)),
            // Every other pixel grey below a blank row: each breaks a run as long as the row.
            drawn(&|x, y| if y % 2 == 1 && x % 2 == 1 { 1 + (x * 77 + y * 31) as u8 % 254 } else { 0 }),
            drawn(&|x, y| if (x + y) % 2 == 1 { 1 } else { 254 }),
            // Changes that lie three pixels left of those above, the dearest vertical codes of Group 4.
            drawn(&|x, y| lit((x + 3 * y) % 8 < 4)),
            drawn(&|x, y| lit(matches!((x + 3 * y) % 6, 0 | 1 | 3))),
        ];
        for (number, pixels) in pictures.iter().enumerate() {
            for encoding in [PictureEncoding::Group4, PictureEncoding::RunGrey] {
                let bitmap = from_pixels(width, encoding, pixels);
                let bytes = encoded(&bitmap, encoding);
                let most = largest_encoded_bytes(encoding, bitmap.rows.len() as u64);
                assert!(
                    bytes.len() as u64 <= most,
                    "{encoding:?} {number} {width}x{height}: {} of {most}",
                    bytes.len()
                );
                let read = decoded(&bytes, encoding, (width, height), 64);
                assert_eq!(read.map(|(rows, _)| rows == bitmap.rows), Ok(true), "{encoding:?} {number}");
            }
        }
    }
}

#[test]
fn rows_that_are_not_whole_are_refused() {
    let error = encode(PictureEncoding::Group4, 12, &[0; 3], &mut Vec::new());
    assert_eq!(error, Err(PartialRow { bytes: 3, row_bytes: 2 }));
    for encoding in ALL {
        assert_eq!(encode(encoding, 0, &[], &mut Vec::new()), Ok(()), "an empty picture");
    }
}

/// Every run length that has a code of its own, and the longest code of several parts, in both colours.
#[test]
fn every_run_length_comes_back_and_is_what_another_coder_writes() {
    use fax::{Color, VecWriter, encoder::Encoder};
    let width = 6000;
    for run in (0..130).chain((128..=5440).step_by(64)).chain([2559, 2561, 5119, 5120, 5121]) {
        // Row by row lit and dark runs of this length, far from any change above.
        let first: Vec<u8> = (0..width).map(|x| if x >= 10 && x < 10 + run { 255 } else { 0 }).collect();
        let second: Vec<u8> = (0..width).map(|x| if x >= run && x < run + 300 { 255 } else { 0 }).collect();
        let blank = vec![0; width];
        let pixels = [&blank[..], &first, &blank, &second].concat();
        let bitmap = from_pixels(width as u32, PictureEncoding::Group4, &pixels);
        let ours = encoded(&bitmap, PictureEncoding::Group4);
        let read = decoded(&ours, PictureEncoding::Group4, (width as u32, 4), 16);
        assert_eq!(read.map(|(rows, _)| rows == bitmap.rows), Ok(true), "run {run}");
        let mut theirs = Encoder::new(VecWriter::new());
        for row in pixels.chunks(width) {
            let colors = row.iter().map(|pixel| if *pixel > 127 { Color::Black } else { Color::White });
            let Ok(()) = theirs.encode_line(colors, width as u32);
        }
        let Ok(writer) = theirs.finish();
        assert_eq!(ours, writer.finish(), "run {run}");
    }
}
