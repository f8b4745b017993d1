//! The grid of pixels that a machine exposes, and the height it can build. `config/machine/` makes it.

/// Which axes of the picture run against the build file's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mirror {
    /// Columns run towards smaller x.
    pub x: bool,
    /// Rows run towards smaller y.
    pub y: bool,
}

/// The machine's picture and build height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raster {
    /// Pixels a row, 1 to [`Raster::MAX_PX`].
    pub width_px: u32,
    /// Rows, 1 to [`Raster::MAX_PX`].
    pub height_px: u32,
    /// Pixel pitch along x and y, micrometres; greater than 0.
    pub pixel_um: [f64; 2],
    /// Largest part height, micrometres.
    pub build_height_um: f64,
    /// Mirroring.
    pub mirror: Mirror,
}

impl Raster {
    /// Most pixels along a side: four times the largest projectors. Up to here `f32` tells rows and columns to a 50th of a pixel.
    pub const MAX_PX: u32 = 1 << 15;

    /// Whether size and pitch are within their ranges.
    pub fn is_valid(&self) -> bool {
        let is_size = |side_px: u32| (1..=Self::MAX_PX).contains(&side_px);
        let is_pitch = |pitch_um: f64| pitch_um.is_finite() && pitch_um > 0.0;
        is_size(self.width_px) && is_size(self.height_px) && self.pixel_um.into_iter().all(is_pitch)
    }

    /// Width and height of the area that is exposed, micrometres.
    pub fn area_um(&self) -> [f64; 2] {
        [f64::from(self.width_px) * self.pixel_um[0], f64::from(self.height_px) * self.pixel_um[1]]
    }
}
