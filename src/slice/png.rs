//! Layers as PNG: one bit a pixel stays one bit.

use std::io::Write;

use super::{Bitmap, Depth};

impl Bitmap {
    /// Writes a greyscale PNG of the bitmap's own depth; lit is white.
    ///
    /// # Errors
    /// What `out` answers, e.g. a full disk.
    pub fn write_png(&self, out: impl Write) -> std::io::Result<()> {
        let mut encoder = png::Encoder::new(out, self.width_px(), self.height_px());
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(match self.depth() {
            Depth::Bit => png::BitDepth::One,
            Depth::Grey => png::BitDepth::Eight,
        });
        encoder.set_compression(png::Compression::Fast);
        let into_io = |error| match error {
            png::EncodingError::IoError(error) => error,
            other => std::io::Error::other(other),
        };
        let mut writer = encoder.write_header().map_err(into_io)?;
        writer.write_image_data(self.data()).map_err(into_io)?;
        writer.finish().map_err(into_io)
    }
}
