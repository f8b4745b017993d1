//! Which lattices of a package are clipped by which meshes. Their boxes are read before the second pass, so that it knows which bodies take
//! them. `tests/clipped/three_mf.rs` has examples.

use std::collections::{BTreeSet, HashMap};

use glam::{DAffine3, DVec3};

use super::attributes::measure;
use super::package::Package;
use super::resources::{Object, Resources};
use super::space::Space;
use super::structure::{Structure, ball_attribute};
use super::xml::{Element, quote};
use crate::buildfile::error::PackError;
use crate::buildfile::import::clips::{BoxMm, Clips};
use crate::buildfile::model::Keeps;

/// How a lattice is to be clipped.
#[derive(Debug)]
pub(super) struct Clipping {
    keeps: Keeps,
    /// What it names as the object of the mesh.
    mesh: String,
}

impl Clipping {
    /// Reads the attributes of a lattice; `None` if it is not clipped.
    ///
    /// # Errors
    /// A text that names the mode.
    pub(super) fn read(element: &Element) -> Result<Option<Self>, String> {
        // Published samples write `clipping` for `clippingmode`.
        let keeps = match element.get("clippingmode").or(element.get("clipping")) {
            None | Some("none") => return Ok(None),
            Some("inside") => Keeps::Inside,
            Some("outside") => Keeps::Outside,
            Some(other) => {
                return Err(format!("clippingmode `{}`; allowed are none, inside and outside", quote(other)));
            }
        };
        Ok(Some(Self { keeps, mesh: element.get("clippingmesh").unwrap_or("").trim().to_owned() }))
    }

    /// What the lattice states, for messages.
    pub(super) fn text(&self) -> String {
        let mode = if self.keeps == Keeps::Inside { "inside" } else { "outside" };
        let mesh = if self.mesh.is_empty() { "?".to_owned() } else { quote(&self.mesh) };
        format!("its lattice is to be clipped ({mode}) by the mesh of object {mesh}")
    }

    /// The number of the mesh that clips this object.
    fn mesh_of(&self, object: &Object, resources: &Resources) -> Result<u32, String> {
        let wrong = |problem: &str| Err(format!("{}, {problem}", self.text()));
        if self.mesh.is_empty() {
            return wrong("but it has no clippingmesh");
        }
        let found = self.mesh.parse().ok().and_then(|id: u32| resources.number((object.id.0, id)));
        let Some(number) = found else { return wrong("which does not exist") };
        let mesh = &resources.objects[number as usize];
        if mesh.id == object.id {
            return wrong("which is itself");
        }
        if mesh.has_lattice {
            return wrong("but that holds a lattice, and 3MF wants a mesh of triangles alone");
        }
        if mesh.has_displacement {
            return wrong("but that is a displacement mesh, and 3MF wants a flat one");
        }
        if mesh.triangle_count == 0 {
            return wrong("but that has no triangles; it has to be a mesh");
        }
        Ok(number)
    }
}

/// The clipped lattices of a package.
#[derive(Debug, Default)]
pub(super) struct Clipped {
    /// For each clipped object the lane of each of its places.
    lanes: HashMap<u32, Vec<u16>>,
    /// For each mesh the objects that it clips.
    meshes: HashMap<u32, Vec<u32>>,
    /// Struts that are clipped, and triangles that clip, at all places.
    pub(super) counts: [u64; 2],
}

impl Clipped {
    /// Finds the clipped lattices in the build, and begins each in `clips`.
    ///
    /// # Errors
    /// If a mesh is missing, or there are too many places.
    pub(super) fn find(
        structure: &Structure,
        package: &mut Package<'_>,
        clips: &mut Clips<'_>,
    ) -> Result<Self, PackError> {
        let root = package.place(package.root());
        let resources = &structure.resources;
        let named = |object: &Object| format!("{root}: {}", resources.name(object.id));
        let mut clipped = Self::default();
        let mut pairs = Vec::new();
        for (object, number) in resources.objects.iter().zip(0..) {
            let places = structure.place_count(number);
            let Some(clipping) = object.clipping.as_ref().filter(|_| places > 0) else { continue };
            let mesh = clipping.mesh_of(object, resources);
            let mesh = mesh.map_err(|problem| PackError::input(named(object), problem))?;
            let counts = [object.strut_count, resources.objects[mesh as usize].triangle_count];
            for (sum, count) in clipped.counts.iter_mut().zip(counts) {
                *sum = sum.saturating_add(count.saturating_mul(places));
            }
            clipped.meshes.entry(mesh).or_default().push(number);
            pairs.push((number, clipping.keeps, mesh));
        }
        if pairs.is_empty() {
            return Ok(clipped);
        }
        let mut boxes: HashMap<u32, Extent> =
            pairs.iter().flat_map(|(number, _, mesh)| [*number, *mesh]).map(|object| (object, Extent::EMPTY)).collect();
        read_boxes(structure, package, &mut boxes)?;
        for (number, keeps, mesh) in pairs {
            let Extent { vertices, radius } = boxes[&number];
            let boxes = [vertices, boxes[&mesh].vertices];
            let named = named(&resources.objects[number as usize]);
            let begin = |place| clips.begin(keeps, boxes, radius, (mesh, place), &named);
            let lanes = structure.places(number).map(begin).collect::<Result<_, _>>()?;
            clipped.lanes.insert(number, lanes);
        }
        clips.end_source()?;
        Ok(clipped)
    }

    /// The lane of each place of an object; `None` if it is not clipped.
    pub(super) fn lanes(&self, object: u32) -> Option<&[u16]> {
        self.lanes.get(&object).map(Vec::as_slice)
    }

    /// Whether an object clips any lattice.
    pub(super) fn has_mesh(&self, object: u32) -> bool {
        self.meshes.contains_key(&object)
    }

    /// The places at which a mesh clips, and the lane of each.
    pub(super) fn places_of<'a>(
        &'a self,
        mesh: u32,
        structure: &'a Structure,
    ) -> impl Iterator<Item = (DAffine3, u16)> + use<'a> {
        let lattices = self.meshes.get(&mesh).into_iter().flatten();
        lattices.flat_map(move |lattice| {
            structure.places(*lattice).zip(self.lanes(*lattice).unwrap_or_default().iter().copied())
        })
    }

    /// The lanes of all these places, each once.
    pub(super) fn lanes_of(&self, mesh: u32) -> BTreeSet<u16> {
        let lattices = self.meshes.get(&mesh).into_iter().flatten();
        lattices.filter_map(|lattice| self.lanes(*lattice)).flatten().copied().collect()
    }
}

/// What an object takes: a box around its vertices, and its largest radius, millimetres.
#[derive(Clone, Copy)]
struct Extent {
    vertices: BoxMm,
    radius: f64,
}

impl Extent {
    const EMPTY: Self = Self { vertices: BoxMm::EMPTY, radius: 0.0 };

    /// Extends it by an element of the object.
    fn add(&mut self, element: &Element, unit_mm: f64) -> Result<(), String> {
        let radii: &[Option<&str>] = match (element.space, element.name()) {
            (Space::Core | Space::Displacement, "vertex") => {
                let axis = |name| Ok::<_, String>(measure(element, name)?.unwrap_or(0.0) * unit_mm);
                self.vertices.extend(DVec3::new(axis("x")?, axis("y")?, axis("z")?));
                return Ok(());
            }
            (Space::Lattice, "beamlattice") => &[element.get("radius"), ball_attribute(element, "ballradius")],
            (Space::Lattice, "beam") => &[element.get("r1"), element.get("r2")],
            (Space::Balls | Space::Lattice, "ball") => &[element.get("r")],
            _ => return Ok(()),
        };
        for radius in radii.iter().flatten() {
            // What is no number is an error when the object is read.
            self.radius = self.radius.max(radius.trim().parse().unwrap_or(0.0) * unit_mm);
        }
        Ok(())
    }
}

/// Reads the boxes of these objects.
fn read_boxes(
    structure: &Structure,
    package: &mut Package<'_>,
    boxes: &mut HashMap<u32, Extent>,
) -> Result<(), PackError> {
    package.rewind();
    for ((name, part), unit_mm) in structure.resources.part_names.iter().zip(0..).zip(&structure.units_mm) {
        let place = package.place(name);
        let wrong = |problem| PackError::input(&place, problem);
        let mut xml = package.part(name)?;
        let mut current = None;
        while let Some(element) = xml.next().map_err(wrong)? {
            if (element.space, element.name()) == (Space::Core, "object") {
                let id = element.get("id").and_then(|id| id.trim().parse().ok());
                current = id.and_then(|id| structure.resources.number((part, id)));
            } else if let Some(extent) = current.and_then(|number| boxes.get_mut(&number)) {
                extent.add(element, *unit_mm).map_err(wrong)?;
            }
        }
    }
    Ok(())
}
