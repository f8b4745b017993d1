//! Draws a surface in a band: facets are cut, the segments cross rows, and the spans between are filled. `tests/surface/` compares what
//! it draws.

use std::ops::Range;

use super::ROWS_PER_BAND;
use super::active::Active;
use super::element::Element;
use crate::layer::Depth;
use crate::slice::SlicePlan;
use crate::slice::band::{Band, FieldBand};
use crate::slice::body::{Brush, FieldBrush};
use crate::solid::{Crossings, FieldRows, Resolution, SectionPlane, Segment, set_bits};

/// What one thread draws with. It takes a fixed amount of memory.
pub(super) trait Sheet: Send {
    /// A sheet for the pictures of a plan.
    fn new(plan: &SlicePlan) -> Self;

    /// Its memory, bytes.
    fn bytes(plan: &SlicePlan) -> u64;

    fn crossings(&mut self) -> &mut Crossings;
}

/// A sheet for pixels.
pub(super) struct PixelSheet {
    crossings: Crossings,
    /// Samples of each pixel of a row, for grey.
    samples: Vec<u16>,
}

impl Sheet for PixelSheet {
    fn new(plan: &SlicePlan) -> Self {
        let width = plan.raster.width_px as usize;
        let crossings = Crossings::new(width, ROWS_PER_BAND, resolution(plan.depth));
        Self { crossings, samples: vec![0; sample_count(plan)] }
    }

    fn bytes(plan: &SlicePlan) -> u64 {
        let samples = sample_count(plan) * size_of::<u16>();
        Crossings::bytes(plan.raster.width_px as usize, ROWS_PER_BAND, resolution(plan.depth)) + samples as u64
    }

    fn crossings(&mut self) -> &mut Crossings {
        &mut self.crossings
    }
}

fn resolution(depth: Depth) -> Resolution {
    match depth {
        Depth::Bit => Resolution::CENTRES,
        Depth::Grey => Resolution::GREY,
    }
}

fn sample_count(plan: &SlicePlan) -> usize {
    match plan.depth {
        Depth::Bit => 0,
        Depth::Grey => plan.raster.width_px as usize,
    }
}

/// A sheet for a field.
pub(super) struct FieldSheet {
    crossings: Crossings,
    rows: FieldRows,
}

impl Sheet for FieldSheet {
    fn new(plan: &SlicePlan) -> Self {
        let width = plan.raster.width_px as usize;
        Self {
            crossings: Crossings::new(width, ROWS_PER_BAND, Resolution::CENTRES),
            rows: FieldRows::new(width, ROWS_PER_BAND, plan.raster.pixel_um),
        }
    }

    fn bytes(plan: &SlicePlan) -> u64 {
        let width = plan.raster.width_px as usize;
        Crossings::bytes(width, ROWS_PER_BAND, Resolution::CENTRES) + FieldRows::bytes(width, ROWS_PER_BAND)
    }

    fn crossings(&mut self) -> &mut Crossings {
        &mut self.crossings
    }
}

/// The brush of one thread.
pub(super) struct SurfaceBrush<'a, E: Element, S> {
    pub(super) active: &'a Active<E::Kept>,
    pub(super) cutter: &'a E::Cutter,
    pub(super) plane: SectionPlane,
    pub(super) sheet: &'a mut S,
}

impl<E: Element, S: Sheet> SurfaceBrush<'_, E, S> {
    /// Finds the crossings of up to `count` rows from `first` on, and returns for how many there was room.
    fn cross(&mut self, first: usize, mut count: usize) -> usize {
        let is_mirrored = self.plane.is_mirrored();
        let crossings = self.sheet.crossings();
        loop {
            crossings.begin(first, count);
            let rows = first as i64..(first + count) as i64;
            segments::<E>(self.active, self.cutter, &self.plane, rows, |segment| {
                crossings.add(segment, is_mirrored);
                !crossings.is_full()
            });
            if !crossings.is_full() {
                return count;
            }
            count /= 2;
        }
    }

    /// Draws rows from `first` on, as many at a time as there is room for.
    fn draw<T>(&mut self, mut first: usize, mut rows: &mut [T], fill: impl Fn(&mut Self, usize, &mut [T])) {
        let mut most = rows.len();
        while !rows.is_empty() {
            let count = self.cross(first, most.min(rows.len()));
            // Neighbouring rows have about as many crossings.
            most = if self.sheet.crossings().is_half_empty() { 2 * count } else { count };
            let (now, later) = rows.split_at_mut(count);
            fill(self, first, now);
            (first, rows) = (first + count, later);
        }
    }
}

impl<E: Element> Brush for SurfaceBrush<'_, E, PixelSheet> {
    fn cover(&mut self, band: &mut Band<'_>) {
        match band {
            Band::Bits(rows) => {
                let (first, mut lines) = (rows.first, rows.each_mut().collect::<Vec<_>>());
                self.draw(first, &mut lines, |brush, _, lines| {
                    brush.sheet.crossings.spans(|row, span| set_bits(lines[row], span));
                });
            }
            Band::Grey(rows) => {
                let (first, mut lines) = (rows.first, rows.each_mut().collect::<Vec<_>>());
                self.draw(first, &mut lines, |brush, _, lines| fill_grey(brush.sheet, lines));
            }
        }
    }
}

impl<E: Element> FieldBrush for SurfaceBrush<'_, E, FieldSheet> {
    fn raise(&mut self, band: &mut FieldBand<'_>) {
        let (first, mut lines) = (band.first, band.each_mut().collect::<Vec<_>>());
        self.draw(first, &mut lines, |brush, first, lines| {
            let FieldSheet { crossings, rows } = &mut *brush.sheet;
            rows.begin(first, lines.len());
            let reach = rows.reach(first, lines.len());
            segments::<E>(brush.active, brush.cutter, &brush.plane, reach, |segment| {
                rows.add(segment);
                true
            });
            crossings.spans(|row, span| rows.fill(row, span));
            for (line, row) in lines.iter_mut().zip(rows.rows()) {
                line.iter_mut().zip(row).for_each(|(value, excess)| *value = value.max(*excess));
            }
        });
    }
}

/// Cuts all elements that may reach some rows, until `take` returns false.
fn segments<E: Element>(
    active: &Active<E::Kept>,
    cutter: &E::Cutter,
    plane: &SectionPlane,
    rows: Range<i64>,
    mut take: impl FnMut(&Segment) -> bool,
) {
    E::facets(active, cutter, plane.z, rows, |facet| plane.cut(facet).is_none_or(|segment| take(&segment)));
}

/// Raises pixels to the share of their samples that are solid.
fn fill_grey(sheet: &mut PixelSheet, lines: &mut [&mut [u8]]) {
    let PixelSheet { crossings, samples } = sheet;
    let mut at = 0;
    let mut touched = 0..0;
    crossings.spans(|row, span| {
        if row != at {
            raise(samples, std::mem::take(&mut touched), lines[at]);
            at = row;
        }
        let pixels = add_samples(samples, span);
        touched =
            if touched.is_empty() { pixels } else { touched.start.min(pixels.start)..touched.end.max(pixels.end) };
    });
    if let Some(line) = lines.get_mut(at) {
        raise(samples, touched, line);
    }
}

/// Adds a span of samples to the pixels in which they lie, and returns these.
fn add_samples(samples: &mut [u16], span: Range<u32>) -> Range<usize> {
    const COLUMNS: u32 = Resolution::GREY.columns;
    let pixels = (span.start / COLUMNS) as usize..span.end.div_ceil(COLUMNS) as usize;
    for pixel in pixels.clone() {
        let first = pixel as u32 * COLUMNS;
        samples[pixel] += (span.end.min(first + COLUMNS) - span.start.max(first)) as u16;
    }
    pixels
}

/// Raises pixels to the grey values of their samples, and takes the samples away.
fn raise(samples: &mut [u16], pixels: Range<usize>, line: &mut [u8]) {
    for (count, pixel) in samples[pixels.clone()].iter_mut().zip(&mut line[pixels]) {
        // All 256 samples are white.
        *pixel = (*pixel).max(std::mem::take(count).min(255) as u8);
    }
}
