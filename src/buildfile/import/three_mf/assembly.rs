//! Which objects are placed where: build items place objects, and components place objects in other objects.
//!
//! A few lines of components can place an object millions of times, so places are never listed. Each object knows what uses it; its places
//! are found by walking from it up to the build items. The number of its places is a sum over its users. `structure` asks for both.

use std::ops::Range;

use glam::DAffine3;

use super::resources::{BUILD, LeftOut, Resources};

/// Deepest nesting of components: deeper than designers nest assemblies, and shallow enough to walk for every block of beams.
const MAX_DEPTH: usize = 32;

/// The graph of objects and their uses.
#[derive(Debug, Default)]
pub(super) struct Assembly {
    /// Pairs of an object and a link that places it, sorted by object.
    uses: Vec<(u32, u32)>,
    /// For each object the index of its first use; one more entry at the end.
    first_use: Vec<usize>,
    /// For each object how often the build contains it.
    counts: Vec<u64>,
    /// Objects of type `other` that the build refers to.
    pub(super) others: LeftOut,
}

impl Assembly {
    /// Follows the build items, which are the links `items`, and their components.
    ///
    /// # Errors
    /// A text that names an object that does not exist, contains itself, or lies too deep.
    pub(super) fn new(resources: &Resources, items: Range<usize>) -> Result<Self, String> {
        let count = resources.objects.len();
        let mut walk = Walk {
            resources,
            uses: Vec::new(),
            seen: vec![Seen::Not; count],
            finished: Vec::new(),
            others: LeftOut::default(),
            open: vec![Step { object: BUILD, links: items }],
        };
        while walk.step()? {}
        let Walk { mut uses, finished, others, .. } = walk;
        uses.sort_unstable();
        let first_use: Vec<usize> =
            (0..=count).map(|object| uses.partition_point(|&(child, _)| (child as usize) < object)).collect();
        let mut counts = vec![0u64; count];
        // Each object was finished after everything it contains; in reverse order, users come first.
        for &object in finished.iter().rev() {
            let object = object as usize;
            let users = uses[first_use[object]..first_use[object + 1]].iter();
            let parents = users.map(|&(_, link)| resources.links[link as usize].parent);
            let places = parents.map(|parent| if parent == BUILD { 1 } else { counts[parent as usize] });
            counts[object] = places.fold(0, u64::saturating_add);
        }
        Ok(Self { uses, first_use, counts, others })
    }

    /// How often the build contains an object.
    pub(super) fn count(&self, object: u32) -> u64 {
        self.counts[object as usize]
    }

    /// The places of an object, as maps from its coordinates to those of the build, both in millimetres. `resources` must be the same as
    /// in [`Assembly::new`].
    pub(super) fn places<'a>(
        &'a self,
        object: u32,
        resources: &'a Resources,
    ) -> impl Iterator<Item = DAffine3> + use<'a> {
        let uses = |object: u32| self.first_use[object as usize]..self.first_use[object as usize + 1];
        let mut open = vec![(uses(object), DAffine3::IDENTITY)];
        std::iter::from_fn(move || {
            loop {
                let (rest, inner) = open.last_mut()?;
                let Some(next) = rest.next() else {
                    open.pop();
                    continue;
                };
                let link = &resources.links[self.uses[next].1 as usize];
                let transform = link.transform * *inner;
                if link.parent == BUILD {
                    return Some(transform);
                }
                open.push((uses(link.parent), transform));
            }
        })
    }
}

/// The walk from the build down to everything it contains.
struct Walk<'a> {
    resources: &'a Resources,
    uses: Vec<(u32, u32)>,
    seen: Vec<Seen>,
    /// Objects in the order in which they were finished: each after everything it contains.
    finished: Vec<u32>,
    others: LeftOut,
    /// The path from the build to the current object.
    open: Vec<Step>,
}

struct Step {
    object: u32,
    /// Its links that are still to be followed.
    links: Range<usize>,
}

#[derive(Clone, Copy)]
enum Seen {
    Not,
    /// Its type is `other`: it is not printed.
    Other,
    /// It is on the current path.
    Open {
        height: usize,
    },
    /// It was left. `height` is the depth of nesting in it, including itself.
    Finished {
        height: usize,
    },
}

impl Walk<'_> {
    /// Follows one link, or leaves an object. Returns `false` at the end.
    fn step(&mut self) -> Result<bool, String> {
        let depth = self.open.len() - 1;
        let Some(Step { object, links }) = self.open.last_mut() else { return Ok(false) };
        let object = *object;
        let Some(link) = links.next() else {
            self.open.pop();
            return Ok(self.leave(object));
        };
        let child = self.target(link)?;
        let below = match self.seen[child as usize] {
            Seen::Other => return Ok(true),
            Seen::Open { .. } => return Err(self.cycle(child)),
            Seen::Finished { height } => {
                self.raise(object, height + 1);
                height
            }
            Seen::Not => {
                let found = &self.resources.objects[child as usize];
                if found.is_other {
                    self.others.add(|| self.resources.name(found.id));
                    self.seen[child as usize] = Seen::Other;
                    return Ok(true);
                }
                self.seen[child as usize] = Seen::Open { height: 1 };
                self.open.push(Step { object: child, links: found.components.clone() });
                1
            }
        };
        self.uses.push((child, link as u32));
        if depth + below > MAX_DEPTH {
            return Err(format!("components nested more than {MAX_DEPTH} deep at {}", self.name(child)));
        }
        Ok(true)
    }

    /// The object that a link places.
    fn target(&self, link: usize) -> Result<u32, String> {
        let link = &self.resources.links[link];
        self.resources.number(link.target).ok_or_else(|| {
            let parent = if link.parent == BUILD { "a build item".to_owned() } else { self.name(link.parent) };
            format!("{parent} refers to {}, which does not exist", self.resources.name(link.target))
        })
    }

    fn name(&self, object: u32) -> String {
        self.resources.name(self.resources.objects[object as usize].id)
    }

    /// Leaves an object. Returns `false` if it is the build.
    fn leave(&mut self, object: u32) -> bool {
        if object == BUILD {
            return false;
        }
        if let Seen::Open { height } = self.seen[object as usize] {
            self.seen[object as usize] = Seen::Finished { height };
            if let Some(&Step { object: parent, .. }) = self.open.last() {
                self.raise(parent, height + 1);
            }
        }
        self.finished.push(object);
        true
    }

    /// Raises the height of an object to at least `height_below`.
    fn raise(&mut self, object: u32, height_below: usize) {
        if object != BUILD
            && let Seen::Open { height } = &mut self.seen[object as usize]
        {
            *height = height_below.max(*height);
        }
    }

    /// The error for an object that contains itself.
    fn cycle(&self, object: u32) -> String {
        let inner = self.open.iter().map(|step| step.object).skip_while(|&open| open != object);
        let names: Vec<_> = inner.chain([object]).map(|object| self.name(object)).collect();
        format!("{} contains itself through its components: {}", names[0], names.join(" → "))
    }
}
