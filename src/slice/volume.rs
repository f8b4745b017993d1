//! How much material a solid takes, sampled with the planes and pixels that layers are made of.
//!
//! The height is cut into equal slabs, and one plane is drawn in each. Where in its slab, and where in a pixel the first
//! pixel's centre lies, follows a sequence that fills space evenly (multiples of the powers of 1/ρ, ρ⁴ = ρ + 1): so no period
//! of a lattice keeps step with planes or pixels. The error is told from how far neighbouring slabs differ.

use std::sync::Arc;

use super::{BodySource, SliceError, SlicePlan, Slicer};
use crate::buildfile::{Blend, BuildFile, Header};
use crate::layer::{Bitmap, Depth, Mirror, Raster};
use crate::stream::MemoryBudget;

/// Planes drawn: some of each floor of a lattice of a hundred, as most of the error is what happens between two planes.
const MOST_PLANES: u64 = 1024;

/// With fewer, how neighbours differ would tell too little of the error.
const LEAST_PLANES: u64 = 64;

/// Struts met by all planes together, about: where more lie at one height, fewer planes are drawn. 2²⁴ take some seconds.
const MOST_STRUTS: u64 = 1 << 24;

/// Planes and struts where less time and accuracy are wanted ([`Volume::slabs`]).
const FEW_PLANES: u64 = 256;
const FEW_STRUTS: u64 = 1 << 22;

/// Pixels of a plane, about: what they miss averages over struts and planes.
const PIXELS: f64 = (1 << 16) as f64;

/// A pixel need not be smaller than this share of the thinnest radius: planes see its circle in 3,000 pixels.
const LEAST_PIXEL_SHARE: f64 = 1.0 / 32.0;

/// The powers of 1/ρ with ρ⁴ = ρ + 1: multiples of them fill a cube evenly.
const EVEN: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];

/// An estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Two standard errors: 19 of 20 such estimates lie within.
    pub error: f64,
}

/// What a part takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    /// The solid as it prints, mm³.
    pub solid_mm3: Estimate,
    /// The exact union of the same beams and balls, mm³; only where the solid is a convolution.
    pub union_mm3: Option<Estimate>,
    /// By how much the convolution exceeds that union, per cent; negative where it is less. Both are sampled at the same
    /// places, so this is better known than either.
    pub excess_percent: Option<Estimate>,
    /// Planes drawn.
    pub planes: u32,
}

impl Volume {
    /// Samples a part on `threads` threads, always at the same places. Takes the memory of a slicer for each of the two
    /// solids, and time for 2²⁴ struts and 2²⁶ pixels at most of each, or what 64 planes take.
    ///
    /// # Errors
    /// [`SliceError`] where the file cannot be read or `threads` is out of range.
    pub fn sample(file: &Arc<BuildFile>, threads: usize) -> Result<Self, SliceError> {
        let plan = plan(file.header(), file.peak_active(), MOST_PLANES, MOST_STRUTS);
        let areas = |bodies: Vec<BodySource>| {
            let budget = MemoryBudget::new(Slicer::memory_bytes(&bodies, &plan, threads));
            self::areas(bodies, &plan, threads, &budget, || {})
        };
        let is_union = file.header().lattices().all(|lattice| lattice.blend == Blend::Union);
        let union = (!is_union).then(|| areas(BodySource::unions_of(file))).transpose()?;
        let areas = areas(BodySource::of(file))?;
        let slab_mm3 = slab_mm3(&plan);
        let times =
            |estimate: Estimate| Estimate { value: estimate.value * slab_mm3, error: estimate.error * slab_mm3 };
        Ok(Self {
            solid_mm3: times(sum(&areas)),
            union_mm3: union.as_deref().map(|areas| times(sum(areas))),
            excess_percent: union.as_deref().and_then(|union| excess_percent(&areas, union)),
            planes: plan.layer_count,
        })
    }

    /// Volume of the solid in each of equal slabs of the height that layers take, the lowest first, mm³: sampled on this thread, less accurately than
    /// [`Volume::sample`] and in less time. There are 64 to 256 slabs. Calls `rest` after each, so that the caller can let others
    /// work meanwhile.
    ///
    /// # Errors
    /// [`SliceError`] if it needs more memory than `limit_bytes`, or the file cannot be read.
    pub fn slabs(file: &Arc<BuildFile>, limit_bytes: u64, rest: impl FnMut()) -> Result<Vec<f64>, SliceError> {
        let header = file.header();
        let mut plan = plan(header, file.peak_active(), FEW_PLANES, FEW_STRUTS);
        // Layers end with the bounds.
        let high_um = f64::from(header.bounds.max[2]) * header.quantum_um;
        plan.layer_height_um = (high_um - plan.z0_um) / f64::from(plan.layer_count);
        let mut areas = areas(BodySource::of(file), &plan, 1, &MemoryBudget::new(limit_bytes), rest)?;
        areas.iter_mut().for_each(|area| *area *= slab_mm3(&plan));
        Ok(areas)
    }
}

/// Volume of a slab under one pixel, mm³.
fn slab_mm3(plan: &SlicePlan) -> f64 {
    plan.layer_height_um * plan.raster.pixel_um[0] * plan.raster.pixel_um[1] * 1e-9
}

/// A picture round the part, one pixel wider on all sides, and as many slabs of its height as are worth their time.
fn plan(header: &Header, peak_active: u64, most_planes: u64, most_struts: u64) -> SlicePlan {
    let bulge_um = header.lattices().map(|lattice| lattice.bulge_um(header.quantum_um)).fold(0.0, f64::max);
    let least_radius = header.lattices().map(|lattice| lattice.radius_range[0]).min().unwrap_or(0);
    let mut low_um = header.bounds.min.map(|x| f64::from(x) * header.quantum_um - bulge_um);
    // A step of the area costs accuracy: no empty slab below the first.
    low_um[2] = header.bottom_um;
    let high_um = header.bounds.max.map(|x| f64::from(x) * header.quantum_um + bulge_um);
    let size_um = [0, 1, 2].map(|axis| high_um[axis] - low_um[axis]);
    let least_um = f64::from(least_radius) * header.quantum_um * LEAST_PIXEL_SHARE;
    let longest_um = size_um[0].max(size_um[1]) / f64::from(Raster::MAX_PX - 3);
    let pixel_um = (size_um[0] * size_um[1] / PIXELS).sqrt().max(least_um).max(longest_um);
    let [width_px, height_px] = [0, 1].map(|axis| (size_um[axis] / pixel_um).ceil() as u32 + 2);
    // A whole number of pairs.
    let planes = (most_struts / peak_active.max(1)).clamp(LEAST_PLANES, most_planes) as u32 & !1;
    SlicePlan {
        raster: Raster {
            width_px,
            height_px,
            pixel_um: [pixel_um; 2],
            build_height_um: size_um[2],
            mirror: Mirror::default(),
        },
        depth: Depth::Bit,
        origin_um: [0, 1].map(|axis| low_um[axis] - pixel_um / 2.0),
        z0_um: low_um[2],
        layer_height_um: size_um[2] / f64::from(planes),
        layer_count: planes,
    }
}

/// Pixels lit in each plane.
fn areas(
    bodies: Vec<BodySource>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
    mut rest: impl FnMut(),
) -> Result<Vec<f64>, SliceError> {
    let mut slicer = Slicer::new(bodies, plan.clone(), threads, 0, budget)?;
    let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
    let mut areas = Vec::with_capacity(plan.layer_count as usize);
    for plane in 0..plan.layer_count {
        let [up, right, down] = EVEN.map(|step| (f64::from(plane) * step).fract());
        let z_um = plan.z0_um + (f64::from(plane) + up) * plan.layer_height_um;
        slicer.draw_plane(z_um, [right - 0.5, down - 0.5], &mut bitmap)?;
        areas.push(f64::from(bitmap.data().iter().map(|byte| byte.count_ones()).sum::<u32>()));
        rest();
    }
    Ok(areas)
}

fn sum(areas: &[f64]) -> Estimate {
    Estimate { value: areas.iter().sum(), error: 2.0 * squares(areas.iter().copied()).sqrt() }
}

/// None where nothing of the union was met.
fn excess_percent(areas: &[f64], union: &[f64]) -> Option<Estimate> {
    let total = union.iter().sum::<f64>();
    let ratio = areas.iter().sum::<f64>() / total;
    let rest = areas.iter().zip(union).map(|(area, union)| area - ratio * union);
    (total > 0.0).then(|| Estimate { value: (ratio - 1.0) * 100.0, error: 200.0 * squares(rest).sqrt() / total })
}

/// Variance of a sum of one sample from each slab, from the squared differences of neighbours: more than it is, where the slabs'
/// means differ, never less.
fn squares(samples: impl Iterator<Item = f64>) -> f64 {
    let samples: Vec<f64> = samples.collect();
    samples.as_chunks::<2>().0.iter().map(|[one, other]| (one - other) * (one - other)).sum()
}
