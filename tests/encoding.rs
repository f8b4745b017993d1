//! How layers are encoded for a device: the best encoding that it decodes, and how many bytes that takes. `wire/tests/encoding.rs` tests
//! the encodings themselves.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use layerd::device::encoding::{Choice, choose, encode, encode_shortest, largest_encoded_bytes};
use layerd::layer::{Bitmap, Depth};
use layerd::link::message::Encoding;

const ALL: [Encoding; 4] = [Encoding::RawBit, Encoding::Group4, Encoding::RawGrey, Encoding::RunGrey];

fn encoded(bitmap: &Bitmap, encoding: Encoding) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(bitmap, encoding, &mut bytes).expect("the depth fits");
    bytes
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
    // The memory budget counts on the dearest encoding of a depth.
    assert_eq!([Depth::Bit, Depth::Grey].map(|depth| largest_encoded_bytes(depth, 100)), [704, 204]);
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
