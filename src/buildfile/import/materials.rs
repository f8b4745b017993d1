//! Materials as sources name them: their numbers in the part, and mixtures of them. `lane` sorts struts by them; `tests/materials/` packs them.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::buildfile::error::PackError;
use crate::buildfile::materials::{Materials, Shares};
use crate::buildfile::store::check_material_name;
use crate::text::count_text;

/// What an end of a strut consists of: the share of each material, by its number. They add up to [`Shares::WHOLE`].
type Parts = [u16; Materials::MAX_COUNT];

/// What a strut consists of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mixture {
    ends: [Parts; 2],
}

impl Mixture {
    /// The mixtures of two ends.
    pub(super) fn between(a: &Self, b: &Self) -> Self {
        Self { ends: [a.ends[0], b.ends[1]] }
    }

    /// All of one material.
    pub(super) fn of(material: u8) -> Self {
        let mut parts = [0; Materials::MAX_COUNT];
        parts[usize::from(material)] = Shares::WHOLE;
        Self { ends: [parts; 2] }
    }

    /// A mixture of materials with these weights, at least 0; of equal parts if all are 0. A material may be there several times.
    pub(super) fn weighed(weights: &[(u8, f64)]) -> Self {
        let mut sums = [0.0; Materials::MAX_COUNT];
        let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
        for (material, weight) in weights {
            sums[usize::from(*material)] += if total > 0.0 { weight / total } else { 1.0 / weights.len() as f64 };
        }
        let exact = sums.map(|share| share * f64::from(Shares::WHOLE));
        let mut parts = exact.map(|share| share as u16);
        // What rounding down left goes to those that lost most.
        let left = Shares::WHOLE - parts.iter().sum::<u16>();
        let mut by_loss: Vec<usize> = (0..exact.len()).collect();
        by_loss.sort_by(|one, other| exact[*other].fract().total_cmp(&exact[*one].fract()));
        by_loss.into_iter().take(left.into()).for_each(|material| parts[material] += 1);
        Self { ends: [parts; 2] }
    }

    /// The same from the other end.
    pub(super) fn reversed(&self) -> Self {
        Self { ends: [self.ends[1], self.ends[0]] }
    }

    /// The material, if it is only one.
    pub(super) fn pure(&self) -> Option<u8> {
        let mut materials = self.shares().map(|(material, _)| material);
        materials.next().filter(|_| materials.next().is_none())
    }

    /// Its materials and their shares at both ends.
    pub(super) fn shares(&self) -> impl Iterator<Item = (u8, Shares)> {
        let [a, b] = self.ends;
        let shares = (0..).zip(a.into_iter().zip(b)).map(|(material, (a, b))| (material, Shares { a, b }));
        shares.filter(|(_, shares)| shares.a > 0 || shares.b > 0)
    }
}

/// The materials of all sources of a pack, numbered as they are found. All threads share it.
#[derive(Debug)]
pub(in crate::buildfile) struct MaterialNames {
    /// Names of sources and what they become.
    renamed: Vec<(String, String)>,
    found: Mutex<Found>,
}

#[derive(Debug, Default)]
struct Found {
    names: Vec<String>,
    /// Which of the names to be renamed were found.
    met: Vec<bool>,
}

impl MaterialNames {
    /// # Errors
    /// If a name is to become two others, or is no name.
    pub(super) fn new(renamed: &[(String, String)]) -> Result<Self, PackError> {
        for (number, (from, to)) in renamed.iter().enumerate() {
            let wrong = |problem: String| PackError::Option(format!("--materials {from}={to}: {problem}"));
            check_material_name(to).map_err(wrong)?;
            if renamed[..number].iter().any(|(other, _)| other == from) {
                return Err(wrong(format!("`{from}` is named twice")));
            }
        }
        let found = Found { names: Vec::new(), met: vec![false; renamed.len()] };
        Ok(Self { renamed: renamed.to_vec(), found: Mutex::new(found) })
    }

    fn found(&self) -> MutexGuard<'_, Found> {
        self.found.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of a material.
    ///
    /// # Errors
    /// A text if there are too many, or it is no name.
    pub(in crate::buildfile) fn number(&self, name: &str) -> Result<u8, String> {
        let mut found = self.found();
        let rule = self.renamed.iter().position(|(from, _)| from == name);
        if let Some(rule) = rule {
            found.met[rule] = true;
        }
        let name = rule.map_or(name, |rule| &self.renamed[rule].1);
        if let Some(number) = found.names.iter().position(|known| known == name) {
            // There are at most `Materials::MAX_COUNT`.
            return Ok(number as u8);
        }
        check_material_name(name)?;
        if found.names.len() == Materials::MAX_COUNT {
            return Err(format!(
                "material `{name}` is one too many: a part may have {}, and has {}. Put some of them together with --materials",
                Materials::MAX_COUNT,
                found.names.join(", ")
            ));
        }
        found.names.push(name.to_owned());
        Ok(found.names.len() as u8 - 1)
    }

    /// Whether any source names a material, or what has none is to get a name.
    pub(in crate::buildfile) fn is_used(&self) -> bool {
        !self.found().names.is_empty() || self.renamed.iter().any(|(from, _)| from == Materials::UNNAMED)
    }

    /// The names in the order of the part: as --materials has them, then by name. With each, the number that it had.
    pub(in crate::buildfile) fn in_order(&self) -> Vec<(String, u8)> {
        let rank = |name: &String| self.renamed.iter().position(|(_, to)| to == name).unwrap_or(usize::MAX);
        let mut names: Vec<_> = self.found().names.iter().cloned().zip(0..).collect();
        names.sort_by(|(one, _), (other, _)| (rank(one), one).cmp(&(rank(other), other)));
        names
    }

    /// # Errors
    /// If a name was to be renamed that no source has.
    pub(super) fn check_renamed(&self) -> Result<(), PackError> {
        let found = self.found();
        let unmet = self.renamed.iter().zip(&found.met).find(|((from, _), met)| !**met && from != Materials::UNNAMED);
        let Some(((from, to), _)) = unmet else { return Ok(()) };
        let kept: Vec<_> =
            found.names.iter().filter(|name| !self.renamed.iter().any(|(_, to)| to == *name)).cloned().collect();
        let met = self.renamed.iter().zip(&found.met).filter(|(_, met)| **met).map(|((from, _), _)| from.clone());
        let names: Vec<_> = met.chain(kept).collect();
        Err(PackError::Option(match names.as_slice() {
            [] => format!("--materials {from}={to}: the sources name no material"),
            names => format!(
                "--materials {from}={to}: the sources name no material `{from}`, but {}: {}",
                count_text(names.len() as u64, "other"),
                names.join(", ")
            ),
        }))
    }
}
