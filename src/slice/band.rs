//! A band: some rows of a layer, into which all bodies are drawn. `slicer` makes bands of pixels, `scan/field.rs` bands of a field, and
//! brushes fill them.

use crate::layer::Depth;

/// Successive rows of a layer. Each body is merged into what the others have drawn: bits by OR, grey by maximum.
pub(super) enum Band<'a> {
    /// One bit per pixel. The first pixel of a byte is its highest bit.
    Bits(Rows<'a>),
    /// One byte per pixel: the covered share of the pixel.
    Grey(Rows<'a>),
}

/// The bytes of a band.
pub(super) struct Rows<'a> {
    /// Number in the layer of the first row.
    pub(super) first: usize,
    bytes: &'a mut [u8],
    stride_bytes: usize,
}

impl<'a> Band<'a> {
    /// Dark rows from `first` on. Overwrites `bytes`.
    pub(super) fn dark(depth: Depth, first: usize, bytes: &'a mut [u8], stride_bytes: usize) -> Self {
        bytes.fill(0);
        let rows = Rows { first, bytes, stride_bytes };
        match depth {
            Depth::Bit => Self::Bits(rows),
            Depth::Grey => Self::Grey(rows),
        }
    }

    /// Bits a pixel.
    pub(super) fn depth(&self) -> Depth {
        match self {
            Self::Bits(_) => Depth::Bit,
            Self::Grey(_) => Depth::Grey,
        }
    }

    /// The bytes.
    pub(super) fn rows(&self) -> &Rows<'a> {
        let (Self::Bits(rows) | Self::Grey(rows)) = self;
        rows
    }

    /// The bytes, to write.
    pub(super) fn rows_mut(&mut self) -> &mut Rows<'a> {
        let (Self::Bits(rows) | Self::Grey(rows)) = self;
        rows
    }

    /// Clears the bits beyond `width_px` in the last byte of each row.
    pub(super) fn finish(self, width_px: usize) {
        if let Self::Bits(mut rows) = self
            && !width_px.is_multiple_of(8)
        {
            for row in rows.each_mut() {
                if let Some(last) = row.last_mut() {
                    *last &= 0xff << (8 - width_px % 8);
                }
            }
        }
    }
}

impl Rows<'_> {
    /// Number of rows.
    pub(super) fn count(&self) -> usize {
        self.bytes.len() / self.stride_bytes
    }

    /// Bytes from one row to the next.
    pub(super) fn stride_bytes(&self) -> usize {
        self.stride_bytes
    }

    /// The bytes of a row, counted from the first one of the band.
    pub(super) fn row_mut(&mut self, row: usize) -> &mut [u8] {
        &mut self.bytes[row * self.stride_bytes..(row + 1) * self.stride_bytes]
    }

    /// The bytes of each row.
    pub(super) fn each_mut(&mut self) -> impl Iterator<Item = &mut [u8]> {
        self.bytes.chunks_exact_mut(self.stride_bytes)
    }
}

/// Successive rows of a field: by how far each pixel's centre lies within the solid, about micrometres near the border. Each body raises
/// what the others have drawn.
pub(super) struct FieldBand<'a> {
    /// Number in the layer of the first row.
    pub(super) first: usize,
    values: &'a mut [f32],
    width_px: usize,
}

impl<'a> FieldBand<'a> {
    /// Rows from `first` on that no body has raised yet. Overwrites `values`, `width_px` for each row.
    pub(super) fn empty(first: usize, values: &'a mut [f32], width_px: usize) -> Self {
        values.fill(f32::NEG_INFINITY);
        Self { first, values, width_px }
    }

    /// Number of rows.
    pub(super) fn count(&self) -> usize {
        self.values.len() / self.width_px
    }

    /// Values of a row.
    pub(super) fn width_px(&self) -> usize {
        self.width_px
    }

    /// The values of each row.
    pub(super) fn each_mut(&mut self) -> impl Iterator<Item = &mut [f32]> {
        self.values.chunks_exact_mut(self.width_px)
    }
}
