//! The exposures of a job, in order. A layer of several materials has an exposure of each, one after the other; the order alternates from layer to
//! layer, so that a layer begins with the vat that is in place. Everything follows from which layers have which materials, so the number of an
//! exposure means the same after a restart. In a part of one material it is the number of the layer.
//!
//! ```
//! use layerd::device::Passes;
//!
//! // Material 0 in layers 0 to 3, material 1 in layers 2 to 5.
//! let passes = Passes::of(&[("stiff".into(), 0..4), ("soft".into(), 2..6)], 6).expect("layers");
//! let materials: Vec<_> = (0..passes.exposure_count()).map(|exposure| passes.at(exposure).material).collect();
//! assert_eq!(materials, [0, 0, 0, 1, 1, 0, 1, 1]);
//! assert_eq!(passes.changes(), 3);
//! assert_eq!(passes.text(5), "layer 3 (stiff)");
//! ```

use std::ops::Range;

use bincode::{Decode, Encode};

use crate::link::message::ExposureId;
use crate::text::layer_text;

/// Most ranges of layers: a material begins and ends once, and there are at most eight.
const MAX_RANGES: usize = 17;

/// Most exposures of a layer: one for each material.
const MAX_MATERIALS: usize = 8;

/// Which exposures the layers of a job have.
#[derive(Clone, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub struct Passes {
    /// Names of the materials; empty for a part of one.
    names: Vec<String>,
    /// Ascending, without gaps, from layer 0 on.
    ranges: Vec<PassRange>,
}

/// Layers of the same materials.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
struct PassRange {
    layer_count: u32,
    /// In the order of the first of these layers; that of the next one is reversed, and so on. At least one.
    materials: Vec<u8>,
}

/// An exposure of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pass {
    /// The layer.
    pub layer: u32,
    /// Number of the exposure within the layer, from 0.
    pub pass: u8,
    /// Its material.
    pub material: u8,
}

impl Passes {
    /// One exposure for each of `layer_count` layers.
    pub fn single(layer_count: u32) -> Self {
        let ranges = if layer_count > 0 { vec![PassRange { layer_count, materials: vec![0] }] } else { Vec::new() };
        Self { names: Vec::new(), ranges }
    }

    /// Exposures of materials, each with its name and the layers that it is in. A layer without any is exposed dark, with the material that is in
    /// place. `None` if there are no layers, or no or too many materials.
    pub fn of(materials: &[(String, Range<u32>)], layer_count: u32) -> Option<Self> {
        if layer_count == 0 || !(1..=MAX_MATERIALS).contains(&materials.len()) {
            return None;
        }
        let spans = materials.iter().map(|(_, layers)| layers);
        let mut borders: Vec<u32> = spans.flat_map(|span| [span.start, span.end]).chain([0, layer_count]).collect();
        borders.retain(|border| *border <= layer_count);
        borders.sort_unstable();
        borders.dedup();
        let mut ranges: Vec<PassRange> = Vec::new();
        // The first vat is in place when nothing is known.
        let mut in_place = 0;
        for layers in borders.windows(2).map(|pair| pair[0]..pair[1]) {
            let has = |material: &u8| materials[usize::from(*material)].1.contains(&layers.start);
            let mut here: Vec<u8> = (0..materials.len() as u8).filter(has).collect();
            if here.is_empty() {
                here.push(in_place);
            }
            // Continue with what is in place.
            here.sort_by_key(|material| (*material != in_place, *material));
            let range = PassRange { layer_count: layers.end - layers.start, materials: here };
            in_place = range.last_material();
            ranges.push(range);
        }
        let names = materials.iter().map(|(name, _)| name.clone()).filter(|_| materials.len() > 1).collect();
        Some(Self { names, ranges })
    }

    /// # Errors
    /// A text if they cannot be those of a job of so many layers.
    pub(crate) fn check(&self, layer_count: u32) -> Result<(), String> {
        let layers: u64 = self.ranges.iter().map(|range| u64::from(range.layer_count)).sum();
        let material_count = self.names.len().max(1);
        let is_wrong = |range: &PassRange| {
            let materials = &range.materials;
            let is_known = |material: &u8| usize::from(*material) < material_count;
            range.layer_count == 0 || materials.is_empty() || has_twice(materials) || !materials.iter().all(is_known)
        };
        let are_too_many = material_count > MAX_MATERIALS || self.ranges.len() > MAX_RANGES;
        let exposures = layers * material_count as u64;
        if layers != u64::from(layer_count)
            || are_too_many
            || exposures > u64::from(u32::MAX)
            || self.ranges.iter().any(is_wrong)
        {
            return Err(format!("exposures {:?} of a job of {layer_count} layers", self.ranges));
        }
        Ok(())
    }

    /// Whether the part is of several materials.
    pub fn has_several(&self) -> bool {
        !self.names.is_empty()
    }

    /// Names of the materials; empty for a part of one.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number of exposures.
    pub fn exposure_count(&self) -> u32 {
        self.ranges.iter().map(PassRange::exposure_count).sum()
    }

    /// Number of layers.
    pub fn layer_count(&self) -> u32 {
        self.ranges.iter().map(|range| range.layer_count).sum()
    }

    /// The exposure of this number. After the last one, that of the layer that would follow.
    pub fn at(&self, exposure: u32) -> Pass {
        let (mut first_layer, mut first, mut material) = (0, 0, 0);
        for range in &self.ranges {
            let within = exposure - first;
            if within < range.exposure_count() {
                let count = range.materials.len() as u32;
                let (offset, pass) = (within / count, (within % count) as u8);
                return Pass { layer: first_layer + offset, pass, material: range.material(offset, pass) };
            }
            first += range.exposure_count();
            first_layer += range.layer_count;
            material = range.last_material();
        }
        Pass { layer: first_layer, pass: 0, material }
    }

    /// The number of an exposure; `None` if there is none such.
    pub fn number(&self, layer: u32, pass: u8) -> Option<u32> {
        let (mut first_layer, mut first) = (0, 0);
        for range in &self.ranges {
            let offset = layer.checked_sub(first_layer)?;
            if offset < range.layer_count {
                let count = range.materials.len() as u32;
                return (u32::from(pass) < count).then(|| first + offset * count + u32::from(pass));
            }
            first += range.exposure_count();
            first_layer += range.layer_count;
        }
        None
    }

    /// How the protocol names an exposure of the job `key`.
    pub fn id(&self, key: u64, exposure: u32) -> ExposureId {
        let Pass { layer, pass, .. } = self.at(exposure);
        ExposureId { job: key, layer, pass }
    }

    /// How often another vat has to be put in place, if the first one is to begin with.
    pub fn changes(&self) -> u32 {
        let mut in_place = 0;
        let mut changes = 0;
        for range in &self.ranges {
            changes += u32::from(range.materials[0] != in_place);
            // Each layer begins with the material that the one before ended with.
            changes += range.layer_count * (range.materials.len() as u32 - 1);
            in_place = range.last_material();
        }
        changes
    }

    /// The name of an exposure's material; `None` if the part is of one.
    pub fn material(&self, exposure: u32) -> Option<&str> {
        self.names.get(usize::from(self.at(exposure).material)).map(String::as_str)
    }

    /// An exposure in words, as in "layer 3", or "layer 3 (stiff)" if the part is of several materials.
    pub fn text(&self, exposure: u32) -> String {
        layer_text(self.at(exposure).layer, self.material(exposure))
    }
}

impl PassRange {
    fn exposure_count(&self) -> u32 {
        self.layer_count * self.materials.len() as u32
    }

    /// The material of a pass of a layer, counted from the first one of the range.
    fn material(&self, offset: u32, pass: u8) -> u8 {
        let place = usize::from(pass);
        let last = self.materials.len() - 1;
        self.materials[if offset.is_multiple_of(2) { place } else { last - place }]
    }

    /// The material that is in place after its last layer.
    fn last_material(&self) -> u8 {
        self.material(self.layer_count - 1, self.materials.len() as u8 - 1)
    }
}

fn has_twice(materials: &[u8]) -> bool {
    materials.iter().enumerate().any(|(at, one)| materials[..at].contains(one))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn spans() -> impl Strategy<Value = (Vec<(String, Range<u32>)>, u32)> {
        let span = (0..20_u32, 1..20_u32).prop_map(|(start, length)| ("some".to_owned(), start..start + length));
        (prop::collection::vec(span, 1..=4), 1..30_u32)
    }

    proptest! {
        #[test]
        fn each_layer_has_its_materials_once_and_numbers_lead_back((spans, layer_count) in spans()) {
            let passes = Passes::of(&spans, layer_count).expect("layers");
            passes.check(layer_count).expect("is whole");
            let all: Vec<Pass> = (0..passes.exposure_count()).map(|at| passes.at(at)).collect();
            prop_assert_eq!((passes.at(all.len() as u32).layer, passes.layer_count()), (layer_count, layer_count));
            for (number, Pass { layer, pass, .. }) in (0..).zip(&all) {
                prop_assert_eq!(passes.number(*layer, *pass), Some(number));
            }
            prop_assert!(all.is_sorted_by_key(|pass| (pass.layer, pass.pass)), "ids ascend");
            for layer in 0..layer_count {
                let mut found: Vec<u8> = all.iter().filter(|pass| pass.layer == layer).map(|pass| pass.material).collect();
                found.sort_unstable();
                let expected: Vec<u8> = (0..spans.len() as u8).filter(|at| spans[usize::from(*at)].1.contains(&layer)).collect();
                prop_assert!(found == expected || expected.is_empty() && found.len() == 1, "{:?}", found);
            }
            let vats = std::iter::once(0).chain(all.iter().map(|pass| pass.material));
            let vats: Vec<u8> = vats.collect();
            let changes = vats.windows(2).filter(|pair| pair[0] != pair[1]).count();
            prop_assert_eq!(passes.changes() as usize, changes);
        }

        /// With two materials no other order needs fewer changes.
        #[test]
        fn two_materials_are_changed_as_seldom_as_possible((spans, layer_count) in spans()) {
            let spans = &spans[..spans.len().min(2)];
            let passes = Passes::of(spans, layer_count).expect("layers");
            // The fewest changes after each layer, by the vat that is in place then.
            let mut fewest = [0_u32, u32::MAX / 2];
            for layer in 0..layer_count {
                let has: Vec<usize> = (0..spans.len()).filter(|at| spans[*at].1.contains(&layer)).collect();
                let before = fewest;
                match has.as_slice() {
                    [] => {}
                    [only] => {
                        fewest = [u32::MAX / 2; 2];
                        fewest[*only] = before[*only].min(before[1 - only] + 1);
                    }
                    _ => fewest = [before[1].min(before[0] + 1) + 1, before[0].min(before[1] + 1) + 1],
                }
            }
            prop_assert_eq!(passes.changes(), fewest[0].min(fewest[1]));
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        assert_eq!(Passes::of(&[], 3), None);
        assert_eq!(Passes::of(&[("one".into(), 0..1)], 0), None);
        assert_eq!(Passes::single(3).exposure_count(), 3);
        let of = |materials: &[u8]| {
            let ranges = vec![PassRange { layer_count: 2, materials: materials.to_vec() }];
            Passes { names: vec!["one".into(), "two".into()], ranges }
        };
        assert_eq!(of(&[1, 0]).check(2), Ok(()));
        for wrong in [of(&[1, 1]), of(&[]), of(&[2]), Passes::single(3)] {
            assert!(wrong.check(2).is_err(), "{wrong:?}");
        }
    }
}
