//! How layers are encoded for a device: the best encoding that it decodes, and how many bytes that takes. `wire/tests/encoding.rs` tests
//! the encodings themselves.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use layerd::device::encoding::{
    BEST_VECTORS, Choice, choose, choose_vectors, encode, encode_shortest, encode_vectors, largest_encoded_bytes,
};
use layerd::layer::{Bitmap, Depth, HatchLine, Mark, MarkClass, Vectors, hatch_frame};
use layerd::link::message::Encoding;
use layerd_wire::encoding::{LaserParameters, LayerSum, VectorDecoder, VectorEncodeError, VectorEncoding};

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

const FIELD_UM: [u32; 2] = [100_000, 100_000];

fn lasers() -> [LaserParameters; 6] {
    [100, 200, 180, 120, 90, 50]
        .map(|power_w| LaserParameters { power_mw: power_w * 1000, ..LaserParameters::default() })
}

/// What a device reads of bytes.
fn read_vectors(bytes: &[u8], encoding: VectorEncoding) -> (Vec<Mark>, LayerSum) {
    let mut decoder = VectorDecoder::new(encoding, FIELD_UM, bytes.len() as u32);
    let mut marks = Vec::new();
    for mut piece in bytes.chunks(60) {
        while let Some(vector) = decoder.next(&mut piece).expect("good bytes") {
            marks.push(Mark { class: vector.class, from_um: vector.from_um, to_um: vector.to_um });
        }
    }
    for Mark { class, .. } in &marks {
        assert_eq!(decoder.parameters(*class), Some(&lasers()[*class as usize]));
    }
    (marks, decoder.finish().expect("a whole layer"))
}

#[test]
fn a_device_reads_the_vectors_of_the_layer_and_the_lasers_of_the_classes_used() {
    let mut vectors = Vectors::default();
    for point in 0..5 {
        vectors.push_path(if point == 3 { MarkClass::Thin } else { MarkClass::Point }, &[[point * 300, 7]]);
    }
    vectors.push_path(MarkClass::Thin, &[[5, 5], [900, 20], [1000, 90]]);
    for (index, angle_deg) in [0.0, 67.0, 134.0, 201.0, 268.0, -35.5].into_iter().enumerate() {
        let frame = hatch_frame([50_000 - index as i32, 50_000], angle_deg, 61_235);
        let line = |line: i32| {
            let (from_um, to_um) = (-9000 + line * line, 7000 - line * 40);
            if line % 2 == 0 {
                HatchLine { line, from_um, to_um }
            } else {
                HatchLine { line, from_um: to_um, to_um: from_um }
            }
        };
        vectors.push_hatches(MarkClass::UpSkin, frame, &(-100..100).map(line).collect::<Vec<_>>());
        vectors.push_path(MarkClass::Contour, &[[9, 9], [9, 90], [90, 9], [9, 9]]);
    }
    let mut bytes = Vec::new();
    for (encoding, lasers_only) in [(VectorEncoding::Plain, 1), (VectorEncoding::Coded, 0)] {
        let sent = encode_vectors(&vectors, encoding, FIELD_UM, &lasers(), &mut bytes).expect("all lies in the field");
        let (marks, sum) = read_vectors(&bytes, encoding);
        assert_eq!(sum, sent);
        assert!(marks.iter().copied().eq(vectors.marks()), "{encoding:?}");
        assert_eq!(bytes[0] * lasers_only, 4 * lasers_only, "contour, up-skin, thin and point");
    }
    vectors.push_path(MarkClass::Contour, &[[100_001, 0]]);
    let error = encode_vectors(&vectors, VectorEncoding::Plain, FIELD_UM, &lasers(), &mut bytes);
    assert_eq!(error, Err(VectorEncodeError::OutsideField { point_um: [100_001, 0], field_um: FIELD_UM }));

    let offered = [Encoding::RawBit, Encoding::Vectors];
    assert_eq!(choose_vectors(&offered), Some(Choice { encoding: Encoding::Vectors, raw: None }));
    assert_eq!(choose_vectors(&[Encoding::VectorsCoded, Encoding::Vectors]), Some(BEST_VECTORS));
    assert_eq!(choose_vectors(&[Encoding::Group4]), None);
    let error = encode(&Bitmap::new(8, 8, Depth::Bit), Encoding::Vectors, &mut bytes).expect_err("a picture");
    assert_eq!(error.to_string(), "a picture of Bit pixels cannot be written as Vectors");
}

/// Sections of struts as a lattice has them: islands 120 to 400 µm wide, corners every 30 to 100 µm, hatches of 60 µm.
fn lattice_vectors() -> Vectors {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |least: f64, most: f64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        least + (most - least) * (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut vectors = Vectors::default();
    let frame = hatch_frame([0, 0], 67.0, 60_000);
    let (sin, cos) = 67.0_f64.to_radians().sin_cos();
    for island in 0..900 {
        // Along rows, forth and back.
        let (row, column) = (island / 30, island % 30);
        let column = if row % 2 == 0 { column } else { 29 - column };
        let x = 2000.0 + 1300.0 * f64::from(column) + random(-300.0, 300.0);
        let y = 2000.0 + 1300.0 * f64::from(row) + random(-300.0, 300.0);
        let (long, wide, turn) = (random(60.0, 200.0), random(60.0, 120.0), random(0.0, 3.0));
        let at = |angle: f64, wobble: f64| {
            let (u, v) = (long * angle.cos() + wobble, wide * angle.sin());
            [(x + u * turn.cos() - v * turn.sin()).round() as i32, (y + u * turn.sin() + v * turn.cos()).round() as i32]
        };
        let (mut ring, mut angle) = (Vec::new(), 0.0);
        while angle < std::f64::consts::TAU - 0.2 {
            ring.push(at(angle, random(-3.0, 3.0)));
            angle += random(30.0, 100.0) / f64::max(long, wide);
        }
        ring.push(ring[0]);
        vectors.push_path(MarkClass::Contour, &ring);
        if wide < 100.0 {
            continue;
        }
        // The chords of a disc of 75 µm less than the width stand for those of the offset ring.
        let (along, across, radius) = (x * cos + y * sin, y * cos - x * sin, wide + 15.0);
        let lines = ((across - radius) / 60.0).ceil() as i32..=((across + radius) / 60.0).floor() as i32;
        let hatches = lines.filter_map(|line| {
            let half = (radius * radius - (f64::from(line) * 60.0 - across).powi(2)).sqrt() + random(-20.0, 20.0);
            let (from_um, to_um) = ((along - half) as i32, (along + half) as i32);
            let turned = if line % 2 == 0 { (from_um, to_um) } else { (to_um, from_um) };
            (half > 25.0).then_some(HatchLine { line, from_um: turned.0, to_um: turned.1 })
        });
        vectors.push_hatches(MarkClass::Hatch, frame, &hatches.collect::<Vec<_>>());
    }
    vectors
}

#[test]
fn a_layer_of_a_lattice_takes_at_most_3_2_bytes_a_vector_and_2_2_coded() {
    let vectors = lattice_vectors();
    let count = vectors.mark_count() as f64;
    let mut bytes = Vec::new();
    for (encoding, most) in [(VectorEncoding::Plain, 3.2), (VectorEncoding::Coded, 2.2)] {
        encode_vectors(&vectors, encoding, FIELD_UM, &lasers(), &mut bytes).expect("all lies in the field");
        assert!(read_vectors(&bytes, encoding).0.into_iter().eq(vectors.marks()));
        let each = bytes.len() as f64 / count;
        println!("{encoding:?}: {each:.2} bytes for each of {count} vectors");
        assert!(each <= most, "{encoding:?}: {each:.2} bytes a vector");
    }
}
