//! Lattices of several materials against the formulas: their solid, and which material each pixel gets.

use layerd::buildfile::{Joint, Materials, Shares, Split, Strut};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, JoinedLattice, MaskSlicer, MaskSources, MemoryStruts, SlicePlan};
use layerd::solid::InstructionSet;
use layerd::solid::reference::{beam_field, elliptic, fractions, shared_beam_field};
use layerd::stream::MemoryBudget;
use proptest::prelude::*;

use crate::slice_part::{HEIGHT, Part, WIDTH, beam, header, lit, raster, sliced};
use crate::{Lattice, SUPPORT, UNDECIDED, lattice, properties};

/// A lattice, and the mixture of each strut at its ends.
#[derive(Clone, Debug)]
struct Mixed {
    lattice: Lattice,
    mixtures: Vec<[Vec<u16>; 2]>,
    joint: Joint,
    count: usize,
}

/// Shares of `count` materials that add up to a whole: pure ones, and mixtures.
fn mixture(count: usize) -> impl Strategy<Value = Vec<u16>> {
    let pure = (0..count).prop_map(move |one| (0..count).map(|at| if at == one { Shares::WHOLE } else { 0 }).collect());
    let cuts = prop::collection::vec(0..=Shares::WHOLE, count - 1).prop_map(|mut cuts| {
        cuts.sort_unstable();
        let ends: Vec<u16> = cuts.iter().copied().chain([Shares::WHOLE]).collect();
        let begins = std::iter::once(0).chain(cuts);
        ends.iter().zip(begins).map(|(end, begin)| end - begin).collect()
    });
    prop_oneof![2 => pure, 1 => cuts]
}

fn joint(count: usize) -> impl Strategy<Value = Joint> {
    let support_um = f64::from(SUPPORT);
    let arc = (0.002..0.9_f64, 0.002..0.9_f64, any::<bool>()).prop_map(move |(first, second, is_even)| {
        let second = if is_even || count > 2 { first } else { second };
        Joint::Elliptic { support_um, least: [first, second] }
    });
    prop_oneof![Just(Joint::Convolution { support_um }), arc]
}

fn mixed() -> impl Strategy<Value = Mixed> {
    (lattice(), 2..5_usize).prop_flat_map(|(lattice, count)| {
        // One in three struts is graded; balls are mixed evenly.
        let ends = (mixture(count), mixture(count), 0..3_u8)
            .prop_map(|(a, b, kind)| if kind == 0 { [a, b] } else { [a.clone(), a] });
        let mixtures = prop::collection::vec(ends, lattice.struts.len());
        (Just(lattice), mixtures, joint(count)).prop_map(move |(lattice, mut mixtures, joint)| {
            for (strut, mixture) in lattice.struts.iter().zip(&mut mixtures) {
                if strut.is_ball() {
                    mixture[1] = mixture[0].clone();
                }
            }
            Mixed { lattice, mixtures, joint, count }
        })
    })
}

impl Mixed {
    /// The struts of one material, with their shares.
    fn struts_of(&self, material: usize) -> Vec<Strut> {
        let shared = self.lattice.struts.iter().zip(&self.mixtures).map(|(strut, [a, b])| {
            let shares = Shares { a: a[material], b: b[material] };
            Strut { shares, ..*strut }
        });
        shared.filter(|strut| strut.shares.a > 0 || strut.shares.b > 0).collect()
    }

    /// The body of all materials that have struts, and these materials.
    fn body(&self) -> (BodySource, Vec<usize>) {
        let materials: Vec<_> = (0..self.count).filter(|material| !self.struts_of(*material).is_empty()).collect();
        let member = |material: &usize| {
            let struts = self.struts_of(*material);
            let header = header(&struts, self.joint);
            let lattice = layerd::buildfile::Lattice { is_graded: true, ..crate::slice_part::lattice(&header) };
            let lattice = Box::new(MemoryStruts::new(1.0, lattice, struts, 5));
            JoinedLattice { lattice, material: *material as u8 }
        };
        (BodySource::Joined(materials.iter().map(member).collect()), materials)
    }

    fn least(&self) -> Option<Vec<f64>> {
        let Joint::Elliptic { least: [first, others], .. } = self.joint else { return None };
        Some(std::iter::once(first).chain(std::iter::repeat(others)).take(self.body().1.len()).collect())
    }
}

/// The masks of all layers.
fn masks(
    mixed: &Mixed,
    plan: &SlicePlan,
    split: Split,
    instructions: InstructionSet,
    threads: usize,
) -> Vec<Vec<Bitmap>> {
    let names = (0..mixed.count).map(|number| format!("material {number}")).collect();
    let materials = Materials { names, of_bodies: vec![0], split };
    let sources = || MaskSources::new(vec![(mixed.body().0, 0)], Some(&materials));
    let memory = MaskSlicer::memory_bytes(&sources(), plan, threads);
    let budget = MemoryBudget::new(memory);
    let slicer = MaskSlicer::with_instructions(instructions, sources(), plan.clone(), threads, 0, &budget);
    let mut slicer = slicer.expect("a slicer");
    assert_eq!(budget.used_bytes(), memory, "what was stated is charged");
    let mut layers = Vec::new();
    let mut masks = slicer.dark_masks();
    masks.iter_mut().for_each(|mask| mask.data_mut().fill(0xa5));
    while slicer.next_layer(&mut masks).expect("a layer").is_some() {
        layers.push(masks.clone());
    }
    layers
}

/// Every pixel against the formulas: whether it is solid, and whose it is.
fn check(mixed: &Mixed) -> Result<(), TestCaseError> {
    let lattice = &mixed.lattice;
    let pitch_um = f64::from(SUPPORT) / lattice.support_px;
    let mirror = Mirror { x: lattice.struts.len().is_multiple_of(2), y: lattice.struts.len().is_multiple_of(3) };
    let raster = Raster { pixel_um: [pitch_um, pitch_um * 1.1], build_height_um: 1e9, ..raster(mirror) };
    let part = Part::on(raster, &lattice.struts, mixed.joint, Depth::Bit, 833.0);
    let whole = sliced(|| vec![mixed.body().0], &part.plan, 2, 0);
    let split = if lattice.struts.len().is_multiple_of(5) { Split::Halftone } else { Split::Max };
    let masks_of = |instructions, threads| masks(mixed, &part.plan, split, instructions, threads);
    let drawn = masks_of(InstructionSet::detect(), 2);
    for instructions in InstructionSet::available() {
        prop_assert_eq!(&masks_of(instructions, 1), &drawn);
    }
    let (_, materials) = mixed.body();
    let least = mixed.least();
    let beams: Vec<_> = lattice.struts.iter().map(beam).collect();
    for (layer, (whole, masks)) in whole.iter().zip(&drawn).enumerate() {
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let owners: Vec<_> = (0..mixed.count).filter(|material| lit(&masks[*material], x, y)).collect();
            prop_assert_eq!(owners.len(), usize::from(lit(whole, x, y)), "layer {} pixel {}, {}", layer, x, y);
            let p = part.point(x, y, layer);
            let of_material = |material: &usize| -> f64 {
                let field = |(number, strut): (usize, &layerd::solid::Beam)| {
                    let shares = [0, 1].map(|end| f64::from(mixed.mixtures[number][end][*material]) / 65535.0);
                    shared_beam_field(strut, shares, f64::from(SUPPORT), p)
                };
                beams.iter().enumerate().map(field).sum()
            };
            let fields: Vec<f64> = materials.iter().map(of_material).collect();
            let sum: f64 = fields.iter().sum();
            let unmixed: f64 = beams.iter().map(|beam| beam_field(beam, f64::from(SUPPORT), p)).sum();
            prop_assert!((sum - unmixed).abs() <= 1e-9 * unmixed.max(1.0), "{sum} is {unmixed} without materials");
            let joined = least.as_ref().map_or(sum, |least| elliptic(&fields, least));
            let agrees = lit(whole, x, y) == (joined >= 1.0) || (joined - 1.0).abs() < UNDECIDED;
            prop_assert!(agrees, "layer {layer}, pixel {x}, {y}: joined field {joined} of {fields:?}");
            if let Some(owner) = owners.first() {
                let shares = fractions(&fields);
                let share = shares[materials.iter().position(|material| material == owner).expect("it has struts")];
                let most = shares.iter().copied().fold(0.0, f64::max);
                match split {
                    Split::Max => prop_assert!(share >= most - UNDECIDED, "{owner} of {shares:?}"),
                    Split::Halftone => prop_assert!(share > 0.0 || most < 1.0 - UNDECIDED, "{owner} of {shares:?}"),
                }
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(properties::cases(20))]

    #[test]
    fn joined_lattices_agree_with_the_reference(mixed in mixed()) {
        check(&mixed)?;
    }
}

proptest! {
    #![proptest_config(properties::cases(12))]

    /// In grey, too, each pixel has one material, and all masks together are the whole.
    #[test]
    fn grey_masks_are_the_whole(mixed in mixed()) {
        let pitch_um = f64::from(SUPPORT) / mixed.lattice.support_px;
        let raster = Raster { pixel_um: [pitch_um; 2], build_height_um: 1e9, ..raster(Mirror::default()) };
        let part = Part::on(raster, &mixed.lattice.struts, mixed.joint, Depth::Grey, 833.0);
        let whole = sliced(|| vec![mixed.body().0], &part.plan, 1, 0);
        let masks = masks(&mixed, &part.plan, Split::Halftone, InstructionSet::detect(), 2);
        prop_assert_eq!(whole.len(), masks.len());
        for (whole, masks) in whole.iter().zip(&masks) {
            for (pixel, grey) in whole.data().iter().enumerate() {
                let of_materials: Vec<u8> = masks.iter().map(|mask| mask.data()[pixel]).filter(|grey| *grey > 0).collect();
                let wanted: Vec<u8> = std::iter::once(*grey).filter(|grey| *grey > 0).collect();
                prop_assert_eq!(of_materials, wanted);
            }
        }
    }
}
