//! Materials of the core specification and of the materials extension (1.2): base materials, composites of them, and multiproperties. `structure` reads them in
//! the first pass, `lattice` looks them up in the second. `tests/materials/sources.rs` has examples.
//!
//! Colours and textures are properties, too, but no materials: beams that have only such have no material.

use std::collections::HashMap;

use super::attributes::{optional, required};
use super::space::Space;
use super::xml::{Element, quote};
use crate::buildfile::import::materials::{MaterialNames, Mixture};

/// Identifies a resource: number of its part, and its id in that part.
type ResourceId = (u32, u32);

/// The properties that an element names: a group, and places in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Named {
    pub(super) group: Option<u32>,
    pub(super) places: [Option<u32>; 2],
}

impl Named {
    /// Reads `pid`, and two attributes for the places in the group.
    ///
    /// # Errors
    /// A text that names element and attribute.
    pub(super) fn read(element: &Element, places: [&str; 2]) -> Result<Self, String> {
        let [first, second] = places;
        Ok(Self { group: optional(element, "pid")?, places: [optional(element, first)?, optional(element, second)?] })
    }

    /// What it does not name as `other` does. Places belong to their group.
    pub(super) fn or(self, other: Self) -> Self {
        match (self.group, self.places[0]) {
            (Some(_), _) => self,
            (None, Some(_)) => Self { group: other.group, ..self },
            (None, None) => other,
        }
    }
}

/// All groups of properties of a package.
#[derive(Debug, Default)]
pub(super) struct Properties {
    groups: HashMap<ResourceId, Group>,
    /// The group to which the elements that follow belong.
    open: Option<ResourceId>,
    /// Memory, bytes, about.
    pub(super) bytes: usize,
}

#[derive(Debug)]
enum Group {
    /// Names of base materials.
    Base(Vec<String>),
    /// Mixtures: weights of materials, which are places in a group of base materials.
    Composite { base: u32, places: Vec<u32>, weights: Vec<Vec<f64>> },
    /// Combinations: for each group of `groups` a place in it.
    Multi { groups: Vec<u32>, places: Vec<Vec<u32>> },
    /// Colours or textures.
    Other,
}

impl Properties {
    /// Reads an element of the resources of part `part`, if it is one of these.
    ///
    /// # Errors
    /// A text that names element and attribute.
    pub(super) fn element(&mut self, part: u32, element: &Element) -> Result<(), String> {
        let group = match (element.space, element.name()) {
            (Space::Core, "basematerials") => Group::Base(Vec::new()),
            (Space::Material, "compositematerials") => Group::Composite {
                base: required(element, "matid")?,
                places: numbers(element, "matindices")?,
                weights: Vec::new(),
            },
            (Space::Material, "multiproperties") => {
                Group::Multi { groups: numbers(element, "pids")?, places: Vec::new() }
            }
            (Space::Material, "colorgroup" | "texture2dgroup") => Group::Other,
            (Space::Core, "base") | (Space::Material, "composite" | "multi") => return self.member(element),
            _ => return Ok(()),
        };
        let id = (part, required(element, "id")?);
        self.open = Some(id);
        self.bytes += size_of::<Group>() + size_of::<ResourceId>();
        if self.groups.insert(id, group).is_some() {
            return Err(format!("two groups of properties have the id {}", id.1));
        }
        Ok(())
    }

    fn member(&mut self, element: &Element) -> Result<(), String> {
        let outside = || format!("`{}` outside of its group", element.name());
        let group = self.open.and_then(|id| self.groups.get_mut(&id)).ok_or_else(outside)?;
        match (group, element.name()) {
            (Group::Base(names), "base") => {
                let name = element.get("name").ok_or("`base` without name")?.trim().to_owned();
                self.bytes += size_of::<String>() + name.len();
                names.push(name);
            }
            (Group::Composite { weights, .. }, "composite") => {
                let values: Vec<f64> = numbers(element, "values")?;
                if values.iter().any(|value| !value.is_finite() || *value < 0.0) {
                    return Err(format!(
                        "values `{}` of a `composite`: they must be 0 or more",
                        quote(element.get("values").unwrap_or(""))
                    ));
                }
                self.bytes += size_of::<Vec<f64>>() + size_of::<f64>() * values.len();
                weights.push(values);
            }
            (Group::Multi { places, .. }, "multi") => {
                let found: Vec<u32> = numbers(element, "pindices")?;
                self.bytes += size_of::<Vec<u32>>() + size_of::<u32>() * found.len();
                places.push(found);
            }
            _ => return Err(outside()),
        }
        Ok(())
    }

    /// What a beam of part `part` consists of; `None` if it names no material.
    ///
    /// # Errors
    /// A text if a group or a place is not there, or base materials are to form a gradient.
    pub(super) fn mixture(&self, part: u32, named: Named, names: &MaterialNames) -> Result<Option<Mixture>, String> {
        let (Some(group), [first, second]) = (named.group, named.places) else { return Ok(None) };
        let first = first.unwrap_or(0);
        self.between((part, group), [first, second.unwrap_or(first)], names)
    }

    fn between(&self, id: ResourceId, places: [u32; 2], names: &MaterialNames) -> Result<Option<Mixture>, String> {
        let (part, number) = id;
        let group = self.groups.get(&id).ok_or_else(|| format!("property group {number} is not there"))?;
        let [first, second] = places;
        match group {
            Group::Other => Ok(None),
            Group::Base(known) => {
                if first != second {
                    let name = |place: u32| known.get(place as usize).map_or("?", String::as_str);
                    return Err(format!(
                        "a gradient from base material `{}` to `{}`, which 3MF forbids: use composite materials, or one material",
                        quote(name(first)),
                        quote(name(second))
                    ));
                }
                let name = known.get(first as usize).ok_or_else(|| missing(first, number, known.len()))?;
                Ok(Some(Mixture::of(names.number(name)?)))
            }
            Group::Composite { base, places: materials, weights } => {
                let Some(Group::Base(known)) = self.groups.get(&(part, *base)) else {
                    return Err(format!("composite materials {number} of group {base}, which has no base materials"));
                };
                let weighed = |place: u32| {
                    let weights = weights.get(place as usize).ok_or_else(|| missing(place, number, weights.len()))?;
                    let mut parts = Vec::new();
                    for (at, material) in materials.iter().enumerate() {
                        let name =
                            known.get(*material as usize).ok_or_else(|| missing(*material, *base, known.len()))?;
                        // A list that is too short ends with zeros.
                        let weight = weights.get(at).copied().unwrap_or(0.0);
                        parts.push((name, weight));
                    }
                    let is_empty = parts.iter().all(|(_, weight)| *weight == 0.0);
                    let counts = parts.iter().filter(|(_, weight)| is_empty || *weight > 0.0);
                    let numbered: Result<Vec<_>, String> =
                        counts.map(|(name, weight)| Ok((names.number(name)?, *weight))).collect();
                    Ok::<_, String>(Mixture::weighed(&numbered?))
                };
                Ok(Some(Mixture::between(&weighed(first)?, &weighed(second)?)))
            }
            Group::Multi { groups, places: combinations } => {
                let of_combination = |place: u32| {
                    let combination = combinations.get(place as usize);
                    combination.ok_or_else(|| missing(place, number, combinations.len()))
                };
                let [first, second] = [of_combination(first)?, of_combination(second)?];
                // Materials come first, if there are any. A list that is too short ends with zeros.
                let Some(material) = groups.first().filter(|group| **group != number) else { return Ok(None) };
                if matches!(self.groups.get(&(part, *material)), Some(Group::Multi { .. })) {
                    return Err(format!("multiproperties {number} of multiproperties {material}, which 3MF forbids"));
                }
                let place = |combination: &Vec<u32>| combination.first().copied().unwrap_or(0);
                self.between((part, *material), [place(first), place(second)], names)
            }
        }
    }
}

fn missing(place: u32, group: u32, count: usize) -> String {
    format!("property {place} of group {group}, which has {count}")
}

/// The numbers of a list, separated by spaces.
fn numbers<T: std::str::FromStr>(element: &Element, name: &str) -> Result<Vec<T>, String> {
    let text = element.get(name).ok_or_else(|| format!("`{}` without {name}", element.name()))?;
    let number = |word: &str| {
        word.parse().map_err(|_| format!("{name} = `{}` in `{}` is no list of numbers", quote(text), element.name()))
    };
    text.split_ascii_whitespace().map(number).collect()
}
