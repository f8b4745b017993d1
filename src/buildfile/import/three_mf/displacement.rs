//! Resources of the displacement extension: maps, vectors, and groups of coordinates. `structure` reads them in the first pass; `lattice`
//! displaces triangles with them. `tests/relief/three_mf.rs` has examples.
//!
//! Published files use several dates of the extension and spell its names differently: all spellings are read.

use std::collections::HashMap;

use glam::DVec3;

use super::attributes::{measure, optional, required};
use super::part_name;
use super::xml::{Element, quote};
use crate::buildfile::import::height_map::Channel;
use crate::buildfile::relief::Tile;

/// Identifies a resource: number of its part, and its id in that part.
type ResourceId = (u32, u32);

/// All displacement resources of a package.
#[derive(Debug, Default)]
pub(super) struct Displacements {
    pub(super) maps: Vec<Map>,
    groups: HashMap<ResourceId, Group>,
    /// The group that uses these vectors, if only one does.
    users: HashMap<ResourceId, Option<ResourceId>>,
    vectors: HashMap<ResourceId, Vec<DVec3>>,
    map_numbers: HashMap<ResourceId, usize>,
    /// The group or the vectors to which the elements that follow belong.
    open: Option<ResourceId>,
    /// Memory, bytes, about.
    pub(super) bytes: usize,
}

/// A height map.
#[derive(Debug)]
pub(super) struct Map {
    /// The part of the package that holds it.
    pub(super) part: String,
    pub(super) channel: Channel,
    pub(super) tiles: [Tile; 2],
    pub(super) is_nearest: bool,
}

/// Coordinates on a map.
#[derive(Debug)]
pub(super) struct Group {
    map: u32,
    vectors: Option<u32>,
    /// Displacement where the map is 1, without the offset, and where it is 0, in the unit of the model.
    pub(super) height: f64,
    pub(super) offset: f64,
    coordinates: Vec<Coordinate>,
}

#[derive(Clone, Copy, Debug)]
struct Coordinate {
    texture: [f64; 2],
    vectors: Option<u32>,
    vector: u32,
    factor: f64,
}

/// How a triangle is displaced.
#[derive(Clone, Copy, Debug)]
pub(super) struct Displaced {
    pub(super) group: ResourceId,
    /// Index of the map.
    pub(super) map: usize,
    pub(super) textures: [[f64; 2]; 3],
    pub(super) vectors: [DVec3; 3],
    pub(super) factors: [f64; 3],
}

impl Displacements {
    /// Reads an element of the extension that stands in the resources of part `part`.
    ///
    /// # Errors
    /// A text that names element and attribute.
    pub(super) fn element(&mut self, part: u32, element: &Element) -> Result<(), String> {
        match element.name() {
            "displacement2d" => self.map(part, element)?,
            "normvectorgroup" => {
                let id = (part, required(element, "id")?);
                self.open = Some(id);
                self.add(|all| all.vectors.insert(id, Vec::new()).is_some(), id)?;
            }
            "normvector" => {
                let axis = |long, short| either(element, long, short);
                let vector = DVec3::new(axis("nx", "x")?, axis("ny", "y")?, axis("nz", "z")?).try_normalize();
                let vector = vector.ok_or("a `normvector` of no length has no direction")?;
                let vectors = self.open.and_then(|id| self.vectors.get_mut(&id));
                vectors.ok_or("a `normvector` outside of a `normvectorgroup`")?.push(vector);
                self.bytes += size_of::<DVec3>();
            }
            "disp2dgroup" => self.group(part, element)?,
            "disp2dcoord" | "disp2dcoords" | "disp2coord" => {
                let coordinate = Coordinate {
                    texture: [needed(element, "u")?, needed(element, "v")?],
                    vectors: optional(element, "nid")?,
                    vector: required(element, "n")?,
                    factor: measure(element, "f")?.unwrap_or(1.0),
                };
                let group = self.open.and_then(|id| self.groups.get_mut(&id));
                group.ok_or("coordinates outside of a `disp2dgroup`")?.coordinates.push(coordinate);
                self.bytes += size_of::<Coordinate>();
            }
            _ => {}
        }
        Ok(())
    }

    fn add(&mut self, insert: impl FnOnce(&mut Self) -> bool, id: ResourceId) -> Result<(), String> {
        self.bytes += size_of::<Group>();
        if insert(self) { Err(format!("two displacement resources have the id {}", id.1)) } else { Ok(()) }
    }

    fn map(&mut self, part: u32, element: &Element) -> Result<(), String> {
        let kind = element.get("contenttype").unwrap_or("image/png");
        if !kind.eq_ignore_ascii_case("image/png") {
            return Err(format!(
                "contenttype `{}` in `displacement2d`; only image/png is read, as the extension says",
                quote(kind)
            ));
        }
        let channel = match element.get("channel").unwrap_or("G") {
            "R" => Channel::Red,
            "G" => Channel::Green,
            "B" => Channel::Blue,
            "A" => Channel::Alpha,
            other => return Err(format!("channel `{}` in `displacement2d`; allowed are R, G, B and A", quote(other))),
        };
        let is_nearest = match element.get("filter").unwrap_or("auto") {
            "nearest" => true,
            "auto" | "linear" => false,
            other => {
                return Err(format!(
                    "filter `{}` in `displacement2d`; allowed are auto, linear and nearest",
                    quote(other)
                ));
            }
        };
        let path = element.get("path").ok_or("`displacement2d` without path")?;
        let map = Map {
            part: part_name::resolve(path),
            channel,
            tiles: [tile(element, "tilestyleu")?, tile(element, "tilestylev")?],
            is_nearest,
        };
        let id = (part, required(element, "id")?);
        self.bytes += size_of::<Map>() + map.part.len();
        let number = self.maps.len();
        self.maps.push(map);
        self.add(|all| all.map_numbers.insert(id, number).is_some(), id)
    }

    fn group(&mut self, part: u32, element: &Element) -> Result<(), String> {
        let group = Group {
            map: required(element, "dispid")?,
            vectors: optional(element, "nid")?,
            height: either(element, "depth", "height")?,
            offset: measure(element, "offset")?.unwrap_or(0.0),
            coordinates: Vec::new(),
        };
        let id = (part, required(element, "id")?);
        self.open = Some(id);
        if let Some(vectors) = group.vectors {
            self.users.entry((part, vectors)).and_modify(|user| *user = None).or_insert(Some(id));
        }
        self.add(|all| all.groups.insert(id, group).is_some(), id)
    }

    /// The group that a triangle names. Published files name the vectors of the group instead.
    fn group_of(&self, part: u32, id: u32) -> Result<(ResourceId, &Group), String> {
        if let Some(group) = self.groups.get(&(part, id)) {
            return Ok(((part, id), group));
        }
        let user = self.users.get(&(part, id)).copied().flatten();
        let found = user.and_then(|user| Some((user, self.groups.get(&user)?)));
        found.ok_or_else(|| format!("did = {id}: there is no `disp2dgroup` of that id"))
    }

    /// The group of a number that [`Displaced::group`] holds.
    pub(super) fn group_at(&self, id: ResourceId) -> Option<&Group> {
        self.groups.get(&id)
    }

    /// How a triangle of part `part` is displaced: by group `id`, with these coordinates.
    ///
    /// # Errors
    /// A text that names what is missing.
    pub(super) fn displaced(&self, part: u32, id: u32, corners: [u32; 3]) -> Result<Displaced, String> {
        let (group_id, group) = self.group_of(part, id)?;
        let map = *self
            .map_numbers
            .get(&(part, group.map))
            .ok_or_else(|| format!("dispid = {}: there is no `displacement2d` of that id", group.map))?;
        let mut displaced =
            Displaced { group: group_id, map, textures: [[0.0; 2]; 3], vectors: [DVec3::ZERO; 3], factors: [0.0; 3] };
        for (place, number) in corners.into_iter().enumerate() {
            let count = group.coordinates.len();
            let coordinate = group.coordinates.get(number as usize);
            let coordinate =
                coordinate.ok_or_else(|| format!("d{} = {number}; group {id} has {count} coordinates", place + 1))?;
            let nid = coordinate.vectors.or(group.vectors);
            let nid = nid.ok_or_else(|| format!("neither group {id} nor its coordinates have a nid"))?;
            let vectors = self.vectors.get(&(part, nid));
            let vectors = vectors.ok_or_else(|| format!("nid = {nid}: there is no `normvectorgroup` of that id"))?;
            let vector = vectors.get(coordinate.vector as usize);
            let vector = vector
                .ok_or_else(|| format!("n = {}; group {nid} has {} vectors", coordinate.vector, vectors.len()))?;
            displaced.textures[place] = coordinate.texture;
            displaced.vectors[place] = *vector;
            displaced.factors[place] = coordinate.factor;
        }
        Ok(displaced)
    }
}

/// A number that has two names, of which the second is that of the extension.
fn either(element: &Element, other: &str, name: &str) -> Result<f64, String> {
    measure(element, other)?.map_or_else(|| needed(element, name), Ok)
}

fn needed(element: &Element, name: &str) -> Result<f64, String> {
    measure(element, name)?.ok_or_else(|| format!("`{}` without {name}", element.name()))
}

fn tile(element: &Element, name: &str) -> Result<Tile, String> {
    match element.get(name).unwrap_or("wrap") {
        "wrap" => Ok(Tile::Wrap),
        "mirror" => Ok(Tile::Mirror),
        "clamp" => Ok(Tile::Clamp),
        "none" => Ok(Tile::Nothing),
        other => Err(format!("{name} = `{}`; allowed are wrap, mirror, clamp and none", quote(other))),
    }
}
