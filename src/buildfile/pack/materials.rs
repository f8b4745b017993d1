//! Which body is of which material, and the bodies in the order of their materials. `tests/materials/sources.rs` tests it.

use super::Body;
use crate::buildfile::error::PackError;
use crate::buildfile::import::{CollectedLattice, Rules, Struts};
use crate::buildfile::materials::{Materials, Split};
use crate::buildfile::model::Joint;

/// The materials of these bodies; `None` if no source names any. Puts the lattices that are joined first, in the order of their materials.
///
/// # Errors
/// If there are too many materials, or the options rename one that is not there.
pub(super) fn assign(bodies: &mut Vec<Body>, rules: &Rules, split: Split) -> Result<Option<Materials>, PackError> {
    let names = rules.materials();
    if !names.is_used() {
        return Ok(None);
    }
    let mut numbers = Vec::new();
    for body in &*bodies {
        let named = match body {
            Body::Lattice(lattice) => lattice.material,
            // It goes with the lattice before it.
            Body::Clip { .. } => numbers.last().copied(),
            Body::Surface(_) | Body::Relief(_) => None,
        };
        let number = named.map_or_else(|| names.number(Materials::UNNAMED).map_err(PackError::Option), Ok)?;
        numbers.push(number);
    }
    let mut ordered = names.in_order();
    // Sources may name materials of which nothing is left.
    ordered.retain(|(_, number)| numbers.contains(number));
    let place = |number: u8| ordered.iter().position(|(_, other)| *other == number).unwrap_or(0) as u8;
    let mut placed: Vec<(u8, Body)> = numbers.into_iter().map(place).zip(std::mem::take(bodies)).collect();
    let joined = placed.iter().zip(placed.iter().skip(1).map(Some).chain([None]));
    let joined = joined.take_while(|((_, body), next)| {
        matches!(body, Body::Lattice(_)) && !matches!(next, Some((_, Body::Clip { .. })))
    });
    let joined = joined.count();
    placed[..joined].sort_by_key(|(material, _)| *material);
    let mut of_bodies = Vec::new();
    for (number, (material, body)) in placed.into_iter().enumerate() {
        match (bodies.last_mut(), body) {
            // What has no material may have got the name of another.
            (Some(Body::Lattice(last)), Body::Lattice(lattice))
                if number < joined && of_bodies.last() == Some(&material) =>
            {
                last.merge(lattice);
            }
            (_, body) => {
                of_bodies.push(material);
                bodies.push(body);
            }
        }
    }
    let lattices = bodies
        .iter()
        .take(joined)
        .filter_map(|body| if let Body::Lattice(lattice) = body { Some(lattice) } else { None });
    if let Some(Joint::Elliptic { least: [one, other], .. }) = lattices.clone().next().map(|lattice| lattice.joint)
        && one != other
        && lattices.count() > 2
    {
        let text =
            "--theta2 is for two materials: among 3 materials or more, all blends begin at --theta1. Leave it out";
        return Err(PackError::Option(text.into()));
    }
    let names = ordered.into_iter().map(|(name, _)| name).collect();
    Ok(Some(Materials { names, of_bodies, split }))
}

/// A note on the materials that were found.
pub(super) fn note(materials: &Materials) -> Option<String> {
    let names = &materials.names;
    (names.len() > 1).then(|| format!("its materials are {}; rename them with --materials", names.join(", ")))
}

impl CollectedLattice {
    /// Takes the struts of another of the same material.
    fn merge(&mut self, other: Self) {
        let Struts { whole, shared } = other.struts;
        self.struts.whole.extend(whole);
        self.struts.shared.extend(shared);
        self.count += other.count;
    }
}
