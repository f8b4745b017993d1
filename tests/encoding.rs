//! Layer encodings: what goes in comes out, in any split; the bytes are the documented ones; garbage ends in an error.

mod properties;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use layerd::device::encoding::{
    Choice, DecodeError, Decoder, choose, encode, encode_shortest, largest_encoded_bytes, picture_crc32,
};
use layerd::layer::{Bitmap, Depth};
use layerd::link::message::Encoding;
use proptest::prelude::*;

const ALL: [Encoding; 4] = [Encoding::RawBit, Encoding::Group4, Encoding::RawGrey, Encoding::RunGrey];

fn encoded(bitmap: &Bitmap, encoding: Encoding) -> Vec<u8> {
    let mut bytes = vec![0xee; 3];
    encode(bitmap, encoding, &mut bytes).expect("the depth fits");
    bytes
}

fn decoded(bytes: &[u8], encoding: Encoding, size: (u32, u32), piece: usize) -> Result<(Bitmap, u32), DecodeError> {
    let mut decoder = Decoder::new(encoding, size.0, size.1);
    for piece in bytes.chunks(piece) {
        decoder.push(piece)?;
    }
    decoder.finish()
}

fn from_pixels(width_px: u32, depth: Depth, pixels: &[u8]) -> Bitmap {
    let mut bitmap = Bitmap::new(width_px, pixels.len() as u32 / width_px, depth);
    let stride = bitmap.stride_bytes();
    match depth {
        Depth::Grey => bitmap.data_mut().copy_from_slice(pixels),
        Depth::Bit => {
            for (index, _) in pixels.iter().enumerate().filter(|(_, pixel)| **pixel > 127) {
                let (x, y) = (index % width_px as usize, index / width_px as usize);
                bitmap.data_mut()[y * stride + x / 8] |= 0x80 >> (x % 8);
            }
        }
    }
    bitmap
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
            let depth = if matches!(encoding, Encoding::RawBit | Encoding::Group4) { Depth::Bit } else { Depth::Grey };
            let bitmap = from_pixels(width, depth, &pixels);
            let bytes = encoded(&bitmap, encoding);
            let size = (width, bitmap.height_px());
            prop_assert_eq!(decoded(&bytes, encoding, size, piece), Ok((bitmap.clone(), picture_crc32(&bitmap))));
            // A device of another height: an error, or at least another CRC (blank rows cost RunGrey no byte). A CRC whose
            // register is 0, so that it ends as all ones, does not see blank rows: that of four lit bytes, for one.
            for height in [size.1 - 1, size.1 + 1] {
                let other = decoded(&bytes, encoding, (width, height), piece);
                let crc32 = picture_crc32(&bitmap);
                prop_assert!(crc32 == u32::MAX || other.map_or(true, |(_, other_crc32)| other_crc32 != crc32));
            }
            // A byte missing or one too many: always an error.
            prop_assert!(decoded(&bytes[..bytes.len() - 1], encoding, size, piece).is_err(), "{:?} cut", encoding);
            let longer = [&bytes[..], &[0]].concat();
            prop_assert!(decoded(&longer, encoding, size, piece).is_err(), "{:?} longer", encoding);
            prop_assert!(bytes.len() as u64 <= largest_encoded_bytes(depth, bitmap.data().len() as u64));
        }
    }

    #[test]
    fn group_4_is_what_another_coder_writes_and_reads((width, pixels) in pixels()) {
        use fax::{Color, VecWriter, decoder, encoder::Encoder};
        let bitmap = from_pixels(width, Depth::Bit, &pixels);
        let ours = encoded(&bitmap, Encoding::Group4);

        let mut rows = Vec::new();
        let height = bitmap.height_px();
        let read = decoder::decode_g4(ours.iter().copied(), width, Some(height), |changes| {
            rows.extend(decoder::pels(changes, width).map(|color| if color == Color::Black { 255 } else { 0 }));
        });
        prop_assert!(read.is_some());
        prop_assert_eq!(from_pixels(width, Depth::Bit, &rows), bitmap.clone());

        let mut theirs = Encoder::new(VecWriter::new());
        for row in pixels.chunks(width as usize) {
            let colors = row.iter().map(|pixel| if *pixel > 127 { Color::Black } else { Color::White });
            let Ok(()) = theirs.encode_line(colors, width);
        }
        let Ok(writer) = theirs.finish();
        let read = decoded(&writer.finish(), Encoding::Group4, (width, height), 7);
        prop_assert_eq!(read.map(|(picture, _)| picture), Ok(bitmap));
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
        for (encoding, depth) in [(Encoding::Group4, Depth::Bit), (Encoding::RunGrey, Depth::Grey)] {
            let bitmap = from_pixels(width, depth, &pixels);
            let mut bytes = encoded(&bitmap, encoding);
            let place = place.index(bytes.len());
            bytes[place] ^= flip;
            if let Ok((picture, crc32)) = decoded(&bytes, encoding, (width, bitmap.height_px()), 16) {
                prop_assert!(picture == bitmap || crc32 != picture_crc32(&bitmap));
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
    let bit = from_pixels(12, Depth::Bit, &pixels);
    let grey = from_pixels(12, Depth::Grey, &pixels);
    assert_eq!(encoded(&grey, Encoding::RawGrey), pixels);
    let documented = include_str!("../docs/encodings.md");
    for (bitmap, encoding, golden) in [
        (&bit, Encoding::RawBit, "00 00 0f 00 1f 10 1e 10"),
        (&bit, Encoding::Group4, "9b 75 5a c0 04 00 40"),
        (&grey, Encoding::RunGrey, "51 21 d9 fe 00 fc a9 1f 1b 23 05 80 76 af 1c c0 00 00"),
    ] {
        assert_eq!(hex(&encoded(bitmap, encoding)), golden, "{encoding:?}");
        assert!(documented.contains(&format!("`{golden}`")), "{encoding:?}: docs/encodings.md gives other bytes");
    }
    assert_eq!((picture_crc32(&bit), picture_crc32(&grey)), (1239328446, 3626837714));
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

#[test]
fn the_depth_must_fit_and_the_best_offered_encoding_is_chosen() {
    let grey = Bitmap::new(8, 8, Depth::Grey);
    let error = encode(&grey, Encoding::Group4, &mut Vec::new()).expect_err("grey is not bits");
    assert_eq!(error.to_string(), "a picture of Grey pixels cannot be written as Group4");
    let choice = |encoding, raw| Some(Choice { encoding, raw });
    assert_eq!(choose(Depth::Bit, &ALL), choice(Encoding::Group4, Some(Encoding::RawBit)));
    assert_eq!(choose(Depth::Grey, &ALL), choice(Encoding::RunGrey, Some(Encoding::RawGrey)));
    assert_eq!(choose(Depth::Bit, &[Encoding::Group4]), choice(Encoding::Group4, None));
    let raw_only = choose(Depth::Grey, &[Encoding::RawBit, Encoding::RawGrey]);
    assert_eq!(raw_only, choice(Encoding::RawGrey, Some(Encoding::RawGrey)));
    assert_eq!(choose(Depth::Grey, &[Encoding::Group4]), None);
}

#[test]
fn a_layer_that_packs_badly_goes_raw_where_the_device_decodes_that() {
    let mut chequered = Bitmap::new(64, 8, Depth::Bit);
    for (row, bytes) in chequered.data_mut().chunks_exact_mut(8).enumerate() {
        bytes.fill(if row % 2 == 0 { 0xaa } else { 0x55 });
    }
    let mut bytes = Vec::new();
    let raw_too = Choice { encoding: Encoding::Group4, raw: Some(Encoding::RawBit) };
    assert_eq!(encode_shortest(&chequered, raw_too, &mut bytes), Ok(Encoding::RawBit));
    assert_eq!(bytes, chequered.data());
    let packed_only = Choice { raw: None, ..raw_too };
    assert_eq!(encode_shortest(&chequered, packed_only, &mut bytes), Ok(Encoding::Group4));
    assert!(bytes.len() > chequered.data().len());
}

/// A layer through a lattice: ellipses of struts cut at many angles, edges smoothed over a pixel.
fn lattice_layer(width: u32, height: u32) -> Vec<u8> {
    let mut pixels = vec![0u8; (width * height) as usize];
    let cell = 48.0;
    let (columns, rows) = ((f64::from(width) / cell) as i32, (f64::from(height) / cell) as i32);
    for (column, row) in (0..columns).flat_map(|c| (0..rows).map(move |r| (c, r))) {
        // Angles and lengths that no two neighbours share.
        let turn = f64::from(column * 7 + row * 13) * 0.37;
        let (long, short) =
            (10.0 + f64::from((column * 5 + row * 3) % 9), 6.5 + 0.3 * f64::from((column + 2 * row) % 5));
        let centre =
            (f64::from(column) * cell + 24.0 + turn.sin() * 4.0, f64::from(row) * cell + 24.0 + turn.cos() * 4.0);
        for (dx, dy) in (-22..22).flat_map(|x| (-22..22).map(move |y| (x, y))) {
            let (x, y) = (centre.0.floor() + f64::from(dx), centre.1.floor() + f64::from(dy));
            let (px, py) = (x - centre.0, y - centre.1);
            let (u, v) = ((px * turn.cos() + py * turn.sin()) / long, (py * turn.cos() - px * turn.sin()) / short);
            let radius = u.hypot(v).max(1e-9);
            // Distance by the first-order formula: the field over its gradient.
            let distance = (radius - 1.0) * radius / (u / long).hypot(v / short).max(1e-9);
            let value = ((0.5 - distance) * 255.0).round().clamp(0.0, 255.0) as u8;
            if (0.0..f64::from(width)).contains(&x) && (0.0..f64::from(height)).contains(&y) {
                let pixel = &mut pixels[y as usize * width as usize + x as usize];
                *pixel = (*pixel).max(value);
            }
        }
    }
    pixels
}

fn best_png_bytes(width: u32, height: u32, pixels: &[u8], colour: ExtendedColorType) -> usize {
    let filters = [FilterType::NoFilter, FilterType::Sub, FilterType::Up, FilterType::Paeth, FilterType::Adaptive];
    let size = |filter| {
        let mut bytes = Vec::new();
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, filter)
            .write_image(pixels, width, height, colour)
            .expect("a PNG");
        bytes.len()
    };
    filters.into_iter().map(size).min().expect("several filters")
}

#[test]
fn a_lattice_layer_takes_fewer_bytes_than_the_best_png() {
    let (width, height) = (960, 540);
    let pixels = lattice_layer(width, height);
    let grey = encoded(&from_pixels(width, Depth::Grey, &pixels), Encoding::RunGrey).len();
    let bit = encoded(&from_pixels(width, Depth::Bit, &pixels), Encoding::Group4).len();
    let hard: Vec<u8> = pixels.iter().map(|pixel| if *pixel > 127 { 255 } else { 0 }).collect();
    let grey_png = best_png_bytes(width, height, &pixels, ExtendedColorType::L8);
    let bit_png = best_png_bytes(width, height, &hard, ExtendedColorType::L8);
    println!("1-bit: {bit} of {bit_png} bytes; grey: {grey} of {grey_png} bytes");
    // Many small sections of every slope, close together: about the hardest a lattice offers. Measured: 0.386 and 0.533.
    assert!(bit * 100 <= bit_png * 40, "1-bit: {bit} of {bit_png}");
    assert!(grey * 100 <= grey_png * 55, "grey: {grey} of {grey_png}");
}

#[test]
fn blank_and_straight_layers_take_next_to_nothing() {
    let blank = encoded(&Bitmap::new(3840, 2160, Depth::Grey), Encoding::RunGrey);
    assert!(blank.len() <= 8, "{} bytes", blank.len());
    // Upright bars with grey edges: every row is the row above.
    let row: Vec<u8> = [vec![0; 20], vec![90], vec![255; 12], vec![201, 17]].concat();
    let row: Vec<u8> = row.into_iter().cycle().take(980).collect();
    let bars = encoded(&from_pixels(980, Depth::Grey, &row.repeat(500)), Encoding::RunGrey);
    assert!(bars.len() < 2000, "{} bytes", bars.len());
}

#[test]
fn rows_longer_than_a_zone_come_back() {
    let mut row = vec![0; 200_001];
    row[70_000..199_000].fill(255);
    row[199_000] = 40;
    let mut other = row.clone();
    other[150_000] = 3;
    let bitmap = from_pixels(200_001, Depth::Grey, &[row.clone(), row, other].concat());
    let bytes = encoded(&bitmap, Encoding::RunGrey);
    let read = decoded(&bytes, Encoding::RunGrey, (200_001, 3), 5);
    assert_eq!(read.map(|(picture, _)| picture == bitmap), Ok(true));
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
            for (depth, encoding) in [(Depth::Bit, Encoding::Group4), (Depth::Grey, Encoding::RunGrey)] {
                let bitmap = from_pixels(width, depth, pixels);
                let (bytes, most) =
                    (encoded(&bitmap, encoding), largest_encoded_bytes(depth, bitmap.data().len() as u64));
                assert!(
                    bytes.len() as u64 <= most,
                    "{encoding:?} {number} {width}x{height}: {} of {most}",
                    bytes.len()
                );
                let read = decoded(&bytes, encoding, (width, height), 64);
                assert_eq!(read.map(|(picture, _)| picture == bitmap), Ok(true), "{encoding:?} {number}");
            }
        }
    }
}
