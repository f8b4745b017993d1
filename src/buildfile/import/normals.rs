//! Normals at the corners of patches whose source gives none: the mean of the neighbours that meet there without a crease. `relief` uses it.

use std::collections::HashMap;

use glam::DVec3;

use crate::buildfile::relief::{DIRECTION_UNIT, Patch};

/// Edges at which two triangles turn by more are creases, degrees: those of boxes and of prisms with up to seven sides. Coarse meshes of
/// round bodies turn less.
const CREASE_DEG: f64 = 50.0;

/// Memory for each patch, bytes: three corners, and three edges in a hash table that is at least 7/16 full.
pub(super) const BYTES_PER_PATCH: u64 = 3 * (4 + 24) + 3 * (48 + 4 + 1) * 16 / 7;

/// No edge, or more than one.
const NONE: u32 = u32::MAX;

/// Gives the corners of one solid their normals. Corners whose direction is 0 have none yet.
pub(super) fn complete(patches: &mut [Patch]) {
    if patches.iter().all(|patch| patch.corners.iter().all(|corner| corner.direction != [0; 3])) {
        return;
    }
    let mut corners = Groups::new(3 * patches.len());
    join(patches, &mut corners);
    let mut sums = vec![DVec3::ZERO; 3 * patches.len()];
    for (number, patch) in patches.iter().enumerate() {
        let normal = normal(patch);
        for corner in 0..3 {
            sums[corners.first_of(3 * number + corner)] += normal * angle(patch, corner);
        }
    }
    for (number, patch) in patches.iter_mut().enumerate() {
        for corner in 0..3 {
            let direction = &mut patch.corners[corner].direction;
            if *direction == [0; 3] {
                *direction = stored(sums[corners.first_of(3 * number + corner)]);
            }
        }
    }
}

/// A direction as a build file holds it. That of nothing is 0: nothing is displaced there.
pub(super) fn stored(direction: DVec3) -> [i16; 3] {
    (direction.normalize_or_zero() * DIRECTION_UNIT).round().to_array().map(|part| part as i16)
}

/// Joins the corners of neighbours that meet without a crease.
fn join(patches: &[Patch], corners: &mut Groups) {
    let mut edges = HashMap::with_capacity(3 * patches.len());
    let ends = |patch: &Patch, edge: usize| [patch.corners[edge].at, patch.corners[(edge + 1) % 3].at];
    for (number, patch) in patches.iter().enumerate() {
        for edge in 0..3 {
            let here = (3 * number + edge) as u32;
            edges.entry(ends(patch, edge)).and_modify(|there| *there = NONE).or_insert(here);
        }
    }
    let least = CREASE_DEG.to_radians().cos();
    for (number, patch) in patches.iter().enumerate() {
        for edge in 0..3 {
            let [from, to] = ends(patch, edge);
            // Where more than two meet, none continues another.
            let there = *edges.get(&[to, from]).unwrap_or(&NONE) as usize;
            if there == NONE as usize || edges.get(&[from, to]) == Some(&NONE) || there / 3 < number {
                continue;
            }
            if normal(patch).dot(normal(&patches[there / 3])) > least {
                let next = |edge: usize| edge / 3 * 3 + (edge + 1) % 3;
                let here = 3 * number + edge;
                corners.join(here, next(there));
                corners.join(next(here), there);
            }
        }
    }
}

fn sides(patch: &Patch, corner: usize) -> [DVec3; 2] {
    let [here, next, before] = [0, 1, 2].map(|step| patch.corners[(corner + step) % 3].at);
    [next, before].map(|other| DVec3::from([0, 1, 2].map(|axis| (other[axis] - here[axis]) as f64)))
}

/// The unit normal of the flat triangle; 0 if it has no area.
fn normal(patch: &Patch) -> DVec3 {
    let [next, before] = sides(patch, 0);
    next.normalize_or_zero().cross(before.normalize_or_zero()).normalize_or_zero()
}

/// The angle at a corner.
fn angle(patch: &Patch, corner: usize) -> f64 {
    let [next, before] = sides(patch, corner);
    if next == DVec3::ZERO || before == DVec3::ZERO { 0.0 } else { next.angle_between(before) }
}

/// Disjoint sets of corners.
struct Groups(Vec<u32>);

impl Groups {
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// The corner that stands for the group of a corner.
    fn first_of(&mut self, corner: usize) -> usize {
        let mut at = corner;
        while self.0[at] as usize != at {
            // Halves the way for the next time.
            self.0[at] = self.0[self.0[at] as usize];
            at = self.0[at] as usize;
        }
        at
    }

    fn join(&mut self, a: usize, b: usize) {
        let [a, b] = [self.first_of(a), self.first_of(b)];
        self.0[a.max(b)] = a.min(b) as u32;
    }
}
