//! A layer as pixels. `slice` draws it, `device/encoding.rs` encodes it.

/// Bits a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// One bit: 1 is lit. Rows are padded to whole bytes, the first pixel of a byte in its highest bit, padding is 0.
    Bit,
    /// Eight bits: 0 dark, 255 lit, in between the covered share of the pixel.
    Grey,
}

impl Depth {
    /// Bytes of a row of `width_px` pixels.
    pub fn stride_bytes(self, width_px: u32) -> usize {
        match self {
            Self::Bit => (width_px as usize).div_ceil(8),
            Self::Grey => width_px as usize,
        }
    }
}

/// A rectangular picture; row 0 first, pixels of a row in ascending x of the projector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bitmap {
    width_px: u32,
    height_px: u32,
    depth: Depth,
    data: Vec<u8>,
}

impl Bitmap {
    /// A dark picture.
    pub fn new(width_px: u32, height_px: u32, depth: Depth) -> Self {
        let mut bitmap = Self { width_px, height_px, depth, data: Vec::new() };
        bitmap.data = vec![0; bitmap.stride_bytes() * height_px as usize];
        bitmap
    }

    /// A picture of these rows, `height_px × stride_bytes`; `None` if their number of bytes is another.
    pub fn from_rows(width_px: u32, height_px: u32, depth: Depth, data: Vec<u8>) -> Option<Self> {
        let bitmap = Self { width_px, height_px, depth, data };
        (bitmap.data.len() == bitmap.stride_bytes() * height_px as usize).then_some(bitmap)
    }

    /// Bytes from one row to the next.
    pub fn stride_bytes(&self) -> usize {
        self.depth.stride_bytes(self.width_px)
    }

    /// Pixels a row.
    pub fn width_px(&self) -> u32 {
        self.width_px
    }

    /// Rows.
    pub fn height_px(&self) -> u32 {
        self.height_px
    }

    /// Bits a pixel.
    pub fn depth(&self) -> Depth {
        self.depth
    }

    /// All rows, `height_px × stride_bytes`.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// All rows, to write; padding bits must stay 0.
    pub fn data_mut(&mut self) -> &mut [u8] {
        &mut self.data
    }
}
