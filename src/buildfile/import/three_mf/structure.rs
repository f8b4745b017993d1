//! The first pass: reads units, objects, components and build items of all parts, without vertices and beams, and finds out where each
//! lattice is placed. `tests/pack_assembly.rs` tests it.

use std::collections::HashMap;
use std::io::Read;
use std::rc::Rc;

use glam::DAffine3;

use super::assembly::Assembly;
use super::attributes::{optional, required, transform};
use super::clipping::Clipping;
use super::displacement::Displacements;
use super::extensions::Extensions;
use super::materials::{Named, Properties};
use super::package::{Names, Package};
use super::part_name;
use super::resources::{LeftOut, Object, ObjectId, Resources};
use super::space::Space;
use super::xml::{Element, Xml, quote};
use crate::buildfile::error::PackError;
use crate::text::count_text;

/// Most model parts of a package: each is opened twice, and slicing programs write one for each object on a plate.
const MAX_PARTS: usize = 1024;

/// Memory that objects, components and build items may always take, bytes: enough for half a million.
const FREE_BYTES: u64 = 64 << 20;

/// Result of the first pass.
pub(super) struct Structure {
    pub(super) resources: Resources,
    /// Length of the unit of each part, millimetres.
    pub(super) units_mm: Vec<f64>,
    /// One sentence for each thing that was ignored.
    pub(super) notes: Vec<String>,
    pub(super) displacements: Displacements,
    pub(super) properties: Properties,
    assembly: Assembly,
}

impl Structure {
    /// Reads the model and the parts that it refers to. Objects, components and build items may take `memory_bytes`.
    ///
    /// # Errors
    /// [`PackError`] names part and object or element, what was found and what is allowed.
    pub(super) fn read(package: &mut Package<'_>, memory_bytes: u64) -> Result<Self, PackError> {
        let root = package.root().to_owned();
        let root_place = package.place(&root);
        let wrong = |problem: String| PackError::input(&root_place, problem);
        let names = package.names();
        let entry = names.entry(&root).map_err(wrong)?;
        let mut reader = Reader {
            names,
            numbers: HashMap::from([(entry, 0)]),
            resources: Resources::new(root),
            units_mm: Vec::new(),
            extensions: Extensions::default(),
            displacements: Displacements::default(),
            properties: Properties::default(),
            limit_bytes: usize::try_from(memory_bytes.max(FREE_BYTES)).unwrap_or(usize::MAX),
        };
        while let Some(part) = reader.resources.part_names.get(reader.units_mm.len()).cloned() {
            let place = package.place(&part);
            reader.part(package.part(&part)?).map_err(|problem| PackError::input(place, problem))?;
        }
        reader.finish(package.has_keystore).map_err(wrong)
    }

    /// Number of beams and balls in the build, at most: some may be left out because of their length.
    pub(super) fn strut_count(&self) -> u64 {
        self.placed_count(|object| object.strut_count)
    }

    /// Number of triangles in the build.
    pub(super) fn triangle_count(&self) -> u64 {
        self.placed_count(|object| object.triangle_count)
    }

    fn placed_count(&self, count: impl Fn(&Object) -> u64) -> u64 {
        let objects = self.resources.objects.iter().zip(0..);
        let placed = objects.map(|(object, number)| count(object).saturating_mul(self.place_count(number)));
        placed.fold(0, u64::saturating_add)
    }

    /// How often the build contains an object.
    pub(super) fn place_count(&self, object: u32) -> u64 {
        self.assembly.count(object)
    }

    /// The places of an object in the build: maps from its coordinates to those of the build, both in millimetres.
    pub(super) fn places(&self, object: u32) -> impl Iterator<Item = DAffine3> {
        self.assembly.places(object, &self.resources)
    }
}

/// Reads the parts one after another.
struct Reader {
    names: Rc<Names>,
    /// Numbers of the parts, by their entries in the archive.
    numbers: HashMap<usize, u32>,
    resources: Resources,
    /// Units of the parts read so far, including the current one.
    units_mm: Vec<f64>,
    extensions: Extensions,
    displacements: Displacements,
    properties: Properties,
    /// Limit of the memory of the resources.
    limit_bytes: usize,
}

impl Reader {
    fn part<R: Read>(&mut self, mut xml: Xml<R>) -> Result<(), String> {
        let root = xml.next()?.ok_or("the document is empty")?;
        self.model(root)?;
        // Components belong to the preceding object of the same part.
        let mut current = None;
        while let Some(element) = xml.next()? {
            self.element(element, &mut current)?;
            if self.resources.bytes() + self.displacements.bytes + self.properties.bytes > self.limit_bytes {
                return Err(format!(
                    "its objects, components, build items, materials and displacements take more than {} MiB, which do not fit --memory; give it more",
                    self.limit_bytes >> 20
                ));
            }
        }
        self.extensions.found(xml.into_foreign())
    }

    fn model(&mut self, element: &Element) -> Result<(), String> {
        if (element.space, element.name()) != (Space::Core, "model") {
            return Err(format!("the root element is `{}`, not a 3MF core `model`", element.name()));
        }
        self.units_mm.push(match element.get("unit").unwrap_or("millimeter") {
            "micron" => 0.001,
            "millimeter" => 1.0,
            "centimeter" => 10.0,
            "inch" => 25.4,
            "foot" => 304.8,
            "meter" => 1000.0,
            other => {
                let other = quote(other);
                return Err(format!("unit `{other}`; 3MF knows micron, millimeter, centimeter, inch, foot and meter"));
            }
        });
        let prefixes = element.get("requiredextensions").unwrap_or("").split_ascii_whitespace();
        prefixes.into_iter().try_for_each(|prefix| self.extensions.require(prefix, element.binding(prefix)))
    }

    fn element(&mut self, element: &Element, current: &mut Option<u32>) -> Result<(), String> {
        let unit_mm = self.units_mm[self.number() as usize];
        match (element.space, element.name()) {
            (Space::Core, "object") => *current = Some(self.object(element)?),
            (Space::Core, "component") => {
                let target = self.reference(element)?;
                self.current(element, *current)?;
                self.resources.add_component(target, transform(element, unit_mm)?);
            }
            // Only the build of the first part is printed.
            (Space::Core, "item") if self.number() == 0 => {
                let target = self.reference(element)?;
                if is_printable(element)? {
                    self.resources.add_item(target, transform(element, unit_mm)?);
                } else {
                    self.resources.add_unprinted(target);
                }
            }
            (Space::Core | Space::Displacement, "vertex") => self.current(element, *current)?.vertex_count += 1,
            (Space::Lattice, "beam" | "ball") | (Space::Balls, "ball") => {
                self.current(element, *current)?.strut_count += 1;
            }
            (Space::Core | Space::Displacement, "triangle") => self.current(element, *current)?.triangle_count += 1,
            (Space::Displacement, "displacementmesh") => self.current(element, *current)?.has_displacement = true,
            (Space::Displacement, _) => self.displacements.element(self.number(), element)?,
            (Space::Lattice, "beamlattice") => lattice(element, self.current(element, *current)?)?,
            _ => self.properties.element(self.number(), element)?,
        }
        Ok(())
    }

    /// The number of the current part.
    fn number(&self) -> u32 {
        self.units_mm.len() as u32 - 1
    }

    fn object(&mut self, element: &Element) -> Result<u32, String> {
        let is_other = match element.get("type").unwrap_or("model") {
            "model" | "solidsupport" | "support" | "surface" => false,
            "other" => true,
            other => {
                let other = quote(other);
                return Err(format!("type `{other}`; allowed are model, solidsupport, support, surface and other"));
            }
        };
        let id = (self.number(), required(element, "id")?);
        let name = quote(element.get("name").unwrap_or(""));
        let group = displacement_group(element)?;
        let properties = Named::read(element, ["pindex", "pindex"])?;
        self.resources.add(Object { id, name, is_other, group, properties, ..Object::default() })
    }

    fn current(&mut self, element: &Element, current: Option<u32>) -> Result<&mut Object, String> {
        let object = current.map(|number| &mut self.resources.objects[number as usize]);
        object.ok_or_else(|| format!("`{}` stands outside of any object", element.name()))
    }

    /// The object that a component or item refers to. If it names a part, that part is read later.
    fn reference(&mut self, element: &Element) -> Result<ObjectId, String> {
        let id = required(element, "objectid")?;
        // Some programs write it without a prefix.
        let path = element.get_of(Space::Production, "path").or(element.get("path"));
        let Some(path) = path else { return Ok((self.number(), id)) };
        let name = part_name::resolve(path);
        let entry = self.names.entry(&name);
        let entry = entry
            .map_err(|problem| format!("`{}` refers to object {id} in another part: {problem}", element.name()))?;
        let count = self.numbers.len();
        let part = *self.numbers.entry(entry).or_insert(count as u32);
        if part as usize == count {
            if count == MAX_PARTS {
                return Err(format!("the package spreads its model over more than {MAX_PARTS} parts"));
            }
            self.resources.part_names.push(name);
        }
        Ok((part, id))
    }

    fn finish(mut self, has_keystore: bool) -> Result<Structure, String> {
        let mut notes = self.extensions.check(has_keystore)?;
        if !self.resources.has_items() {
            return Err(
                "the model has no build items, so there is nothing to print; place its objects in the build in the program that \
                 wrote it"
                    .into(),
            );
        }
        let items = self.resources.close();
        let assembly = Assembly::new(&self.resources, items)?;
        let mut unprinted = LeftOut::default();
        self.resources.unprinted.iter().for_each(|&id| unprinted.add(|| self.resources.name(id)));
        notes.extend(
            unprinted
                .note(|count| format!("left out {} marked printable=\"0\"", count_text(count as u64, "build item"))),
        );
        notes.extend(assembly.others.note(|count| {
            format!(
                "left out {} of type `other`, which 3MF does not print, with all components",
                count_text(count as u64, "object")
            )
        }));
        Ok(Structure {
            resources: self.resources,
            units_mm: self.units_mm,
            notes,
            displacements: self.displacements,
            properties: self.properties,
            assembly,
        })
    }
}

/// Reads the clipping of a lattice, and counts the balls of ball mode `all`.
fn lattice(element: &Element, object: &mut Object) -> Result<(), String> {
    object.has_lattice = true;
    object.clipping = Clipping::read(element)?;
    object.properties = Named::read(element, ["pindex", "pindex"])?.or(object.properties);
    if ball_attribute(element, "ballmode") == Some("all") {
        object.strut_count += object.vertex_count;
    }
    Ok(())
}

/// The displacement group that an element names for all triangles in it.
pub(super) fn displacement_group(element: &Element) -> Result<Option<u32>, String> {
    // With or without prefix.
    element.get_of(Space::Displacement, "did").map_or_else(
        || optional(element, "did"),
        |text| text.trim().parse().map(Some).map_err(|_| format!("did = `{}` is not a number", quote(text))),
    )
}

/// An attribute of the balls extension on a beam lattice, with or without prefix.
pub(super) fn ball_attribute<'a>(element: &'a Element, name: &str) -> Option<&'a str> {
    element.get_of(Space::Balls, name).or(element.get(name))
}

/// Whether a build item is printed. Slicing programs mark those that are not.
fn is_printable(element: &Element) -> Result<bool, String> {
    match element.get("printable").map(str::trim) {
        None | Some("1" | "true") => Ok(true),
        Some("0" | "false") => Ok(false),
        Some(other) => Err(format!("printable = `{}` in `item`; allowed are 0, 1, false and true", quote(other))),
    }
}
