//! Lattices of different materials, joined into one solid: each is swept and drawn on a strip of its own, and the strips become one.
//! `tests/materials/` compares its layers with the formulas.

mod masks;

use super::brush::{self, Strips};
use super::sweep::Sweep;
use super::{grid, radius_um, unit_um};
use crate::buildfile::{Joint, Strut};
use crate::layer::Depth;
use crate::slice::band::{Band, FieldBand};
use crate::slice::body::source::ChunkSource;
use crate::slice::body::{Body, Brush, Cut, FieldBody, FieldBrush, JoinedLattice, PixelBody};
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{
    Convolution, Effort, FieldOfMaterial, Grid, InstructionSet, JoinedShape, JoinedStretch, Joining, MAX_MATERIALS,
    Plane, SharedUnion, Strip,
};
use crate::stream::MemoryBudget;

pub(in crate::slice) use masks::{masks, masks_memory_bytes};

/// The lattices as one body.
struct Joined<S: JoinedShape> {
    /// The pixels of the plan, in the unit of length of the solid.
    grid: Grid,
    unit_um: f64,
    /// Largest radius of a strut, micrometres.
    radius_um: f64,
    members: Vec<Member<S>>,
    /// For each thread a strip of the whole.
    whole: Strips<S>,
    joining: Joining,
    /// The member of which alone the field is drawn.
    only: Option<usize>,
}

/// The lattice of one material.
struct Member<S: JoinedShape> {
    material: usize,
    sweep: Sweep,
    strips: Strips<S>,
}

/// Memory that [`pixels`] charges, bytes. It is known before a chunk is read.
pub(in crate::slice) fn pixels_memory_bytes(lattices: &[JoinedLattice], plan: &SlicePlan, threads: usize) -> u64 {
    match joint(lattices).support_um() {
        Some(_) => Joined::<Convolution>::memory_bytes(lattices, plan, brush::halo::<Convolution>(plan.depth), threads),
        None => Joined::<SharedUnion>::memory_bytes(lattices, plan, brush::halo::<SharedUnion>(plan.depth), threads),
    }
}

/// Memory that [`field`] charges, bytes.
pub(in crate::slice) fn field_memory_bytes(lattices: &[JoinedLattice], plan: &SlicePlan, threads: usize) -> u64 {
    match joint(lattices).support_um() {
        Some(_) => Joined::<Convolution>::memory_bytes(lattices, plan, 0, threads),
        None => lattices
            .iter()
            .fold(0, |sum: u64, one| sum.saturating_add(super::field_memory_bytes(&*one.lattice, plan, threads))),
    }
}

/// Joined lattices to be drawn as pixels with `instructions` on `threads` threads. Their memory is charged to `budget`.
///
/// # Errors
/// As [`super::pixels`].
pub(in crate::slice) fn pixels(
    instructions: InstructionSet,
    lattices: Vec<JoinedLattice>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn PixelBody>, SliceError> {
    let settings = Settings { instructions, plan, threads, budget };
    Ok(match joint(&lattices).support_um() {
        Some(_) => Box::new(settings.joined::<Convolution>(lattices, brush::halo::<Convolution>(plan.depth))?),
        None => Box::new(settings.joined::<SharedUnion>(lattices, brush::halo::<SharedUnion>(plan.depth))?),
    })
}

/// As [`pixels`], as a field.
///
/// # Errors
/// As [`pixels`].
pub(in crate::slice) fn field(
    instructions: InstructionSet,
    lattices: Vec<JoinedLattice>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn FieldBody>, SliceError> {
    if joint(&lattices).support_um().is_some() {
        let settings = Settings { instructions, plan, threads, budget };
        return Ok(Box::new(settings.joined::<Convolution>(lattices, 0)?));
    }
    let field = |one: JoinedLattice| super::field(instructions, one.lattice, plan, threads, budget);
    Ok(Box::new(Several(lattices.into_iter().map(field).collect::<Result<_, _>>()?)))
}

/// As [`field`], of one material of convolutions: where its field is the greatest.
///
/// # Errors
/// As [`field`].
pub(in crate::slice) fn field_of(
    instructions: InstructionSet,
    lattices: Vec<JoinedLattice>,
    material: u8,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn FieldBody>, SliceError> {
    let only = lattices.iter().position(|one| one.material == material);
    let settings = Settings { instructions, plan, threads, budget };
    Ok(Box::new(Joined { only, ..settings.joined::<Convolution>(lattices, 0)? }))
}

/// How the lattices are joined.
fn joint(lattices: &[JoinedLattice]) -> Joint {
    lattices.first().map_or(Joint::Union, |first| first.lattice.header().joint)
}

/// What all members have in common.
struct Settings<'a> {
    instructions: InstructionSet,
    plan: &'a SlicePlan,
    threads: usize,
    budget: &'a MemoryBudget,
}

impl Settings<'_> {
    fn joined<S: JoinedShape>(&self, lattices: Vec<JoinedLattice>, halo: usize) -> Result<Joined<S>, SliceError> {
        let Self { instructions, plan, threads, budget } = *self;
        let joining = joint(&lattices).joining();
        let unit_um = lattices.first().map_or(Ok(1.0), |first| unit_um(&*first.lattice))?;
        let mut radius = 0.0_f64;
        let mut members = Vec::new();
        for JoinedLattice { lattice, material } in lattices {
            unit_um_of_all(&*lattice, unit_um)?;
            radius = radius.max(radius_um(&*lattice));
            let strips = Strips::new(plan, instructions, halo, threads, budget)?;
            let sweep = Sweep::new::<S>(lattice, plan, unit_um, strips.rows_per_band(), threads, budget)?;
            members.push(Member { material: material.into(), sweep, strips });
        }
        let whole = Strips::new(plan, instructions, halo, threads, budget)?;
        Ok(Joined { grid: grid(plan, unit_um), unit_um, radius_um: radius, members, whole, joining, only: None })
    }
}

/// # Errors
/// If a member has another unit than the first.
fn unit_um_of_all(source: &dyn ChunkSource<Strut>, first_um: f64) -> Result<(), SliceError> {
    if unit_um(source)? == first_um {
        return Ok(());
    }
    Err(SliceError::Damaged("lattices that are joined have different supports".into()))
}

impl<S: JoinedShape> Joined<S> {
    fn memory_bytes(lattices: &[JoinedLattice], plan: &SlicePlan, halo: usize, threads: usize) -> u64 {
        let member = |one: &JoinedLattice| {
            Sweep::memory_bytes(&*one.lattice, plan, brush::rows_per_band::<S>(plan, halo), threads)
                .saturating_add(Strips::<S>::memory_bytes(plan, halo, threads))
        };
        let whole = Strips::<S>::memory_bytes(plan, halo, threads);
        lattices.iter().map(member).fold(whole, u64::saturating_add)
    }

    /// A brush for each thread.
    fn strip_brushes(&mut self, cut: &Cut) -> Vec<JoinedBrush<'_, S>> {
        let mut grid = self.grid;
        grid.x0 += cut.shift_px[0] * grid.dx;
        grid.y0 += cut.shift_px[1] * grid.dy;
        let instructions = self.whole.instructions();
        let (z, joining) = (cut.z_um / self.unit_um, self.joining);
        let mut brushes: Vec<_> = self
            .whole
            .each_mut()
            .map(|whole| JoinedBrush { grid, instructions, joining, members: Vec::new(), whole })
            .collect();
        for Member { material, sweep, strips } in &mut self.members {
            let plane = Plane { grid, z, quantum: sweep.quantum() };
            let active = sweep.active();
            for (brush, strip) in brushes.iter_mut().zip(strips.each_mut()) {
                let brush_of = brush::StripBrush { active, plane, instructions, strip };
                brush.members.push((*material, brush_of));
            }
        }
        brushes
    }
}

impl<S: JoinedShape> Body for Joined<S> {
    fn rows_per_band(&self) -> usize {
        self.whole.rows_per_band()
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.members.iter_mut().try_for_each(|member| member.sweep.advance(z_um, workers))
    }

    fn active_count(&self) -> usize {
        self.members.iter().map(|member| member.sweep.active().alive()).sum()
    }

    fn effort(&self) -> Effort {
        self.members.iter().map(|member| member.strips.effort()).sum()
    }
}

/// The brush of one thread.
struct JoinedBrush<'a, S: JoinedShape> {
    grid: Grid,
    instructions: InstructionSet,
    joining: Joining,
    /// Brushes of the members, with their materials.
    members: Vec<(usize, brush::StripBrush<'a, S>)>,
    whole: &'a mut Strip<S::Cell>,
}

impl<S: JoinedShape> JoinedBrush<'_, S> {
    /// Draws all members, and the whole.
    fn draw(&mut self, first: usize, count: usize, halo: usize) {
        self.draw_with(first, count, halo, |_, _| {});
    }

    /// Draws all members.
    fn draw_members(&mut self, first: usize, count: usize, halo: usize) {
        for (_, member) in &mut self.members {
            member.draw(first, count, halo);
        }
    }

    /// As [`JoinedBrush::draw`]. `after` takes cells of all members and those of the whole.
    fn draw_with(&mut self, first: usize, count: usize, halo: usize, after: impl Fn(&[&[S::Cell]], &mut [S::Cell])) {
        self.draw_members(first, count, halo);
        let Self { instructions, joining, members, whole, .. } = self;
        let strips: Vec<&Strip<S::Cell>> = members.iter().map(|(_, member)| &*member.strip).collect();
        whole.join(&strips, |cells, out| {
            S::join(*instructions, joining, cells, out);
            after(cells, out);
        });
    }
}

impl<S: JoinedShape> PixelBody for Joined<S> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>> {
        self.strip_brushes(cut).into_iter().map(|brush| Box::new(brush) as Box<dyn Brush>).collect()
    }
}

impl<S: JoinedShape> Brush for JoinedBrush<'_, S> {
    fn cover(&mut self, band: &mut Band<'_>) {
        let (first, count, width) = (band.rows().first, band.rows().count(), self.grid.width);
        if band.depth() == Depth::Grey {
            self.draw(first, count, brush::halo::<S>(Depth::Grey));
            return brush::merge_pixels::<S>(self.instructions, self.whole, width, band);
        }
        self.draw_members(first, count, 0);
        let strips: Vec<&Strip<S::Cell>> = self.members.iter().map(|(_, member)| &*member.strip).collect();
        for used in Strip::used_together(&strips, width) {
            let pixels = used.start..used.end.next_multiple_of(8);
            for (row, out) in band.rows_mut().each_mut().enumerate() {
                let mut cells: [&[S::Cell]; MAX_MATERIALS] = [&[]; MAX_MATERIALS];
                for (cells, strip) in cells.iter_mut().zip(&strips) {
                    *cells = strip.some_pixels(row, pixels.clone());
                }
                let cells = &cells[..strips.len()];
                let stretch = JoinedStretch::<S> { joining: &self.joining, cells, place: [pixels.start, first + row] };
                stretch.merge_bits(self.instructions, &mut out[pixels.start / 8..pixels.end / 8]);
            }
        }
    }
}

impl<S: FieldOfMaterial> FieldBody for Joined<S> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn FieldBrush + '_>> {
        let scale = brush::Scale::of::<S>(&self.grid, self.unit_um, self.radius_um);
        let only = self.only;
        let brushes = self.strip_brushes(cut).into_iter();
        brushes.map(|brush| Box::new(JoinedFieldBrush { brush, scale, only }) as Box<dyn FieldBrush>).collect()
    }
}

/// The brush of one thread that draws the field.
struct JoinedFieldBrush<'a, S: JoinedShape> {
    brush: JoinedBrush<'a, S>,
    scale: brush::Scale,
    only: Option<usize>,
}

impl<S: FieldOfMaterial> FieldBrush for JoinedFieldBrush<'_, S> {
    fn raise(&mut self, band: &mut FieldBand<'_>) {
        let Self { brush, scale, only } = self;
        brush.draw_with(band.first, band.count(), 0, |cells, whole| {
            if let Some(only) = *only {
                S::restrict(cells, only, whole);
            }
        });
        brush::merge_field::<S>(brush.whole, scale, brush.grid.width, band);
    }
}

/// The exact unions of all members as fields: the greatest excess counts.
struct Several(Vec<Box<dyn FieldBody>>);

impl Body for Several {
    fn rows_per_band(&self) -> usize {
        self.0.iter().map(|body| body.rows_per_band()).min().unwrap_or(1)
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.0.iter_mut().try_for_each(|body| body.advance(z_um, workers))
    }

    fn active_count(&self) -> usize {
        self.0.iter().map(|body| body.active_count()).sum()
    }

    fn effort(&self) -> Effort {
        self.0.iter().map(|body| body.effort()).sum()
    }
}

impl FieldBody for Several {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn FieldBrush + '_>> {
        let mut threads: Vec<SeveralBrushes<'_>> = Vec::new();
        for body in &mut self.0 {
            for (thread, brush) in body.brushes(cut).into_iter().enumerate() {
                if thread == threads.len() {
                    threads.push(SeveralBrushes(Vec::new()));
                }
                threads[thread].0.push(brush);
            }
        }
        threads.into_iter().map(|brushes| Box::new(brushes) as Box<dyn FieldBrush>).collect()
    }
}

/// The brushes of one thread.
struct SeveralBrushes<'a>(Vec<Box<dyn FieldBrush + 'a>>);

impl FieldBrush for SeveralBrushes<'_> {
    fn raise(&mut self, band: &mut FieldBand<'_>) {
        self.0.iter_mut().for_each(|brush| brush.raise(band));
    }
}
