//! Joined lattices as masks: which of their materials each pixel gets. `tests/exact/joined.rs` compares every pixel with the formulas.

use super::{Joined, JoinedBrush, Settings, brush, joint, pixels_memory_bytes};
use crate::buildfile::Split;
use crate::layer::Depth;
use crate::slice::band::Band;
use crate::slice::body::masks::{MaskBody, MaskBrush};
use crate::slice::body::{Body, Cut, JoinedLattice};
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{
    Convolution, Effort, Halftone, InstructionSet, JoinedShape, JoinedStretch, MAX_MATERIALS, Rule, SharedUnion, Strip,
};
use crate::stream::{Charge, MemoryBudget};

/// Joined lattices, and what their materials are chosen with.
struct Masks<S: JoinedShape> {
    joined: Joined<S>,
    split: Split,
    /// Of each thread.
    choosing: Vec<Choosing>,
    _charge: Charge,
}

/// Work space for a row: which pixels each material gets, and their grey values.
struct Choosing {
    owners: Vec<Vec<u8>>,
    grey: Vec<u8>,
}

impl Choosing {
    fn new(plan: &SlicePlan, materials: usize) -> Self {
        let row = row_px(plan);
        Self { owners: vec![vec![0; row / 8]; materials], grey: vec![0; row] }
    }

    fn bytes(plan: &SlicePlan, materials: usize) -> u64 {
        let row = row_px(plan) as u64;
        row + materials as u64 * (row / 8)
    }
}

/// Pixels of a row in whole bytes of bits.
fn row_px(plan: &SlicePlan) -> usize {
    (plan.raster.width_px as usize).next_multiple_of(8)
}

/// Memory that [`masks`] charges, bytes. It is known before a chunk is read.
pub(in crate::slice) fn masks_memory_bytes(lattices: &[JoinedLattice], plan: &SlicePlan, threads: usize) -> u64 {
    let choosing_bytes = Choosing::bytes(plan, lattices.len()).saturating_mul(threads as u64);
    pixels_memory_bytes(lattices, plan, threads).saturating_add(choosing_bytes)
}

/// Joined lattices to be drawn as masks. As [`pixels`](super::pixels).
///
/// # Errors
/// As [`pixels`](super::pixels).
pub(in crate::slice) fn masks(
    instructions: InstructionSet,
    lattices: Vec<JoinedLattice>,
    split: Split,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn MaskBody>, SliceError> {
    let settings = Settings { instructions, plan, threads, budget };
    Ok(match joint(&lattices).support_um() {
        Some(_) => Box::new(Masks::<Convolution>::new(&settings, lattices, split)?),
        None => Box::new(Masks::<SharedUnion>::new(&settings, lattices, split)?),
    })
}

impl<S: JoinedShape> Masks<S> {
    fn new(settings: &Settings<'_>, lattices: Vec<JoinedLattice>, split: Split) -> Result<Self, SliceError> {
        let Settings { plan, threads, budget, .. } = *settings;
        let count = lattices.len();
        let bytes = Choosing::bytes(plan, count).saturating_mul(threads as u64);
        let charge = budget.charge("the materials of a row", bytes)?;
        let choosing = (0..threads).map(|_| Choosing::new(plan, count)).collect();
        Ok(Self { joined: settings.joined(lattices, brush::halo::<S>(plan.depth))?, split, choosing, _charge: charge })
    }
}

impl<S: JoinedShape> Body for Masks<S> {
    fn rows_per_band(&self) -> usize {
        self.joined.rows_per_band()
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.joined.advance(z_um, workers)
    }

    fn active_count(&self) -> usize {
        self.joined.active_count()
    }

    fn effort(&self) -> Effort {
        self.joined.effort()
    }
}

impl<S: JoinedShape> MaskBody for Masks<S> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn MaskBrush + '_>> {
        let rule = match self.split {
            Split::Halftone => Rule::Threshold(Halftone::of_layer(cut.layer)),
            Split::Max => Rule::Max,
        };
        let brushes = self.joined.strip_brushes(cut).into_iter().zip(&mut self.choosing);
        brushes
            .map(|(brush, choosing)| Box::new(JoinedMaskBrush { brush, rule, choosing }) as Box<dyn MaskBrush>)
            .collect()
    }
}

/// The brush of one thread.
struct JoinedMaskBrush<'a, S: JoinedShape> {
    brush: JoinedBrush<'a, S>,
    rule: Rule,
    choosing: &'a mut Choosing,
}

impl<S: JoinedShape> MaskBrush for JoinedMaskBrush<'_, S> {
    fn cover(&mut self, bands: &mut [Band<'_>]) {
        let Some(band) = bands.first() else { return };
        let (depth, first_row, count) = (band.depth(), band.rows().first, band.rows().count());
        match depth {
            Depth::Bit => self.brush.draw_members(first_row, count, 0),
            Depth::Grey => self.brush.draw(first_row, count, brush::halo::<S>(depth)),
        }
        let width = self.brush.grid.width;
        let Choosing { owners, grey } = &mut *self.choosing;
        let strips: Vec<&Strip<S::Cell>> = self.brush.members.iter().map(|(_, member)| &*member.strip).collect();
        let materials: Vec<usize> = self.brush.members.iter().map(|(material, _)| *material).collect();
        let instructions = self.brush.instructions;
        for used in Strip::used_together(&strips, width) {
            // Pixels are divided eight at a time; a strip has spare cells beyond the last one.
            let pixels = used.start / 8 * 8..used.end.next_multiple_of(8);
            for row in 0..count {
                let mut cells: [&[S::Cell]; MAX_MATERIALS] = [&[]; MAX_MATERIALS];
                for (cells, strip) in cells.iter_mut().zip(&strips) {
                    *cells = strip.some_pixels(row, pixels.clone());
                }
                let (cells, place) = (&cells[..strips.len()], [pixels.start, first_row + row]);
                let stretch = JoinedStretch::<S> { joining: &self.brush.joining, cells, place };
                match depth {
                    Depth::Bit => {
                        // Joined lattices are the first body: nothing is lit yet.
                        let mut out: [&mut [u8]; MAX_MATERIALS] = std::array::from_fn(|_| &mut [][..]);
                        for (material, band) in bands.iter_mut().enumerate() {
                            if let Some(member) = materials.iter().position(|of| *of == material) {
                                out[member] = &mut band.rows_mut().row_mut(row)[pixels.start / 8..pixels.end / 8];
                            }
                        }
                        stretch.divide_bits(instructions, self.rule, &mut out[..materials.len()]);
                    }
                    Depth::Grey => {
                        let mut out: [&mut [u8]; MAX_MATERIALS] = std::array::from_fn(|_| &mut [][..]);
                        for (out, owner) in out.iter_mut().zip(&mut *owners) {
                            *out = &mut owner[..pixels.len() / 8];
                            out.fill(0);
                        }
                        let grey = &mut grey[..pixels.end.min(width) - pixels.start];
                        grey.fill(0);
                        S::merge_coverage(instructions, self.brush.whole, row, pixels.start, grey);
                        let out = &mut out[..materials.len()];
                        stretch.divide_grey(instructions, self.rule, grey, out);
                        for (material, owned) in materials.iter().zip(out) {
                            let band = bands[*material].rows_mut().row_mut(row);
                            give(&mut band[pixels.start..pixels.start + grey.len()], grey, owned);
                        }
                    }
                }
            }
        }
    }
}

/// For each byte of bits, a byte of ones for each bit that is set, the highest first.
const SPREAD: [u64; 256] = {
    let mut table = [0; 256];
    let mut number = 0;
    while number < 8 * 256 {
        let (byte, bit) = (number / 8, number % 8);
        if byte & (0x80 >> bit) != 0 {
            table[byte] |= 0xff << (8 * bit);
        }
        number += 1;
    }
    table
};

/// Copies the grey values of the pixels that a material owns.
fn give(mask: &mut [u8], grey: &[u8], owned: &[u8]) {
    let (eights, rest) = mask.as_chunks_mut::<8>();
    let (grey_eights, grey_rest) = grey.as_chunks::<8>();
    for ((mask, grey), owned) in eights.iter_mut().zip(grey_eights).zip(owned) {
        let given = SPREAD[usize::from(*owned)];
        *mask = (u64::from_le_bytes(*mask) & !given | u64::from_le_bytes(*grey) & given).to_le_bytes();
    }
    let owned = owned.last().copied().unwrap_or(0);
    for (pixel, (mask, grey)) in rest.iter_mut().zip(grey_rest).enumerate() {
        *mask = if owned & 0x80 >> pixel != 0 { *grey } else { *mask };
    }
}
