//! The volume of a part, estimated from sampled planes and pixels.
//!
//! The height is divided into equal slabs, and one plane is drawn in each. The height of the plane within its slab, and the offset of the
//! pixels, follow a low-discrepancy sequence (Roberts 2018: multiples of the powers of 1/ρ with ρ⁴ = ρ + 1). So no period of a lattice
//! stays in step with planes or pixels. The error is estimated from the differences of neighbouring slabs. `layerctl info` prints both.

use std::sync::Arc;

use super::{BodySource, MaskSlicer, MaskSources, SliceError, SlicePlan, Slicer};
use crate::buildfile::{BuildFile, Header, Joint};
use crate::layer::{Bitmap, Depth, Mirror, Raster};
use crate::stream::MemoryBudget;

/// Most planes: about ten for each floor of a lattice with a hundred floors. Most of the error comes from changes between two planes.
const MAX_PLANES: u64 = 1024;

/// Fewest planes: with fewer, the differences of neighbours are a poor estimate of the error.
const MIN_PLANES: u64 = 64;

/// Struts that all planes together may cut, about: the more struts at one height, the fewer planes. 2²⁴ struts take some seconds.
const MAX_STRUTS: u64 = 1 << 24;

/// Planes and struts of [`Volume::slabs`], which takes less time and is less accurate.
const FEW_PLANES: u64 = 256;
const FEW_STRUTS: u64 = 1 << 22;

/// Pixels of a plane, about. Their errors average out over struts and planes.
const PIXELS: f64 = (1 << 16) as f64;

/// Smallest pixel, as a share of the smallest radius: a disc of that radius then has 3,000 pixels, and more are not needed.
const MIN_PIXEL_SHARE: f64 = 1.0 / 32.0;

/// The powers of 1/ρ with ρ⁴ = ρ + 1. Their multiples modulo 1 fill a cube evenly (Roberts 2018, "The unreasonable effectiveness of
/// quasirandom sequences", R₃).
const EVEN: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];

/// An estimate with its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Two standard errors: the true value is within this distance in 19 of 20 cases.
    pub error: f64,
}

/// The volume of a part.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// The solid as it prints, mm³.
    pub solid_mm3: Estimate,
    /// What of it is of each material, mm³; nothing if there are not several.
    pub materials_mm3: Vec<Estimate>,
    /// The exact union of the same beams and balls, mm³; only if a body is a convolution.
    pub union_mm3: Option<Estimate>,
    /// By how much the convolution exceeds that union, per cent; negative if it is smaller. Both are sampled at the same points, so
    /// its relative error is smaller than that of either volume.
    pub excess_percent: Option<Estimate>,
    /// Number of planes.
    pub planes: u32,
}

impl Volume {
    /// Samples a part on `threads` threads, always at the same points. For each of the two solids, one after the other, it takes the
    /// memory of a slicer, and the time to draw up to 2²⁴ struts and 2²⁶ pixels, or 64 planes if that is longer.
    ///
    /// # Errors
    /// [`SliceError`] if the file cannot be read or `threads` is out of range.
    pub fn sample(file: &Arc<BuildFile>, threads: usize) -> Result<Self, SliceError> {
        let plan = plan(file.header(), file.peak_active(), MAX_PLANES, MAX_STRUTS);
        let areas = |bodies: Vec<BodySource>| {
            let budget = MemoryBudget::new(Slicer::memory_bytes(&bodies, &plan, threads));
            self::areas(bodies, &plan, threads, &budget, || {})
        };
        let is_union = file.header().lattices().all(|lattice| lattice.joint == Joint::Union);
        let union = (!is_union).then(|| areas(BodySource::unions_of(file))).transpose()?;
        let of_materials = match &file.header().materials {
            Some(materials) if materials.names.len() > 1 => areas_of_materials(file, &plan, threads)?,
            _ => Vec::new(),
        };
        let areas = match of_materials.split_first() {
            Some((first, others)) => others.iter().fold(first.clone(), |sum, one| added(&sum, one)),
            None => areas(BodySource::of(file))?,
        };
        let slab_mm3 = slab_mm3(&plan);
        let times =
            |estimate: Estimate| Estimate { value: estimate.value * slab_mm3, error: estimate.error * slab_mm3 };
        Ok(Self {
            solid_mm3: times(sum(&areas)),
            materials_mm3: of_materials.iter().map(|areas| times(sum(areas))).collect(),
            union_mm3: union.as_deref().map(|areas| times(sum(areas))),
            excess_percent: union.as_deref().and_then(|union| excess_percent(&areas, union)),
            planes: plan.layer_count,
        })
    }

    /// Volume of the solid in each of 64 to 256 equal slabs of the height of all layers, the lowest first, mm³. It is sampled on this
    /// thread, in less time and less accurately than [`Volume::sample`]. Calls `rest` after each slab, so that the caller can let
    /// others work meanwhile.
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

/// A plan whose picture is one pixel larger than the part on all sides, and whose layers are the slabs.
fn plan(header: &Header, peak_active: u64, max_planes: u64, max_struts: u64) -> SlicePlan {
    let lattices = || header.lattices();
    let bulge_um = lattices().map(|lattice| lattice.bulge_um(header.quantum_um)).fold(0.0, f64::max);
    let least_radius = lattices().map(|lattice| lattice.radius_range[0]).min().unwrap_or(0);
    let mut low_um = header.bounds.min.map(|x| f64::from(x) * header.quantum_um - bulge_um);
    // A jump of the area costs accuracy, so no slab below the part is sampled.
    low_um[2] = header.bottom_um;
    let high_um = header.bounds.max.map(|x| f64::from(x) * header.quantum_um + bulge_um);
    let size_um = [0, 1, 2].map(|axis| high_um[axis] - low_um[axis]);
    let least_um = f64::from(least_radius) * header.quantum_um * MIN_PIXEL_SHARE;
    let longest_um = size_um[0].max(size_um[1]) / f64::from(Raster::MAX_PX - 3);
    let pixel_um = (size_um[0] * size_um[1] / PIXELS).sqrt().max(least_um).max(longest_um);
    let [width_px, height_px] = [0, 1].map(|axis| (size_um[axis] / pixel_um).ceil() as u32 + 2);
    // An even number, for the pairs of neighbours.
    let planes = (max_struts / peak_active.max(1)).clamp(MIN_PLANES, max_planes) as u32 & !1;
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

/// Number of lit pixels in each plane.
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
        let (z_um, shift_px) = place(plan, plane);
        slicer.draw_plane(z_um, shift_px, &mut bitmap)?;
        areas.push(lit(&bitmap));
        rest();
    }
    Ok(areas)
}

/// Number of lit pixels of each material in each plane.
fn areas_of_materials(file: &Arc<BuildFile>, plan: &SlicePlan, threads: usize) -> Result<Vec<Vec<f64>>, SliceError> {
    let sources = MaskSources::of(file);
    let budget = MemoryBudget::new(MaskSlicer::memory_bytes(&sources, plan, threads));
    let mut slicer = MaskSlicer::new(sources, plan.clone(), threads, 0, &budget)?;
    let mut masks = slicer.dark_masks();
    let mut areas = vec![Vec::with_capacity(plan.layer_count as usize); masks.len()];
    for plane in 0..plan.layer_count {
        let (z_um, shift_px) = place(plan, plane);
        slicer.draw_plane(z_um, shift_px, &mut masks)?;
        areas.iter_mut().zip(&masks).for_each(|(areas, mask)| areas.push(lit(mask)));
    }
    Ok(areas)
}

/// The height of a plane, micrometres, and by how much its pixels are shifted.
fn place(plan: &SlicePlan, plane: u32) -> (f64, [f64; 2]) {
    let [up, right, down] = EVEN.map(|step| (f64::from(plane) * step).fract());
    (plan.z0_um + (f64::from(plane) + up) * plan.layer_height_um, [right - 0.5, down - 0.5])
}

fn lit(bitmap: &Bitmap) -> f64 {
    f64::from(bitmap.data().iter().map(|byte| byte.count_ones()).sum::<u32>())
}

fn added(one: &[f64], other: &[f64]) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one + other).collect()
}

fn sum(areas: &[f64]) -> Estimate {
    Estimate { value: areas.iter().sum(), error: 2.0 * squares(areas.iter().copied()).sqrt() }
}

/// `None` if no pixel of the union is lit.
fn excess_percent(areas: &[f64], union: &[f64]) -> Option<Estimate> {
    let total = union.iter().sum::<f64>();
    let ratio = areas.iter().sum::<f64>() / total;
    let rest = areas.iter().zip(union).map(|(area, union)| area - ratio * union);
    (total > 0.0).then(|| Estimate { value: (ratio - 1.0) * 100.0, error: 200.0 * squares(rest).sqrt() / total })
}

/// Estimated variance of the sum of one sample from each slab: the sum of the squared differences within pairs of neighbours (collapsed
/// strata: Cochran 1977, Sampling Techniques, §5A.12). Its expectation is never too small; it is too large if the slabs' means differ.
fn squares(samples: impl Iterator<Item = f64>) -> f64 {
    let samples: Vec<f64> = samples.collect();
    samples.as_chunks::<2>().0.iter().map(|[one, other]| (one - other) * (one - other)).sum()
}
