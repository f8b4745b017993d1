//! Where a part begins: the height of its lowest solid point, which is to stand on the plate.
//!
//! Of a union it is exact, found strut by strut as they go by. A convolution surface begins where the summed field first reaches
//! the isovalue: planes are drawn from below, on a grid finer than any bottom is curved, until a point is solid, and the height
//! between the last dark plane and that one is halved. Only struts within reach of these planes are read.

use super::model::{Bounds, Header, Strut};
use super::reader::{BuildFile, BuildFileError};
use crate::solid::{Block, Convolution, Grid, LARGEST_PLACE, Path, Plane, Record, Shape, Strip, lowest_z};

/// Planes and points are at most this share of R apart: the field changes by less than one per cent over half of it.
const LARGEST_STEP_SHARE: f64 = 1.0 / 16.0;

/// How far a bottom of the thinnest radius may lie below what the grid finds of it, micrometres, about: points that lie `g` apart
/// miss `g²/4r` of a bottom of radius r.
const MISSED_UM: f64 = 1.0;

/// Planes at most, from the lowest that any strut reaches to the highest.
const MOST_PLANES: f64 = 2048.0;

/// Halvings of the last step: to a thousandth of R's sixteenth at most.
const HALVINGS: u32 = 10;

/// Bytes of a strip: what a level-2 cache holds.
const STRIP_BYTES: usize = 256 << 10;

/// Rows of a strip, at most and in multiples of which shapes set up rows.
const MOST_ROWS: usize = 64;
const ROW_GROUP: usize = 8;

/// The lowest solid point of struts under exact union, quanta.
#[derive(Clone, Copy, Debug)]
pub(super) struct LowestOfUnion(f64);

impl Default for LowestOfUnion {
    /// Of nothing.
    fn default() -> Self {
        Self(f64::INFINITY)
    }
}

impl LowestOfUnion {
    /// Takes in one strut more.
    pub(super) fn add(&mut self, strut: &Strut) {
        // Most struts of a part are far above its bottom.
        if f64::from(strut.a[2]) - f64::from(strut.radius_a.max(strut.radius_b)) < self.0 {
            self.0 = self.0.min(lowest_z(&strut.beam()));
        }
    }

    /// Micrometres.
    pub(super) fn um(self, quantum_um: f64) -> f64 {
        self.0 * quantum_um
    }
}

/// The lowest solid point of a convolution of support R, micrometres; `None` where nothing is solid.
///
/// # Errors
/// Where a chunk cannot be read.
pub(super) fn of_convolution(file: &BuildFile, support_um: f64) -> Result<Option<f64>, BuildFileError> {
    let header = file.header();
    let least_radius_um = f64::from(header.radius_range[0]) * header.quantum_um;
    let Some(first) = file.chunks().first() else { return Ok(None) };
    let bottom_um = f64::from(first.z_low_min) * header.quantum_um - support_um;
    let top_um = f64::from(header.bounds.max[2]) * header.quantum_um + header.bulge_um();
    // No strut that prints at its radius slips through.
    let step_um = (support_um * LARGEST_STEP_SHARE).min(least_radius_um).max((top_um - bottom_um) / MOST_PLANES);
    let mut probe = Probe::new(file, support_um, least_radius_um);
    let mut dark_um = bottom_um;
    loop {
        let z_um = dark_um + step_um;
        if z_um > top_um + step_um {
            return Ok(None);
        }
        probe.rise(dark_um, z_um)?;
        if probe.is_solid(z_um) {
            break;
        }
        dark_um = z_um;
    }
    let mut solid_um = dark_um + step_um;
    for _ in 0..HALVINGS {
        let middle_um = f64::midpoint(dark_um, solid_um);
        if probe.is_solid(middle_um) {
            solid_um = middle_um;
        } else {
            dark_um = middle_um;
        }
    }
    Ok(Some(solid_um))
}

/// Looks at planes for solid points.
struct Probe<'a> {
    file: &'a BuildFile,
    support_um: f64,
    /// Struts that may be within reach.
    blocks: Vec<Block>,
    next_chunk: usize,
    grid: Grid,
    rows: usize,
    strip: Strip<f32>,
    bits: Vec<u8>,
    struts: Vec<Strut>,
}

impl<'a> Probe<'a> {
    fn new(file: &'a BuildFile, support_um: f64, least_radius_um: f64) -> Self {
        let Header { quantum_um, bounds: Bounds { min, max }, .. } = *file.header();
        let bulge_um = file.header().bulge_um();
        let low_um = [0, 1].map(|axis| f64::from(min[axis]) * quantum_um - bulge_um);
        let size_um = [0, 1].map(|axis| f64::from(max[axis]) * quantum_um + bulge_um - low_um[axis]);
        let fine_um = (support_um * LARGEST_STEP_SHARE).min(2.0 * (least_radius_um * MISSED_UM).sqrt());
        let pitch_um = fine_um.max(size_um[0].max(size_um[1]) / f64::from(LARGEST_PLACE - 1));
        let [width, rows] = size_um.map(|size_um| (size_um / pitch_um).ceil() as usize + 1);
        let pitch = pitch_um / support_um;
        let [x0, y0] = low_um.map(|low_um| low_um / support_um);
        let strip_rows = STRIP_BYTES / (width * size_of::<f32>()) / ROW_GROUP * ROW_GROUP;
        Self {
            file,
            support_um,
            blocks: Vec::new(),
            next_chunk: 0,
            grid: Grid { x0, dx: pitch, y0, dy: pitch, width, samples: 1 },
            rows,
            strip: Strip::new(width, strip_rows.clamp(ROW_GROUP, MOST_ROWS), 0),
            bits: vec![0; width.div_ceil(8)],
            struts: Vec::new(),
        }
    }

    /// Lets struts go that end out of reach below `low_um`, and reads those within reach of planes up to `high_um`.
    fn rise(&mut self, low_um: f64, high_um: f64) -> Result<(), BuildFileError> {
        let quantum_um = self.file.header().quantum_um;
        let quantum = quantum_um / self.support_um;
        // Saturates.
        let lowest_top = ((low_um - self.support_um) / quantum_um).floor() as i32;
        let highest_bottom = (high_um + self.support_um) / quantum_um;
        let dead: usize = self.blocks.iter().map(|block| block.count_below(lowest_top)).sum();
        if 2 * dead > self.blocks.len() * Block::LEN {
            let old = std::mem::take(&mut self.blocks);
            let records = old.iter().flat_map(|block| (0..block.len()).map(|at| block.get(at)));
            records.filter(|record| record.b[2] >= lowest_top).for_each(|record| push(&mut self.blocks, record));
        }
        while let Some(entry) = self.file.chunks().get(self.next_chunk) {
            if f64::from(entry.z_low_min) > highest_bottom {
                break;
            }
            if entry.z_high_max >= lowest_top {
                self.struts.clear();
                self.file.read_chunk(self.next_chunk, &mut self.struts)?;
                for strut in self.struts.iter().filter(|strut| strut.b[2] >= lowest_top) {
                    let caps = [strut.caps.a.into(), strut.caps.b.into()];
                    let ends = Convolution::ends([strut.radius_a, strut.radius_b], caps, strut.is_ball(), quantum);
                    push(&mut self.blocks, Record { a: strut.a, b: strut.b, ends });
                }
            }
            self.next_chunk += 1;
        }
        Ok(())
    }

    /// Whether any point of the grid is solid in a plane.
    fn is_solid(&mut self, z_um: f64) -> bool {
        let (path, width) = (Path::detect(), self.grid.width);
        let quantum = self.file.header().quantum_um / self.support_um;
        let plane = Plane { grid: self.grid, z: z_um / self.support_um, quantum };
        let strip_rows = self.strip.capacity_rows();
        for first in (0..self.rows).step_by(strip_rows) {
            let rows = strip_rows.min(self.rows - first);
            self.strip.begin(first, rows);
            Convolution::draw(path, self.blocks.iter(), &plane, &mut self.strip);
            for pixels in self.strip.used_pixels(width) {
                let bytes = pixels.start / 8..pixels.end.div_ceil(8);
                for row in 0..rows {
                    let bits = &mut self.bits[bytes.clone()];
                    Convolution::pack_bits(path, &self.strip, row, bytes.start, bits);
                    if bits.iter().any(|byte| *byte != 0) {
                        return true;
                    }
                }
            }
        }
        false
    }
}

fn push(blocks: &mut Vec<Block>, record: Record) {
    if !blocks.last_mut().is_some_and(|block| block.push(record)) {
        let mut block = Block::default();
        block.push(record);
        blocks.push(block);
    }
}
