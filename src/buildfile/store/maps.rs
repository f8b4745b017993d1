//! Height maps in a build file: grey PNG files, one after another behind the header. `reader` and `writer` use it.

use std::io::Cursor;

use crate::buildfile::relief::MapHeader;
use crate::solid::HeightMap;

/// Most columns and rows of a map: more than any scanner or program makes.
pub(in crate::buildfile) const MAX_SIDE: u32 = 1 << 15;

/// Most bytes that the PNG decoder takes for what a file says beside its texels, and for a row.
const DECODER_LIMIT_BYTES: usize = 512 << 10;

/// Memory of decoding a map of so many columns, besides the map, bytes: the decoder's window and what it has decoded ahead, a few rows of up
/// to 2 bytes a texel, and two rows of sums.
pub(crate) fn decoding_bytes(columns: u32) -> u64 {
    (1 << 20) + 32 * u64::from(columns)
}

/// Encodes a map whose texels are of 8 bits if all of them are multiples of 257, of 16 bits otherwise.
///
/// # Errors
/// A text if the encoder fails.
pub(in crate::buildfile) fn encode(size: [u32; 2], texels: &[u16]) -> Result<Vec<u8>, String> {
    let is_small = texels.iter().all(|texel| texel % 257 == 0);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(if is_small { png::BitDepth::Eight } else { png::BitDepth::Sixteen });
    encoder.set_compression(png::Compression::High);
    let samples: Vec<u8> = if is_small {
        texels.iter().map(|texel| (texel >> 8) as u8).collect()
    } else {
        texels.iter().flat_map(|texel| texel.to_be_bytes()).collect()
    };
    let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
    writer.write_image_data(&samples).map_err(|error| error.to_string())?;
    writer.finish().map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// Decodes a map and halves it `level` times. Besides the map that comes out, at most [`decoding_bytes`] are taken.
///
/// # Errors
/// A text if the bytes are no such map.
pub(super) fn decode(bytes: &[u8], header: &MapHeader, level: u8) -> Result<HeightMap, String> {
    let limits = png::Limits { bytes: DECODER_LIMIT_BYTES };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let mut reader = decoder.read_info().map_err(|error| error.to_string())?;
    let info = reader.info();
    if [info.width, info.height] != header.size || info.color_type != png::ColorType::Grayscale || info.interlaced {
        return Err(format!("it is no grey map of {} × {} texels", header.size[0], header.size[1]));
    }
    let is_small = match info.bit_depth {
        png::BitDepth::Eight => true,
        png::BitDepth::Sixteen => false,
        other => return Err(format!("texels of {} bits", other as u8)),
    };
    let mut halving = Halving::new(header, level);
    while let Some(row) = reader.next_row().map_err(|error| error.to_string())? {
        if is_small {
            halving.add(row.data().iter().map(|texel| u16::from(*texel) * 257));
        } else {
            halving.add(row.data().as_chunks().0.iter().map(|texel| u16::from_be_bytes(*texel)));
        }
    }
    Ok(HeightMap::new(halving.size, header.tiles, header.is_nearest, halving.texels))
}

/// Averages texels over boxes, row by row.
struct Halving {
    /// Columns and rows of the map that is averaged.
    from: [usize; 2],
    size: [usize; 2],
    /// The next row.
    row: usize,
    /// Sums of the row of boxes that is being filled, weighted by area.
    sums: Vec<f64>,
    texels: Vec<u16>,
}

impl Halving {
    fn new(header: &MapHeader, level: u8) -> Self {
        let size = header.size_at(level);
        let texels = Vec::with_capacity(size[0] * size[1]);
        Self { from: header.size.map(|count| count as usize), size, row: 0, sums: vec![0.0; size[0]], texels }
    }

    /// Adds the next row of texels.
    fn add(&mut self, row: impl Iterator<Item = u16>) {
        if self.size == self.from {
            self.texels.extend(row);
            return;
        }
        let row: Vec<f64> = self.narrow(row);
        for (box_row, share) in shares(self.row, self.from[1], self.size[1]) {
            self.sums.iter_mut().zip(&row).for_each(|(sum, value)| *sum += share * value);
            // The row of boxes ends with this row of texels.
            if (self.row + 1) * self.size[1] >= (box_row + 1) * self.from[1] {
                self.texels.extend(self.sums.iter().map(|sum| sum.round() as u16));
                self.sums.fill(0.0);
            }
        }
        self.row += 1;
    }

    /// A row averaged over the columns of boxes.
    fn narrow(&self, row: impl Iterator<Item = u16>) -> Vec<f64> {
        let mut sums = vec![0.0; self.size[0]];
        for (column, texel) in row.enumerate() {
            for (place, share) in shares(column, self.from[0], self.size[0]) {
                sums[place] += share * f64::from(texel);
            }
        }
        sums
    }
}

/// The boxes that texel `at` of `from` lies in, if there are `to` boxes, not more than texels; and its share of each box.
fn shares(at: usize, from: usize, to: usize) -> impl Iterator<Item = (usize, f64)> {
    // In units of 1/from of a box.
    let [begin, end] = [at * to, (at + 1) * to];
    (begin / from..end.div_ceil(from)).map(move |place| {
        let length = end.min((place + 1) * from) - begin.max(place * from);
        (place, length as f64 / from as f64)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solid::Tile;

    fn header(size: [u32; 2]) -> MapHeader {
        MapHeader {
            size,
            tiles: [Tile::Wrap; 2],
            is_nearest: false,
            texel_um: 10.0,
            coarsest_level: 4,
            bytes: 0,
            crc: 0,
        }
    }

    #[test]
    fn maps_of_both_depths_come_back() {
        for step in [257_u16, 1] {
            let texels: Vec<u16> = (0..7 * 5).map(|at| at * step).collect();
            let bytes = encode([7, 5], &texels).expect("can be encoded");
            let map = decode(&bytes, &header([7, 5]), 0).expect("is whole");
            assert_eq!(map, HeightMap::new([7, 5], [Tile::Wrap; 2], false, texels));
            for cut in 0..bytes.len() {
                // A PNG may lack its end; the CRC of the build file is there for that.
                let _ = decode(&bytes[..cut], &header([7, 5]), 0);
            }
            assert!(decode(&bytes, &header([5, 7]), 0).is_err());
        }
    }

    #[test]
    fn halving_keeps_the_mean() {
        let texels: Vec<u16> = (0..13 * 9).map(|at| (at * 7919 % 65_521) as u16).collect();
        let bytes = encode([13, 9], &texels).expect("can be encoded");
        let mean = texels.iter().map(|texel| f64::from(*texel)).sum::<f64>() / (13.0 * 9.0);
        let one = decode(&bytes, &header([13, 9]), 4).expect("is whole");
        assert_eq!(one, HeightMap::new([1, 1], [Tile::Wrap; 2], false, vec![mean.round() as u16]));
        assert_eq!(header([13, 9]).size_at(1), [7, 5]);
        decode(&bytes, &header([13, 9]), 1).expect("is whole");
    }
}
