//! Pictures as height maps: PNG of 8 or 16 bits, of which one channel counts. `relief` collects them.

use std::io::{BufRead, Seek};

use crate::buildfile::relief::{MapHeader, Tile};
use crate::buildfile::store::MAX_MAP_SIDE;
use crate::text::size_text;

/// Which samples of a picture count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Channel {
    Red,
    #[default]
    Green,
    Blue,
    Alpha,
}

impl Channel {
    /// Its name, for people.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Red => "red",
            Self::Green => "green",
            Self::Blue => "blue",
            Self::Alpha => "alpha",
        }
    }
}

/// How a picture is used as a height map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MapUse {
    pub(super) channel: Channel,
    /// What lies beyond the picture, along u and v.
    pub(super) tiles: [Tile; 2],
    /// Whether a point has the value of the nearest texel.
    pub(super) is_nearest: bool,
    /// Whether a picture with colours is taken, too. If not, it is refused, because its colours are directions.
    pub(super) takes_colours: bool,
}

impl MapUse {
    /// Of any picture, whose channel `channel` counts.
    pub(super) fn of(channel: Channel, tile: Tile) -> Self {
        Self { channel, tiles: [tile; 2], is_nearest: false, takes_colours: true }
    }
}

/// A height map as it was read.
pub(super) struct Picture {
    /// Columns and rows.
    pub(super) size: [u32; 2],
    /// Row by row from the top: 0 to 65,535.
    pub(super) texels: Vec<u16>,
    /// Whether its colours differ, so that it matters which channel counts.
    pub(super) is_coloured: bool,
}

/// Reads a PNG. It may take `memory_bytes`.
///
/// # Errors
/// A text that says what is wrong with it and what to do.
pub(super) fn read(mut png: impl BufRead + Seek, memory_bytes: u64, channel: Channel) -> Result<Picture, String> {
    if !png.fill_buf().is_ok_and(|bytes| bytes.starts_with(b"\x89PNG")) {
        return Err("it is not a PNG; convert it to one".into());
    }
    let limits = png::Limits { bytes: usize::try_from(memory_bytes).unwrap_or(usize::MAX) };
    let mut decoder = png::Decoder::new_with_limits(png, limits);
    decoder.set_transformations(png::Transformations::EXPAND);
    let broken = |error: png::DecodingError| format!("{}; give a whole PNG", error.to_string().trim_end_matches('.'));
    let mut reader = decoder.read_info().map_err(broken)?;
    let size = [reader.info().width, reader.info().height];
    if size.iter().any(|count| *count > MAX_MAP_SIDE) {
        return Err(format!("{} × {} pixels; a side has at most {MAX_MAP_SIDE}: scale it down", size[0], size[1]));
    }
    let texel_count = u64::from(size[0]) * u64::from(size[1]);
    if texel_count > MapHeader::MAX_TEXELS {
        return Err(format!(
            "{} × {} pixels; a height map has at most {} (8192 × 8192): scale it down",
            size[0],
            size[1],
            MapHeader::MAX_TEXELS
        ));
    }
    let samples_bytes = reader.output_buffer_size().map_or(u64::MAX, |bytes| bytes as u64);
    let needed_bytes = samples_bytes.saturating_add(texel_count * size_of::<u16>() as u64);
    if needed_bytes > memory_bytes {
        return Err(format!(
            "{} × {} pixels take {}, and --memory allows {}; give more, or scale the picture down",
            size[0],
            size[1],
            size_text(needed_bytes),
            size_text(memory_bytes)
        ));
    }
    let mut samples = vec![0; samples_bytes as usize];
    let info = reader.next_frame(&mut samples).map_err(broken)?;
    let channels = info.color_type.samples();
    let is_wide = info.bit_depth == png::BitDepth::Sixteen;
    let sample = |number: usize| {
        if is_wide {
            u16::from_be_bytes([samples[2 * number], samples[2 * number + 1]])
        } else {
            u16::from(samples[number]) * 257
        }
    };
    let has_alpha = matches!(channels, 2 | 4);
    let place = match channel {
        Channel::Alpha if has_alpha => Some(channels - 1),
        Channel::Alpha => None,
        _ if channels < 3 => Some(0),
        Channel::Red => Some(0),
        Channel::Green => Some(1),
        Channel::Blue => Some(2),
    };
    let texels = 0..texel_count as usize;
    let is_coloured = channels > 2
        && texels.clone().any(|texel| (1..3).any(|other| sample(texel * channels) != sample(texel * channels + other)));
    // A picture without alpha is opaque.
    let value = |texel: usize| place.map_or(u16::MAX, |place| sample(texel * channels + place));
    Ok(Picture { size, texels: texels.map(value).collect(), is_coloured })
}
