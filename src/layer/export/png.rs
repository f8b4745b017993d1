//! A layer as a PNG file: what `layerctl slice` writes, alone and in an `.sl1`, and what a simulated device writes of what it exposed.
//!
//! One encoder for both, so that equal layers are equal files. Always 8-bit grey, 0 dark and 255 lit: every viewer and
//! library reads that, and deflate leaves nothing of the unused bits.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::layer::{Bitmap, Depth};
use crate::output::Output;

/// Writes a layer as 8-bit grey. The file appears whole or not at all, whatever ends the program.
///
/// # Errors
/// Whatever the file system says; nothing is left behind then.
pub fn write_png(path: &Path, bitmap: &Bitmap) -> io::Result<()> {
    let output = Output::create(path)?;
    let mut file = BufWriter::new(output.file());
    encode(&mut file, bitmap)?;
    file.flush()?;
    drop(file);
    output.publish()
}

/// Colours of materials, which people with any kind of colour vision tell apart (Okabe and Ito 2008, without black).
const COLOURS: [[u8; 3]; 8] = [
    [230, 159, 0],
    [86, 180, 233],
    [0, 158, 115],
    [240, 228, 66],
    [0, 114, 178],
    [213, 94, 0],
    [204, 121, 167],
    [255, 255, 255],
];

/// Writes the masks of a layer, of up to eight materials, as one picture in colour. The file appears whole or not at all.
///
/// # Errors
/// As [`write_png`].
pub fn write_colours(path: &Path, masks: &[Bitmap]) -> io::Result<()> {
    let Some(first) = masks.first() else { return Ok(()) };
    let mut pixels = vec![0; 3 * first.width_px() as usize * first.height_px() as usize];
    for (mask, colour) in masks.iter().zip(COLOURS) {
        let grey = match mask.depth() {
            Depth::Grey => mask.data().to_vec(),
            Depth::Bit => grey_of_bits(mask),
        };
        for (pixel, grey) in pixels.as_chunks_mut::<3>().0.iter_mut().zip(grey).filter(|(_, grey)| *grey > 0) {
            *pixel = colour.map(|part| (u16::from(part) * u16::from(grey) / 255) as u8);
        }
    }
    let output = Output::create(path)?;
    let mut file = BufWriter::new(output.file());
    let encoder = PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Up);
    let (width_px, height_px) = (first.width_px(), first.height_px());
    encoder.write_image(&pixels, width_px, height_px, ExtendedColorType::Rgb8).map_err(io_error)?;
    file.flush()?;
    drop(file);
    output.publish()
}

/// Writes a layer's bytes.
pub(super) fn encode(file: &mut impl Write, bitmap: &Bitmap) -> io::Result<()> {
    // Layers are long runs: the fast setting with the filter against the row above is both quick and small.
    let encoder = PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Up);
    let (width_px, height_px) = (bitmap.width_px(), bitmap.height_px());
    let written = match bitmap.depth() {
        Depth::Grey => encoder.write_image(bitmap.data(), width_px, height_px, ExtendedColorType::L8),
        Depth::Bit => encoder.write_image(&grey_of_bits(bitmap), width_px, height_px, ExtendedColorType::L8),
    };
    written.map_err(io_error)
}

fn io_error(error: image::ImageError) -> io::Error {
    match error {
        image::ImageError::IoError(error) => error,
        other => io::Error::other(other),
    }
}

/// Grey values of the eight pixels of each byte.
const GREY_OF_BYTE: [[u8; 8]; 256] = {
    let mut table = [[0; 8]; 256];
    let mut number = 0;
    while number < 8 * 256 {
        let (byte, bit) = (number / 8, number % 8);
        table[byte][bit] = if byte & (0x80 >> bit) != 0 { 255 } else { 0 };
        number += 1;
    }
    table
};

fn grey_of_bits(bitmap: &Bitmap) -> Vec<u8> {
    let width = bitmap.width_px() as usize;
    let mut grey = Vec::with_capacity(width * bitmap.height_px() as usize + 8);
    for (row, bytes) in bitmap.data().chunks_exact(bitmap.stride_bytes().max(1)).enumerate() {
        bytes[..width.div_ceil(8)].iter().for_each(|byte| grey.extend_from_slice(&GREY_OF_BYTE[usize::from(*byte)]));
        // The last byte of a row may have pixels to spare.
        grey.truncate((row + 1) * width);
    }
    grey
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_depths_read_back_pixel_for_pixel() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("layer_000000.png");
        let mut bits = Bitmap::new(11, 2, Depth::Bit);
        bits.data_mut().copy_from_slice(&[0b1010_0000, 0b0010_0000, 0, 0b1000_0000]);
        write_png(&path, &bits).expect("written");
        let read = image::open(&path).expect("a PNG").into_luma8();
        let lit: Vec<_> = read.enumerate_pixels().filter(|(.., p)| p.0[0] == 255).map(|(x, y, _)| (x, y)).collect();
        assert_eq!((read.dimensions(), lit), ((11, 2), vec![(0, 0), (2, 0), (10, 0), (8, 1)]));

        let mut grey = Bitmap::new(3, 2, Depth::Grey);
        grey.data_mut().copy_from_slice(&[0, 1, 255, 128, 254, 7]);
        write_png(&path, &grey).expect("replaced");
        assert_eq!(image::open(&path).expect("a PNG").into_luma8().into_raw(), grey.data());
        assert_eq!(std::fs::read_dir(directory.path()).expect("listed").count(), 1, "no part is left");
    }

    #[test]
    fn a_failed_write_leaves_nothing_behind() {
        let directory = tempfile::tempdir().expect("a directory");
        let missing = directory.path().join("missing").join("layer_000000.png");
        assert!(write_png(&missing, &Bitmap::new(8, 8, Depth::Bit)).is_err());
        let taken = directory.path().join("layer_000001.png");
        std::fs::create_dir(&taken).expect("a directory in the way");
        assert!(write_png(&taken, &Bitmap::new(8, 8, Depth::Bit)).is_err());
        assert_eq!(std::fs::read_dir(directory.path()).expect("listed").count(), 1);
    }
}
