//! The objects of a package and the links between them, as its parts state them. `structure` fills it.

use std::collections::HashMap;
use std::ops::Range;

use glam::DAffine3;

use super::clipping::Clipping;
use super::materials::Named;

/// Stands for the build where a link names the object it belongs to.
pub(super) const BUILD: u32 = u32::MAX;

/// Most things that a note names. The others are only counted.
const MAX_NAMED: usize = 5;

/// Memory of an object besides the object itself, bytes: its entry in the table of ids, and in the assembly.
const OBJECT_EXTRA_BYTES: usize = 128;

/// Memory of a link in the assembly, bytes.
const LINK_EXTRA_BYTES: usize = 16;

/// Identifies an object: number of its part, and its id in that part.
pub(super) type ObjectId = (u32, u32);

/// One object.
#[derive(Debug, Default)]
pub(super) struct Object {
    pub(super) id: ObjectId,
    pub(super) name: String,
    /// Its type is `other`.
    pub(super) is_other: bool,
    pub(super) has_lattice: bool,
    /// The properties of beams that name none.
    pub(super) properties: Named,
    /// Number of triangles of its mesh.
    pub(super) triangle_count: u64,
    pub(super) has_displacement: bool,
    /// The displacement group of its triangles, unless they name another.
    pub(super) group: Option<u32>,
    /// How its lattice is clipped; `None` if it is not.
    pub(super) clipping: Option<Clipping>,
    pub(super) vertex_count: u64,
    /// Number of beams and balls at each of its places, at most.
    pub(super) strut_count: u64,
    /// Its components, as indices of the links.
    pub(super) components: Range<usize>,
}

/// A component of an object, or a build item.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// The object whose component it is, or [`BUILD`].
    pub(super) parent: u32,
    pub(super) target: ObjectId,
    /// Position of the target, in millimetres.
    pub(super) transform: DAffine3,
}

/// Objects, components and build items of all parts.
#[derive(Debug, Default)]
pub(super) struct Resources {
    pub(super) objects: Vec<Object>,
    ids: HashMap<ObjectId, u32>,
    /// Name of each part.
    pub(super) part_names: Vec<String>,
    /// Components in the order of their objects, then build items.
    pub(super) links: Vec<Link>,
    /// Build items, until [`Resources::close`] appends them to the links.
    items: Vec<Link>,
    /// Objects of build items that are marked as not printable.
    pub(super) unprinted: Vec<ObjectId>,
    /// Memory of all this, bytes, about.
    bytes: usize,
}

impl Resources {
    /// No objects yet. `root` is the part with the build.
    pub(super) fn new(root: String) -> Self {
        Self { part_names: vec![root], ..Self::default() }
    }

    /// Adds an object and returns its number.
    ///
    /// # Errors
    /// A text that says that the id is already used.
    pub(super) fn add(&mut self, object: Object) -> Result<u32, String> {
        let number = self.objects.len() as u32;
        if self.ids.insert(object.id, number).is_some() {
            return Err(format!("two objects have the id {}", object.id.1));
        }
        self.bytes += size_of::<Object>() + object.name.len() + OBJECT_EXTRA_BYTES;
        self.objects.push(Object { components: self.links.len()..self.links.len(), ..object });
        Ok(number)
    }

    /// Adds a component to the object that was added last.
    pub(super) fn add_component(&mut self, target: ObjectId, transform: DAffine3) {
        if let Some(object) = self.objects.last_mut() {
            let parent = self.ids[&object.id];
            self.links.push(Link { parent, target, transform });
            object.components.end = self.links.len();
            self.bytes += size_of::<Link>() + LINK_EXTRA_BYTES;
        }
    }

    /// Adds a build item.
    pub(super) fn add_item(&mut self, target: ObjectId, transform: DAffine3) {
        self.items.push(Link { parent: BUILD, target, transform });
        self.bytes += size_of::<Link>() + LINK_EXTRA_BYTES;
    }

    /// Adds a build item that is marked as not printable.
    pub(super) fn add_unprinted(&mut self, target: ObjectId) {
        self.unprinted.push(target);
        self.bytes += size_of::<ObjectId>();
    }

    /// Whether the build has any item, printable or not.
    pub(super) fn has_items(&self) -> bool {
        !self.items.is_empty() || !self.unprinted.is_empty()
    }

    /// Memory of objects, components and build items, bytes, about.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Appends the build items to the links, when all parts are read. Returns their indices.
    pub(super) fn close(&mut self) -> Range<usize> {
        let begin = self.links.len();
        self.links.append(&mut self.items);
        begin..self.links.len()
    }

    /// The number of an object.
    pub(super) fn number(&self, id: ObjectId) -> Option<u32> {
        self.ids.get(&id).copied()
    }

    /// Names an object in errors, with its part if that is not the first one.
    pub(super) fn name(&self, (part, id): ObjectId) -> String {
        let name = self.number((part, id)).map_or("", |number| self.objects[number as usize].name.as_str());
        let named = if name.is_empty() { format!("object {id}") } else { format!("object {id} ({name})") };
        if part == 0 { named } else { format!("{named} of {}", self.part_names[part as usize]) }
    }
}

/// Things that were left out, for a note.
#[derive(Debug, Default)]
pub(super) struct LeftOut {
    names: Vec<String>,
    count: usize,
}

impl LeftOut {
    pub(super) fn add(&mut self, name: impl FnOnce() -> String) {
        self.count += 1;
        if self.names.len() < MAX_NAMED {
            self.names.push(name());
        }
    }

    /// A note with the names; `None` if nothing was left out. `text` makes the beginning of the note from the count.
    pub(super) fn note(&self, text: impl FnOnce(usize) -> String) -> Option<String> {
        let more = if self.count > self.names.len() { ", …" } else { "" };
        (self.count > 0).then(|| format!("{}: {}{more}", text(self.count), self.names.join(", ")))
    }
}
