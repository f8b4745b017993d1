//! Looks in the layers of a part for what its surfaces have that a printer cannot form, or that may be meant otherwise. `layerctl check` shows
//! it; `tests/surface/inspected.rs` and `tests/check/` test it.

use std::time::{Duration, Instant};

use super::enclosed::enclosed_twice;
use super::walls::{Thin, Walls};
use super::{BodySource, SliceError, SlicePlan, Slicer};
use crate::layer::{Bitmap, Depth};
use crate::stream::MemoryBudget;

/// Height through which a wall goes on at least, pixels. A ridge sharper than 28° is as thin over this height, and is a wall, too.
const LEAST_HEIGHT_PX: f64 = 2.0;

/// What was found in layers. A layer that was not looked at counts like the nearest layer below it that was.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inspection {
    /// Number of layers that were looked at.
    pub looked_at: u32,
    /// Ranges of layers, first to last, with walls thinner than a pixel: they may print broken or not at all.
    pub thin: Vec<[u32; 2]>,
    /// The thinnest of those that come first in their layers, row by row.
    pub thinnest: Option<ThinWall>,
    /// Ranges of layers, first to last, in which something is enclosed more than once: by pieces that overlap, or by a surface within
    /// another that faces the same way.
    pub enclosed_twice: Vec<[u32; 2]>,
}

/// A wall thinner than a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinWall {
    /// The layer.
    pub layer: u32,
    /// Column and row of the picture.
    pub pixel: [u32; 2],
    /// Thickness along a row or a column, pixels.
    pub thickness_px: f64,
}

impl Inspection {
    /// Looks at the surfaces among the bodies that `bodies` returns, on `threads` threads: at all layers of `plan`, or at as many evenly spaced
    /// ones as there is `time` for, and always at the first and the last. Calls `told` with each layer. Nothing is found in lattices.
    ///
    /// # Errors
    /// [`SliceError`] if a layer cannot be computed.
    pub fn of(
        bodies: impl Fn() -> Vec<BodySource>,
        plan: &SlicePlan,
        threads: usize,
        time: Duration,
        mut told: impl FnMut(u32),
    ) -> Result<Self, SliceError> {
        let is_surface = |body: &BodySource| matches!(body, BodySource::Surface(_) | BodySource::Relief(_));
        let surfaces: Vec<_> = bodies().into_iter().filter(is_surface).collect();
        let mut found = Self::default();
        if surfaces.is_empty() {
            return Ok(found);
        }
        let mut grey = Drawing::new(surfaces, &SlicePlan { depth: Depth::Grey, ..plan.clone() }, threads)?;
        let twice = bodies().into_iter().filter_map(enclosed_twice).collect();
        let mut twice = Drawing::new(twice, &SlicePlan { depth: Depth::Bit, ..plan.clone() }, threads)?;
        let mut walls = Walls::new(plan.raster.width_px);
        let mut heights = Heights::new(plan);
        let began = Instant::now();
        let (mut layer, last) = (0, plan.layer_count - 1);
        loop {
            found.looked_at += 1;
            let picture = grey.draw(layer)?;
            let thin = walls.find(picture.data().chunks(picture.stride_bytes()));
            heights.add(layer, thin, &mut found);
            let is_twice = is_lit(twice.draw(layer)?);
            told(layer);
            let step = if heights.is_open() { 1 } else { step(began.elapsed(), time, found.looked_at, last - layer) };
            let next = layer + step;
            if is_twice {
                add_layers(&mut found.enclosed_twice, [layer, next - 1]);
            }
            if layer == last {
                heights.end(next, &mut found);
                return Ok(found);
            }
            layer = next;
        }
    }
}

/// How high walls go on. A roof is thin at its ridge, in few layers; a wall is thin in many.
struct Heights {
    /// Layers through which a wall goes on at least.
    least: u32,
    /// The layers of the present wall that were looked at, first and last, and the thinnest place.
    open: Option<([u32; 2], ThinWall)>,
}

impl Heights {
    fn new(plan: &SlicePlan) -> Self {
        let [x_um, y_um] = plan.raster.pixel_um;
        Self { least: (LEAST_HEIGHT_PX * x_um.max(y_um) / plan.layer_height_um).ceil() as u32, open: None }
    }

    /// Whether it is not known yet if what was found is a wall.
    fn is_open(&self) -> bool {
        self.open.as_ref().is_some_and(|([first, last], _)| last - first + 1 < self.least)
    }

    /// Adds what was found in a layer.
    fn add(&mut self, layer: u32, thin: Option<Thin>, found: &mut Inspection) {
        let Some(Thin { at, thickness_px }) = thin else { return self.end(layer, found) };
        let wall = ThinWall { layer, pixel: at, thickness_px };
        match &mut self.open {
            Some((layers, thinnest)) => {
                layers[1] = layer;
                *thinnest = thinner(*thinnest, wall);
            }
            None => self.open = Some(([layer; 2], wall)),
        }
    }

    /// Ends the wall below a layer.
    fn end(&mut self, above: u32, found: &mut Inspection) {
        let is_wall = !self.is_open();
        if let Some(([first, _], wall)) = self.open.take()
            && is_wall
        {
            add_layers(&mut found.thin, [first, above - 1]);
            found.thinnest = Some(found.thinnest.map_or(wall, |thinnest| thinner(thinnest, wall)));
        }
    }
}

fn thinner(one: ThinWall, other: ThinWall) -> ThinWall {
    if other.thickness_px < one.thickness_px { other } else { one }
}

/// Number of dark layers at the top, of those that a slicer still has to draw.
///
/// # Errors
/// As [`Slicer::next_layer`].
pub fn dark_top(slicer: &mut Slicer) -> Result<u32, SliceError> {
    let plan = slicer.plan();
    let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
    let mut dark = 0;
    while slicer.next_layer(&mut bitmap)?.is_some() {
        dark = if is_lit(&bitmap) { 0 } else { dark + 1 };
    }
    Ok(dark)
}

/// How many layers farther the next one is, if `looked_at` took `elapsed` and `rest` layers are left: so many that the time suffices.
fn step(elapsed: Duration, time: Duration, looked_at: u32, rest: u32) -> u32 {
    let each = elapsed.as_secs_f64() / f64::from(looked_at);
    let left = time.saturating_sub(elapsed).as_secs_f64();
    ((each * f64::from(rest) / left).ceil() as u32).clamp(1, rest.max(1))
}

/// Adds layers, first to last, behind or next to the last range.
pub(crate) fn add_layers(ranges: &mut Vec<[u32; 2]>, [first, last]: [u32; 2]) {
    match ranges.last_mut() {
        Some(range) if range[1] + 1 >= first => range[1] = last,
        _ => ranges.push([first, last]),
    }
}

fn is_lit(bitmap: &Bitmap) -> bool {
    bitmap.data().iter().any(|byte| *byte != 0)
}

/// Bodies, and the picture of a layer of them.
struct Drawing {
    slicer: Slicer,
    bitmap: Bitmap,
}

impl Drawing {
    fn new(bodies: Vec<BodySource>, plan: &SlicePlan, threads: usize) -> Result<Self, SliceError> {
        let budget = MemoryBudget::new(Slicer::memory_bytes(&bodies, plan, threads));
        let slicer = Slicer::new(bodies, plan.clone(), threads, 0, &budget)?;
        let bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
        Ok(Self { slicer, bitmap })
    }

    /// A layer, which is not lower than the one before.
    fn draw(&mut self, layer: u32) -> Result<&Bitmap, SliceError> {
        let z_um = self.slicer.plan().layer_z_um(layer);
        self.slicer.draw_plane(z_um, [0.0; 2], &mut self.bitmap)?;
        Ok(&self.bitmap)
    }
}
