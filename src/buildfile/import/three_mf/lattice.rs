//! The second pass: hands the beams, balls and triangles of every placed object to the collector. `tests/pack_3mf.rs` tests it.

use std::io::Read;

use glam::{DAffine3, DVec3};

use super::attributes::{finite, measure, optional, required};
use super::clipping::Clipped;
use super::displacement::Displaced;
use super::materials::Named;
use super::resources::Object;
use super::space::Space;
use super::structure::{Structure, ball_attribute, displacement_group};
use super::xml::{Element, Xml, quote};
use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::lane::Beam;
use crate::buildfile::import::materials::Mixture;
use crate::buildfile::import::relief::Face;
use crate::buildfile::model::{Cap, Caps};

/// Most beams, balls and triangles that share one walk over the places of their object: some 1 MiB.
const MAX_BLOCK_PIECES: usize = 4096;

/// Reads the lattices and meshes of a package whose structure is known.
pub(super) struct LatticeReader<'a, 'b, 'c> {
    pub(super) structure: &'a Structure,
    pub(super) collector: &'b mut Collector<'c>,
    /// The current part of the package, for errors.
    pub(super) place: String,
    /// Its number.
    pub(super) part: u32,
    /// Leave out meshes.
    pub(super) lattice_only: bool,
    /// Most vertices of one object.
    pub(super) vertex_limit: usize,
    /// Number of each height map of the displacements.
    pub(super) maps: Vec<u16>,
    /// What is clipped.
    pub(super) clipped: Clipped,
    /// The properties that were looked up last, of their part, and what they are.
    pub(super) last_mixture: Option<((u32, Named), Option<Mixture>)>,
    /// Beams shorter than the minimum length of their lattice.
    pub(super) short_count: u64,
    /// Beams from a vertex to itself.
    pub(super) pointless_count: u64,
}

/// The current object.
struct Open<'a> {
    number: u32,
    object: &'a Object,
    unit_mm: f64,
    vertices: Vec<DVec3>,
    /// For ball mode `all`: vertices at the end of a beam that have no ball yet.
    bare: Vec<bool>,
    beam_count: u64,
    triangle_count: u64,
    /// The displacement group of triangles that name none.
    group: Option<u32>,
    defaults: Defaults,
    /// Beams, balls and triangles that were read and are not placed yet.
    block: Vec<Piece>,
}

/// A beam, ball or triangle in millimetres, before it is placed.
enum Piece {
    /// A beam with its number in the lattice, counted from 1.
    Beam(Beam, u64),
    /// Centre, radius and material.
    Ball(DVec3, f64, Option<Mixture>),
    /// A triangle with its number in the mesh, counted from 1.
    Triangle([DVec3; 3], Option<Displaced>, u64),
}

/// Attributes of the lattice that hold for all its beams and balls.
#[derive(Default)]
struct Defaults {
    radius: f64,
    min_length: f64,
    cap: Cap,
    balls_everywhere: bool,
    balls_listed: bool,
    ball_radius: Option<f64>,
}

impl<'a> LatticeReader<'a, '_, '_> {
    /// Reads one part of the package. `progress` takes the unpacked bytes read so far.
    ///
    /// # Errors
    /// [`PackError`] names object and beam.
    pub(super) fn read<R: Read>(&mut self, xml: &mut Xml<R>, progress: &mut dyn FnMut(u64)) -> Result<(), PackError> {
        let mut open: Option<Open<'a>> = None;
        let mut steps = 0u64;
        loop {
            steps += 1;
            if steps.is_multiple_of(1 << 14) {
                progress(xml.position_bytes());
            }
            let Some(element) = xml.next().map_err(|problem| PackError::input(&self.place, problem))? else { break };
            if (element.space, element.name()) == (Space::Core, "object") {
                self.close(open.take())?;
                let id = required(element, "id").map_err(|problem| PackError::input(&self.place, problem))?;
                open = self.open(id);
                if let Some(open) = &open {
                    let has_relief = open.object.has_displacement && self.collector.meshes.takes_maps();
                    self.collector.meshes.begin_solid(has_relief);
                }
            } else if let Some(open) = &mut open {
                self.element(open, element)?;
            }
        }
        self.close(open)
    }

    /// Begins an object. `None` if it clips nothing, and has nothing to print or is not in the build.
    fn open(&self, id: u32) -> Option<Open<'a>> {
        let number = self.structure.resources.number((self.part, id))?;
        let object = &self.structure.resources.objects[number as usize];
        let is_wanted = object.has_lattice || object.triangle_count > 0 && !self.lattice_only;
        let is_printed = is_wanted && self.structure.place_count(number) > 0;
        (is_printed || self.clipped.has_mesh(number)).then(|| Open {
            number,
            object,
            unit_mm: self.structure.units_mm[self.part as usize],
            vertices: Vec::new(),
            bare: Vec::new(),
            beam_count: 0,
            triangle_count: 0,
            group: object.group,
            defaults: Defaults::default(),
            block: Vec::new(),
        })
    }

    fn element(&mut self, open: &mut Open<'_>, element: &Element) -> Result<(), PackError> {
        match (element.space, element.name()) {
            // A displacement mesh writes its vertices in its own namespace.
            (Space::Core | Space::Displacement, "vertex") => {
                let vertex = self.vertex(open, element).map_err(|problem| self.wrong(open, None, problem))?;
                open.vertices.push(vertex);
            }
            (Space::Displacement, "triangles") => {
                let group = displacement_group(element).map_err(|problem| self.wrong(open, None, problem))?;
                open.group = group.or(open.object.group);
            }
            (Space::Core | Space::Displacement, "triangle") if !self.lattice_only => {
                open.triangle_count += 1;
                let number = open.triangle_count;
                let read = triangle(open, element).and_then(|corners| Ok((corners, self.displaced(open, element)?)));
                let (corners, displaced) =
                    read.map_err(|problem| self.wrong(open, None, format!("triangle {number}: {problem}")))?;
                open.block.push(Piece::Triangle(corners, displaced, number));
            }
            (Space::Lattice, "beamlattice") => {
                open.defaults = Defaults::read(element).map_err(|problem| self.wrong(open, None, problem))?;
            }
            (Space::Lattice, "beam") => {
                open.beam_count += 1;
                let number = open.beam_count;
                let beam = self.beam(open, element).map_err(|problem| self.wrong(open, Some(number), problem))?;
                open.block.extend(beam.map(|beam| Piece::Beam(beam, number)));
            }
            (Space::Balls | Space::Lattice, "ball") if open.defaults.balls_listed => {
                let read = ball(open, element).and_then(|(centre, radius)| {
                    // A ball has one material.
                    let mixture = self.mixture(open, Named::read(element, ["p", "p"])?)?;
                    Ok(Piece::Ball(centre, radius, mixture))
                });
                let ball = read.map_err(|problem| self.wrong(open, None, problem))?;
                open.block.push(ball);
            }
            _ => {}
        }
        if open.block.len() >= MAX_BLOCK_PIECES { self.place_block(open) } else { Ok(()) }
    }

    fn vertex(&self, open: &Open<'_>, element: &Element) -> Result<DVec3, String> {
        if open.vertices.len() == self.vertex_limit {
            return Err(format!("more than {} vertices, which do not fit --memory; give it more", self.vertex_limit));
        }
        let axis = |name| measure(element, name)?.ok_or(format!("a vertex without {name}"));
        Ok(DVec3::new(axis("x")?, axis("y")?, axis("z")?))
    }

    /// How a triangle is displaced; `None` if it is not.
    fn displaced(&self, open: &Open<'_>, element: &Element) -> Result<Option<Displaced>, String> {
        let first = optional(element, "d1")?.filter(|_| self.collector.meshes.takes_maps());
        let Some(first) = first else { return Ok(None) };
        let corners = [first, optional(element, "d2")?.unwrap_or(first), optional(element, "d3")?.unwrap_or(first)];
        let group = displacement_group(element)?.or(open.group);
        let group = group.ok_or("d1, but neither it nor its mesh or object has a did")?;
        self.structure.displacements.displaced(self.part, group, corners).map(Some)
    }

    /// A triangle at one of its places.
    fn face(
        &mut self,
        open: &Open<'_>,
        corners: [DVec3; 3],
        displaced: &Displaced,
        placed: &DAffine3,
    ) -> Result<Face, PackError> {
        let Displaced { textures, vectors, factors, .. } = *displaced;
        let wrong = |problem: &str| PackError::input(&self.place, problem);
        let group = self.structure.displacements.group_at(displaced.group).ok_or_else(|| wrong("a group is gone"))?;
        let map = *self.maps.get(displaced.map).ok_or_else(|| wrong("a map is gone"))?;
        let [low_mm, high_mm] = [group.offset, group.offset + group.height].map(|length| length * open.unit_mm);
        let [low_mm, high_mm] = self.collector.meshes.height_range([low_mm, high_mm]);
        let named = || place(self.structure, &self.place, open, None);
        let meshes = &mut self.collector.meshes;
        let (number, turn) = meshes.placed_displacement(map, [high_mm - low_mm, low_mm], placed.matrix3, &named)?;
        Ok(Face {
            directions: Some(vectors.map(|vector| turn * vector)),
            textures: Some(textures),
            factors,
            displacement: Some(number),
            ..Face::flat(corners)
        })
    }

    /// A beam in millimetres. `None` if it is left out because of its length.
    fn beam(&mut self, open: &mut Open<'_>, element: &Element) -> Result<Option<Beam>, String> {
        let defaults = &open.defaults;
        let ends: [usize; 2] = [required(element, "v1")?, required(element, "v2")?];
        let count = open.vertices.len();
        let vertex = |index: usize| {
            open.vertices.get(index).copied().ok_or_else(|| format!("vertex {index}; there are {count} vertices"))
        };
        let [a, b] = [vertex(ends[0])?, vertex(ends[1])?];
        let radius_a = measure(element, "r1")?.unwrap_or(defaults.radius);
        let radius_b = measure(element, "r2")?.unwrap_or(radius_a);
        if radius_a <= 0.0 || radius_b <= 0.0 {
            return Err(format!("radii {radius_a} and {radius_b}; they must be greater than 0"));
        }
        let caps = Caps { a: cap(element, "cap1", defaults.cap)?, b: cap(element, "cap2", defaults.cap)? };
        if ends[0] == ends[1] {
            self.pointless_count += 1;
            return Ok(None);
        }
        if a.distance(b) < defaults.min_length {
            self.short_count += 1;
            return Ok(None);
        }
        if defaults.balls_everywhere {
            open.bare.resize(count, false);
            ends.iter().for_each(|&end| open.bare[end] = true);
        }
        let unit_mm = open.unit_mm;
        let mixture = self.mixture(open, Named::read(element, ["p1", "p2"])?)?;
        Ok(Some(Beam {
            a: a * unit_mm,
            b: b * unit_mm,
            radius_a: radius_a * unit_mm,
            radius_b: radius_b * unit_mm,
            caps,
            mixture,
        }))
    }

    /// What a beam or ball with these properties consists of.
    fn mixture(&mut self, open: &Open<'_>, named: Named) -> Result<Option<Mixture>, String> {
        let named = named.or(open.object.properties);
        if let Some((_, mixture)) = self.last_mixture.filter(|(known, _)| *known == (self.part, named)) {
            return Ok(mixture);
        }
        let mixture = self.structure.properties.mixture(self.part, named, self.collector.materials())?;
        self.last_mixture = Some(((self.part, named), mixture));
        Ok(mixture)
    }

    /// Hands the block to the collector, once for each place of the object.
    fn place_block(&mut self, open: &mut Open<'_>) -> Result<(), PackError> {
        let block = std::mem::take(&mut open.block);
        if block.is_empty() {
            return Ok(());
        }
        self.place_clips(open, &block)?;
        for (number, placed) in self.structure.places(open.number).enumerate() {
            let lane = self.clipped.lanes(open.number).map(|lanes| lanes[number]);
            // A mirrored triangle shows its other side.
            let is_mirrored = placed.matrix3.determinant() < 0.0;
            let Some(stretch) = self.collector.stretch_after(placed.matrix3) else {
                return Err(self.wrong(open, None, "its transform flattens it".into()));
            };
            for piece in &block {
                match *piece {
                    Piece::Beam(beam, number) => {
                        let [a, b] = [beam.a, beam.b].map(|point| placed.transform_point3(point));
                        let named = || place(self.structure, &self.place, open, Some(number));
                        self.collector.beam(&Beam { a, b, ..beam }, stretch, lane, &named)?;
                    }
                    Piece::Triangle(corners, displaced, number) => {
                        let corners = corners.map(|corner| placed.transform_point3(corner));
                        let mut face = match &displaced {
                            Some(displaced) => self.face(open, corners, displaced, &placed)?,
                            None => Face::flat(corners),
                        };
                        if is_mirrored {
                            face.turn_around();
                        }
                        let named = || format!("{}: triangle {number}", place(self.structure, &self.place, open, None));
                        self.collector.meshes.face(&face, &named)?;
                    }
                    Piece::Ball(centre, radius, mixture) => {
                        let centre = placed.transform_point3(centre);
                        let named = || format!("{}: a ball", place(self.structure, &self.place, open, None));
                        self.collector.ball(centre, radius, mixture, stretch, lane, &named)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// Hands the triangles of a block to what they clip, once for each place.
    fn place_clips(&mut self, open: &Open<'_>, block: &[Piece]) -> Result<(), PackError> {
        for (placed, lane) in self.clipped.places_of(open.number, self.structure) {
            let surface = self.collector.clips.surface(lane);
            for piece in block {
                let Piece::Triangle(corners, _, number) = piece else { continue };
                let mut corners = corners.map(|corner| placed.transform_point3(corner));
                if placed.matrix3.determinant() < 0.0 {
                    corners.swap(1, 2);
                }
                let named = || format!("{}: triangle {number}", place(self.structure, &self.place, open, None));
                surface.triangle(corners, &named)?;
            }
        }
        Ok(())
    }

    /// Ends an object. In ball mode `all`, ends of beams without a listed ball get the default ball.
    fn close(&mut self, open: Option<Open<'_>>) -> Result<(), PackError> {
        let Some(mut open) = open else { return Ok(()) };
        if let Some(radius) = open.defaults.ball_radius.filter(|_| open.defaults.balls_everywhere) {
            let mixture = self.mixture(&open, Named::default()).map_err(|problem| self.wrong(&open, None, problem))?;
            for vertex in 0..open.bare.len() {
                if open.bare[vertex] {
                    let centre = open.vertices[vertex] * open.unit_mm;
                    open.block.push(Piece::Ball(centre, radius * open.unit_mm, mixture));
                }
                if open.block.len() >= MAX_BLOCK_PIECES {
                    self.place_block(&mut open)?;
                }
            }
        }
        self.place_block(&mut open)?;
        let named = place(self.structure, &self.place, &open, None);
        let mut ended = self.clipped.lanes_of(open.number).into_iter();
        ended.try_for_each(|lane| self.collector.clips.surface(lane).end_solid(&named))?;
        if open.triangle_count == 0 || self.structure.place_count(open.number) == 0 {
            return Ok(());
        }
        self.collector.meshes.end_solid(&named)
    }

    fn wrong(&self, open: &Open<'_>, beam: Option<u64>, problem: String) -> PackError {
        PackError::input(place(self.structure, &self.place, open, beam), problem)
    }
}

/// Names the object, and the beam by its number counted from 1.
fn place(structure: &Structure, part: &str, open: &Open<'_>, beam: Option<u64>) -> String {
    let object = structure.resources.name(open.object.id);
    beam.map_or(format!("{part}: {object}"), |number| format!("{part}: {object}: beam {number}"))
}

/// A triangle in millimetres.
fn triangle(open: &Open<'_>, element: &Element) -> Result<[DVec3; 3], String> {
    let count = open.vertices.len();
    let corner = |name| {
        let index: usize = required(element, name)?;
        let vertex = open.vertices.get(index).map(|vertex| *vertex * open.unit_mm);
        vertex.ok_or_else(|| format!("vertex {index}; there are {count} vertices"))
    };
    Ok([corner("v1")?, corner("v2")?, corner("v3")?])
}

/// Centre and radius of a ball in millimetres.
fn ball(open: &mut Open<'_>, element: &Element) -> Result<(DVec3, f64), String> {
    let index: usize = required(element, "vindex")?;
    let radius = measure(element, "r")?.or(open.defaults.ball_radius);
    let radius = radius.ok_or_else(|| format!("the ball at vertex {index} has no radius"))?;
    let count = open.vertices.len();
    let centre = open.vertices.get(index);
    let centre = *centre.ok_or_else(|| format!("a ball at vertex {index}; there are {count} vertices"))?;
    if let Some(bare) = open.bare.get_mut(index) {
        *bare = false;
    }
    Ok((centre * open.unit_mm, radius * open.unit_mm))
}

impl Defaults {
    fn read(element: &Element) -> Result<Self, String> {
        let radius = measure(element, "radius")?.ok_or("a beam lattice without radius")?;
        let mode = ball_attribute(element, "ballmode").unwrap_or("none");
        if !["none", "mixed", "all"].contains(&mode) {
            return Err(format!("ballmode `{}`; allowed are none, mixed and all", quote(mode)));
        }
        let ball_radius =
            ball_attribute(element, "ballradius").map(|text| finite(element, "ballradius", text)).transpose()?;
        if mode == "all" && ball_radius.is_none() {
            return Err("ballmode `all` without ballradius".into());
        }
        Ok(Self {
            radius,
            min_length: measure(element, "minlength")?.unwrap_or(0.0),
            cap: cap(element, "cap", Cap::Sphere)?,
            balls_everywhere: mode == "all",
            balls_listed: mode != "none",
            ball_radius,
        })
    }
}

fn cap(element: &Element, name: &str, default: Cap) -> Result<Cap, String> {
    match element.get(name) {
        None => Ok(default),
        Some("sphere") => Ok(Cap::Sphere),
        Some("hemisphere") => Ok(Cap::Hemisphere),
        Some("butt") => Ok(Cap::Butt),
        Some(other) => Err(format!("{name} = `{}`; allowed are sphere, hemisphere and butt", quote(other))),
    }
}
