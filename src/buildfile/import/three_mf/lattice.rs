//! Second pass: vertices, beams and balls of every placed lattice go to the collector.

use std::io::Read;

use glam::DVec3;

use super::structure::{Object, Structure, measure, object_name, required};
use super::xml::{Element, Space, Step, Xml};
use crate::buildfile::collect::{Beam, Collector};
use crate::buildfile::model::{Cap, Caps};
use crate::buildfile::pack::PackError;

/// Reads the lattices of a model whose structure is known.
pub(super) struct LatticeReader<'a, 'b, 'c> {
    pub(super) structure: &'a Structure,
    pub(super) collector: &'b mut Collector<'c>,
    pub(super) place: String,
    /// Most vertices of one object that may be held.
    pub(super) vertex_limit: usize,
    pub(super) short_count: u64,
}

/// The object being read.
struct Open<'a> {
    id: u32,
    object: &'a Object,
    vertices: Vec<DVec3>,
    /// Vertices that end a beam and bear no ball yet; kept for ball mode `all`.
    bare: Vec<bool>,
    beam_count: u64,
    defaults: Defaults,
}

#[derive(Default)]
struct Defaults {
    radius: f64,
    min_length: f64,
    cap: Cap,
    balls_everywhere: bool,
    balls_listed: bool,
    ball_radius: Option<f64>,
}

impl LatticeReader<'_, '_, '_> {
    /// Streams the model; `progress` takes the unpacked bytes read so far.
    ///
    /// # Errors
    /// [`PackError`] names object and beam.
    pub(super) fn read<R: Read>(&mut self, xml: &mut Xml<R>, progress: &mut dyn FnMut(u64)) -> Result<(), PackError> {
        let mut open: Option<Open<'_>> = None;
        let mut steps = 0;
        let structure = self.structure;
        loop {
            steps += 1u64;
            if steps.is_multiple_of(1 << 14) {
                progress(xml.position_bytes());
            }
            let step = xml.next().map_err(|problem| PackError::input(&self.place, problem))?;
            match step {
                None => break,
                Some(Step::Start(element)) if element.space == Space::Core && element.name() == "object" => {
                    self.close(open.take())?;
                    let id = required(element, "id").map_err(|problem| PackError::input(&self.place, problem))?;
                    let placed = structure.objects.get(&id).filter(|object| object.has_lattice);
                    open = placed.filter(|object| !object.placements.is_empty()).map(|object| Open {
                        id,
                        object,
                        vertices: Vec::new(),
                        bare: Vec::new(),
                        beam_count: 0,
                        defaults: Defaults::default(),
                    });
                }
                Some(Step::Start(element)) => {
                    if let Some(open) = &mut open {
                        self.element(open, element)?;
                    }
                }
                Some(Step::End) => {}
            }
        }
        self.close(open)
    }

    fn element(&mut self, open: &mut Open<'_>, element: &Element) -> Result<(), PackError> {
        let place = format_place(&self.place, open);
        let wrong = |problem: String| PackError::input(place(None), problem);
        match (element.space, element.name()) {
            (Space::Core, "vertex") => {
                if open.vertices.len() == self.vertex_limit {
                    return Err(wrong(format!(
                        "more than {} vertices, which do not fit --memory; give it more",
                        self.vertex_limit
                    )));
                }
                let axis = |name| measure(element, name)?.ok_or(format!("a vertex without {name}"));
                let read = || Ok(DVec3::new(axis("x")?, axis("y")?, axis("z")?));
                open.vertices.push(read().map_err(wrong)?);
            }
            (Space::Lattice, "beamlattice") => {
                open.defaults = Defaults::read(element).map_err(wrong)?;
                if open.object.placements.iter().any(|placed| placed.scale.is_none()) {
                    return Err(wrong(
                        "its transform stretches directions differently, which would make its round beams oval; \
                         use a uniform scale"
                            .into(),
                    ));
                }
            }
            (Space::Lattice, "beam") => {
                open.beam_count += 1;
                let number = open.beam_count;
                self.beam(open, element).map_err(|problem| match problem {
                    Problem::Text(text) => PackError::input(format_place(&self.place, open)(Some(number)), text),
                    Problem::Pack(error) => error,
                })?;
            }
            (Space::Balls | Space::Lattice, "ball") if open.defaults.balls_listed => {
                let index: usize = required(element, "vindex").map_err(wrong)?;
                let radius = measure(element, "r").map_err(wrong)?.or(open.defaults.ball_radius);
                let radius = radius.ok_or_else(|| wrong(format!("the ball at vertex {index} has no radius")))?;
                let count = open.vertices.len();
                let centre = *open
                    .vertices
                    .get(index)
                    .ok_or_else(|| wrong(format!("a ball at vertex {index}; there are {count} vertices")))?;
                if let Some(bare) = open.bare.get_mut(index) {
                    *bare = false;
                }
                self.ball(open, centre, radius)?;
            }
            _ => {}
        }
        Ok(())
    }

    fn beam(&mut self, open: &mut Open<'_>, element: &Element) -> Result<(), Problem> {
        let defaults = &open.defaults;
        let ends: [usize; 2] = [required(element, "v1")?, required(element, "v2")?];
        let count = open.vertices.len();
        let vertex = |index: usize| {
            open.vertices.get(index).copied().ok_or_else(|| format!("vertex {index}; there are {count} vertices"))
        };
        let [a, b] = [vertex(ends[0])?, vertex(ends[1])?];
        if ends[0] == ends[1] {
            return Err(format!("it begins and ends at vertex {}", ends[0]).into());
        }
        let radius_a = measure(element, "r1")?.unwrap_or(defaults.radius);
        let radius_b = measure(element, "r2")?.unwrap_or(radius_a);
        if radius_a <= 0.0 || radius_b <= 0.0 {
            return Err(format!("radii {radius_a} and {radius_b}; they must be greater than 0").into());
        }
        let caps = Caps { a: cap(element, "cap1", defaults.cap)?, b: cap(element, "cap2", defaults.cap)? };
        if a.distance(b) < defaults.min_length {
            self.short_count += 1;
            return Ok(());
        }
        if defaults.balls_everywhere {
            open.bare.resize(count, false);
            ends.iter().for_each(|&end| open.bare[end] = true);
        }
        let unit_mm = self.structure.unit_mm;
        let number = open.beam_count;
        for placed in &open.object.placements {
            let scale = placed.scale.unwrap_or(1.0) * unit_mm;
            let [a, b] = [a, b].map(|point| placed.transform.transform_point3(point) * unit_mm);
            let beam = Beam { a, b, radius_a: radius_a * scale, radius_b: radius_b * scale, caps };
            self.collector.beam(&beam, &|| format_place(&self.place, open)(Some(number))).map_err(Problem::Pack)?;
        }
        Ok(())
    }

    fn ball(&mut self, open: &Open<'_>, centre: DVec3, radius: f64) -> Result<(), PackError> {
        let unit_mm = self.structure.unit_mm;
        for placed in &open.object.placements {
            let centre = placed.transform.transform_point3(centre) * unit_mm;
            let radius = radius * placed.scale.unwrap_or(1.0) * unit_mm;
            self.collector.ball(centre, radius, &|| format!("{}: a ball", format_place(&self.place, open)(None)))?;
        }
        Ok(())
    }

    /// Ends an object: in ball mode `all`, beam ends without a ball of their own get the common one.
    fn close(&mut self, open: Option<Open<'_>>) -> Result<(), PackError> {
        let Some(open) = open else { return Ok(()) };
        if let Some(radius) = open.defaults.ball_radius.filter(|_| open.defaults.balls_everywhere) {
            for (centre, _) in open.vertices.iter().zip(&open.bare).filter(|(_, bare)| **bare) {
                self.ball(&open, *centre, radius)?;
            }
        }
        Ok(())
    }
}

enum Problem {
    Text(String),
    Pack(PackError),
}

impl From<String> for Problem {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// Names the object, and a beam of it by its number from 1.
fn format_place(place: &str, open: &Open<'_>) -> impl Fn(Option<u64>) -> String + use<> {
    let object = format!("{place}: {}", object_name(open.id, &open.object.name));
    move |beam| beam.map_or(object.clone(), |number| format!("{object}: beam {number}"))
}

impl Defaults {
    fn read(element: &Element) -> Result<Self, String> {
        let radius = measure(element, "radius")?.ok_or("a beam lattice without radius")?;
        let mode = element.get("ballmode").unwrap_or("none");
        if !["none", "mixed", "all"].contains(&mode) {
            return Err(format!("ballmode `{mode}`; allowed are none, mixed and all"));
        }
        let ball_radius = measure(element, "ballradius")?;
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
        Some(other) => Err(format!(
            "{name} = `{}`; allowed are sphere, hemisphere and butt",
            other.chars().take(40).collect::<String>()
        )),
    }
}
