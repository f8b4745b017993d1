//! The objects of a package and the links between them, as the parts name them.

use std::collections::HashMap;
use std::ops::Range;

use glam::DAffine3;

/// In place of the object that a link belongs to: the build.
pub(super) const BUILD: u32 = u32::MAX;

/// Most things that a note names; the rest is counted.
const NAMED_LIMIT: usize = 5;

/// Beside an object itself, what its number takes where it is looked up by id, and what the assembly knows of it.
const OBJECT_EXTRA_BYTES: usize = 128;

/// Beside a link itself, what the assembly knows of it.
const LINK_EXTRA_BYTES: usize = 16;

/// An object by the number of its part and its id there.
pub(super) type ObjectId = (u32, u32);

/// One object of a model part.
#[derive(Debug, Default)]
pub(super) struct Object {
    pub(super) id: ObjectId,
    pub(super) name: String,
    /// Its type is `other`.
    pub(super) is_other: bool,
    pub(super) has_lattice: bool,
    /// A `<triangle>` stands in its mesh.
    pub(super) has_triangles: bool,
    pub(super) has_displacement: bool,
    /// How its lattice is clipped, where it is.
    pub(super) clipping: Option<String>,
    pub(super) vertex_count: u64,
    /// Beams and balls at each of its places, at most.
    pub(super) strut_count: u64,
    /// Its components among the links.
    pub(super) components: Range<usize>,
}

/// A component of an object, or a build item.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// The object whose component it is, or [`BUILD`].
    pub(super) parent: u32,
    pub(super) target: ObjectId,
    /// Where it places the target, in millimetres.
    pub(super) transform: DAffine3,
}

/// All parts' objects, components and build items.
#[derive(Debug, Default)]
pub(super) struct Resources {
    pub(super) objects: Vec<Object>,
    ids: HashMap<ObjectId, u32>,
    /// Names of the parts, by number.
    pub(super) part_names: Vec<String>,
    /// Components in the order of their objects, then build items.
    pub(super) links: Vec<Link>,
    /// Build items, until they follow the components.
    items: Vec<Link>,
    /// Objects of build items that are marked not to be printed.
    pub(super) unprinted: Vec<ObjectId>,
    /// Memory that all of this takes, about.
    bytes: usize,
}

impl Resources {
    /// No object yet, and the part with the build.
    pub(super) fn new(root: String) -> Self {
        Self { part_names: vec![root], ..Self::default() }
    }

    /// Adds an object and returns its number.
    ///
    /// # Errors
    /// A text that says that its id is taken.
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

    /// Adds a build item that is to be printed.
    pub(super) fn add_item(&mut self, target: ObjectId, transform: DAffine3) {
        self.items.push(Link { parent: BUILD, target, transform });
        self.bytes += size_of::<Link>() + LINK_EXTRA_BYTES;
    }

    /// Adds a build item that is marked not to be printed.
    pub(super) fn add_unprinted(&mut self, target: ObjectId) {
        self.unprinted.push(target);
        self.bytes += size_of::<ObjectId>();
    }

    /// Whether the build has an item, to be printed or not.
    pub(super) fn has_items(&self) -> bool {
        !self.items.is_empty() || !self.unprinted.is_empty()
    }

    /// Memory that objects, components and build items take, about.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Ends reading: the build items follow the components. Returns which links they are.
    pub(super) fn close(&mut self) -> Range<usize> {
        let begin = self.links.len();
        self.links.append(&mut self.items);
        begin..self.links.len()
    }

    /// The number of an object.
    pub(super) fn number(&self, id: ObjectId) -> Option<u32> {
        self.ids.get(&id).copied()
    }

    /// An object as errors name it: with its part, where that is not the first.
    pub(super) fn name(&self, (part, id): ObjectId) -> String {
        let name = self.number((part, id)).map_or("", |number| self.objects[number as usize].name.as_str());
        let named = if name.is_empty() { format!("object {id}") } else { format!("object {id} ({name})") };
        if part == 0 { named } else { format!("{named} of {}", self.part_names[part as usize]) }
    }
}

/// What a note says was left out.
#[derive(Debug, Default)]
pub(super) struct LeftOut {
    names: Vec<String>,
    count: usize,
}

impl LeftOut {
    pub(super) fn add(&mut self, name: impl FnOnce() -> String) {
        self.count += 1;
        if self.names.len() < NAMED_LIMIT {
            self.names.push(name());
        }
    }

    /// A note with the names, where there is anything: `text` takes the count.
    pub(super) fn note(&self, text: impl FnOnce(usize) -> String) -> Option<String> {
        let more = if self.count > self.names.len() { ", …" } else { "" };
        (self.count > 0).then(|| format!("{}: {}{more}", text(self.count), self.names.join(", ")))
    }
}
