//! First pass: units, objects, components and build items, without vertices and beams. Tells where each lattice stands.

use std::collections::HashMap;
use std::io::Read;

use glam::{DAffine3, DVec3};

use super::xml::{Element, Space, Step, Xml};

/// Deepest nesting of components: assemblies of assemblies, deeper than anybody draws them; the placing walks it on a list, not
/// the stack.
const DEPTH_LIMIT: usize = 32;

/// Most objects, components and items together, and most visits in placing them: components of components multiply.
const COUNT_LIMIT: usize = 1 << 18;

/// How far a transform may stretch one direction more than another and still scale radii, as a share.
const UNIFORM_TOLERANCE: f64 = 1e-3;

/// What the first pass found.
#[derive(Debug, Default)]
pub(super) struct Structure {
    /// Millimetres in one unit of the model.
    pub(super) unit_mm: f64,
    pub(super) objects: HashMap<u32, Object>,
    items: Vec<(u32, DAffine3)>,
}

/// One object of the model.
#[derive(Debug, Default)]
pub(super) struct Object {
    pub(super) name: String,
    /// Where it stands in the build, with components resolved.
    pub(super) placements: Vec<Placed>,
    pub(super) has_lattice: bool,
    /// A `<triangle>` stands in its mesh.
    pub(super) has_triangles: bool,
    pub(super) has_displacement: bool,
    /// How its lattice is clipped, where it is.
    pub(super) clipping: Option<String>,
    vertex_count: u64,
    /// Beams and balls at each of its placements, at most.
    strut_count: u64,
    components: Vec<(u32, DAffine3)>,
}

/// One place of an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub(super) transform: DAffine3,
    /// Factor on radii; `None` where the transform stretches directions differently.
    pub(super) scale: Option<f64>,
}

/// An object as errors name it.
pub(super) fn object_name(id: u32, name: &str) -> String {
    if name.is_empty() { format!("object {id}") } else { format!("object {id} ({name})") }
}

impl Structure {
    /// Reads a model.
    ///
    /// # Errors
    /// A text that names the object or element, what was found and what is allowed.
    pub(super) fn read<R: Read>(xml: &mut Xml<R>) -> Result<Self, String> {
        let mut structure = Self { unit_mm: 0.0, ..Self::default() };
        let mut current = 0;
        let mut count = 0;
        while let Some(step) = xml.next()? {
            let Step::Start(element) = step else { continue };
            if structure.unit_mm == 0.0 {
                structure.model(element)?;
                continue;
            }
            structure.element(element, &mut current, &mut count)?;
            if count > COUNT_LIMIT {
                return Err(format!("more than {COUNT_LIMIT} objects, components and build items"));
            }
        }
        if structure.unit_mm == 0.0 {
            return Err("the document is empty".into());
        }
        structure.place()?;
        Ok(structure)
    }

    /// Beams and balls that stand in the build, at most: some may be too short.
    pub(super) fn strut_count(&self) -> u64 {
        let placed = |object: &Object| object.strut_count.saturating_mul(object.placements.len() as u64);
        self.objects.values().map(placed).fold(0, u64::saturating_add)
    }

    fn model(&mut self, element: &Element) -> Result<(), String> {
        if (element.space, element.name()) != (Space::Core, "model") {
            return Err(format!("the root element is `{}`, not a 3MF core `model`", element.name()));
        }
        self.unit_mm = match element.get("unit").unwrap_or("millimeter") {
            "micron" => 0.001,
            "millimeter" => 1.0,
            "centimeter" => 10.0,
            "inch" => 25.4,
            "foot" => 304.8,
            "meter" => 1000.0,
            other => {
                return Err(format!("unit `{other}`; 3MF knows micron, millimeter, centimeter, inch, foot and meter"));
            }
        };
        for prefix in element.get("requiredextensions").unwrap_or("").split_ascii_whitespace() {
            let uri = element.bindings().find(|(bound, _)| *bound == prefix).map(|(_, uri)| uri);
            match uri.map(Space::of) {
                None => return Err(format!("it requires the extension `{prefix}`, but binds no namespace to it")),
                Some(Space::Other) => {
                    let uri = uri.unwrap_or_default();
                    return Err(format!("it requires the extension `{prefix}` ({uri}), which layerd does not know"));
                }
                Some(_) => {}
            }
        }
        Ok(())
    }

    fn element(&mut self, element: &Element, current: &mut u32, count: &mut usize) -> Result<(), String> {
        match (element.space, element.name()) {
            (Space::Core, "object") => {
                *count += 1;
                *current = required(element, "id")?;
                let name = element.get("name").unwrap_or("").chars().take(80).collect();
                let object = Object { name, ..Object::default() };
                if self.objects.insert(*current, object).is_some() {
                    return Err(format!("two objects have the id {current}"));
                }
            }
            (Space::Core, "component") => {
                *count += 1;
                let child = self.reference(element)?;
                let transform = transform(element)?;
                self.object(*current, element)?.components.push((child, transform));
            }
            (Space::Core, "item") => {
                *count += 1;
                let child = self.reference(element)?;
                self.items.push((child, transform(element)?));
            }
            (Space::Core, "vertex") => self.object(*current, element)?.vertex_count += 1,
            (Space::Lattice, "beam" | "ball") | (Space::Balls, "ball") => {
                self.object(*current, element)?.strut_count += 1;
            }
            (Space::Core, "triangle") => self.object(*current, element)?.has_triangles = true,
            (Space::Displacement, "displacementmesh") => self.object(*current, element)?.has_displacement = true,
            (Space::Lattice, "beamlattice") => {
                // Published samples write `clipping` for `clippingmode`.
                let mode = element.get("clippingmode").or(element.get("clipping")).filter(|mode| *mode != "none");
                let clipping = mode.map(|mode| {
                    let mesh = element.get("clippingmesh").unwrap_or("?");
                    format!("its lattice is clipped ({mode}) by the mesh of object {mesh}").chars().take(200).collect()
                });
                let object = self.object(*current, element)?;
                object.has_lattice = true;
                object.clipping = clipping;
                if element.get("ballmode") == Some("all") {
                    object.strut_count += object.vertex_count;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn object(&mut self, id: u32, element: &Element) -> Result<&mut Object, String> {
        self.objects.get_mut(&id).ok_or_else(|| format!("`{}` stands outside of any object", element.name()))
    }

    fn reference(&self, element: &Element) -> Result<u32, String> {
        let id = required(element, "objectid")?;
        if let Some(path) = element.get("path") {
            return Err(format!(
                "`{}` refers to object {id} in another part, `{path}` (production extension), which is not read; \
                 save the model as one part",
                element.name()
            ));
        }
        Ok(id)
    }

    /// Resolves items and components into placements of each object.
    fn place(&mut self) -> Result<(), String> {
        let mut visits = 0;
        let mut open: Vec<(u32, DAffine3, Vec<u32>)> =
            self.items.iter().rev().map(|&(id, transform)| (id, transform, Vec::new())).collect();
        while let Some((id, transform, mut above)) = open.pop() {
            visits += 1;
            if visits > COUNT_LIMIT {
                return Err(format!("components place more than {COUNT_LIMIT} objects"));
            }
            let named = above.last().map_or("a build item".to_owned(), |parent| format!("object {parent}"));
            let object = self
                .objects
                .get_mut(&id)
                .ok_or_else(|| format!("{named} refers to object {id}, which does not exist"))?;
            if above.contains(&id) {
                return Err(format!("{} contains itself through its components", object_name(id, &object.name)));
            }
            if above.len() == DEPTH_LIMIT {
                return Err(format!("components nested more than {DEPTH_LIMIT} deep at object {id}"));
            }
            object.placements.push(Placed { transform, scale: uniform_scale(transform) });
            above.push(id);
            let children = object.components.iter().rev();
            open.extend(children.map(|&(child, inner)| (child, transform * inner, above.clone())));
        }
        Ok(())
    }
}

/// A number that must be there.
///
/// # Errors
/// A text that names element and attribute.
pub(super) fn required<T: std::str::FromStr>(element: &Element, name: &str) -> Result<T, String> {
    optional(element, name)?.ok_or_else(|| format!("`{}` without {name}", element.name()))
}

/// A number that may be there.
///
/// # Errors
/// A text that names element, attribute and what was found.
pub(super) fn optional<T: std::str::FromStr>(element: &Element, name: &str) -> Result<Option<T>, String> {
    let Some(text) = element.get(name) else { return Ok(None) };
    let parsed = text.trim().parse().map(Some);
    parsed.map_err(|_| {
        format!("{name} = `{}` in `{}` is not a number", text.chars().take(40).collect::<String>(), element.name())
    })
}

/// A finite number that may be there.
///
/// # Errors
/// As [`optional`].
pub(super) fn measure(element: &Element, name: &str) -> Result<Option<f64>, String> {
    let value = optional::<f64>(element, name)?;
    match value.filter(|value| !value.is_finite()) {
        Some(value) => Err(format!("{name} = {value} in `{}` is not a finite number", element.name())),
        None => Ok(value),
    }
}

fn transform(element: &Element) -> Result<DAffine3, String> {
    let Some(text) = element.get("transform") else { return Ok(DAffine3::IDENTITY) };
    let problem = || format!("transform `{}` is not 12 finite numbers", text.chars().take(120).collect::<String>());
    let mut values = [0.0; 12];
    let mut fields = text.split_ascii_whitespace();
    for value in &mut values {
        let parsed = fields.next().and_then(|field| field.parse().ok());
        *value = parsed.filter(|value: &f64| value.is_finite()).ok_or_else(problem)?;
    }
    if fields.next().is_some() {
        return Err(problem());
    }
    // 3MF multiplies row vectors: its rows are the images of the axes, which are this type's columns.
    Ok(DAffine3::from_cols_array(&values))
}

/// The factor by which a transform scales every direction alike, if it does.
fn uniform_scale(transform: DAffine3) -> Option<f64> {
    let matrix = transform.matrix3;
    let scale = matrix.determinant().abs().cbrt();
    let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis / scale);
    let alike = |pair: f64, wanted: f64| (pair - wanted).abs() <= 2.0 * UNIFORM_TOLERANCE;
    let uniform = (0..3).all(|i| (i..3).all(|j| alike(DVec3::dot(axes[i], axes[j]), if i == j { 1.0 } else { 0.0 })));
    (scale.is_finite() && scale > 0.0 && uniform).then_some(scale)
}
