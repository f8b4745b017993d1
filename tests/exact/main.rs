//! The fast paths against the plain `f64` field on lattices made to hurt them: every pixel agrees unless the field is within
//! 10⁻⁵ of the isovalue.

mod joined;
#[path = "../properties/mod.rs"]
mod properties;
#[path = "../slice_part/mod.rs"]
mod slice_part;

use layerd::buildfile::{Caps, Joint, Strut};
use layerd::layer::{Depth, Mirror, Raster};
use layerd::solid::InstructionSet;
use layerd::solid::reference::beam_field;
use proptest::prelude::*;
use slice_part::{HEIGHT, Part, WIDTH, beam, lit, raster, strut};

pub(crate) const UNDECIDED: f64 = 1e-5;

/// Support in pixels from a pixel to half a picture: patches of one to three vectors, rows, and stretches of long rows.
const SUPPORTS_PX: [f64; 6] = [1.0, 2.7, 4.5, 9.0, 17.0, 36.0];

/// What a lattice is made of, in units of a thousandth of the support.
#[derive(Clone, Debug)]
pub(crate) struct Lattice {
    pub(crate) support_px: f64,
    pub(crate) struts: Vec<Strut>,
}

pub(crate) const SUPPORT: i32 = 1000;

pub(crate) fn lattice() -> impl Strategy<Value = Lattice> {
    prop::sample::select(SUPPORTS_PX.to_vec()).prop_flat_map(move |support_px| {
        // With its radius every strut stays on the picture.
        let size = [WIDTH, HEIGHT].map(|px| (0.99 * f64::from(px) / support_px * f64::from(SUPPORT)) as i32);
        let [width, height] = size.map(|size| SUPPORT * 9 / 10..size.max(2 * SUPPORT) - SUPPORT * 9 / 10);
        let node = (width.clone(), height.clone(), 0..4 * SUPPORT).prop_map(|(x, y, z)| [x, y, z]);
        let strut = (node.clone(), node, -SUPPORT..SUPPORT, 1..900_u32, 1..900_u32, 0..10_u8).prop_map(shaped);
        let inside = move |node: [i32; 3]| {
            [node[0].clamp(width.start, width.end), node[1].clamp(height.start, height.end), node[2]]
        };
        let strut = strut.prop_map(move |strut| Strut { a: inside(strut.a), b: inside(strut.b), ..strut });
        prop::collection::vec(strut, 1..30).prop_map(move |struts| Lattice { support_px, struts })
    })
}

/// One strut of a kind.
fn shaped((a, far, step, radius, other, kind): ([i32; 3], [i32; 3], i32, u32, u32, u8)) -> Strut {
    let near = [a[0] + step, a[1] - step / 2, a[2] + step / 3];
    match kind {
        0 => strut(a, [a[0] + 1, a[1], a[2]], radius, radius), // of almost no length
        1 => strut(a, [a[0] + step / 50, a[1] + 9, a[2]], radius, other), // much shorter than the support
        2 => strut(a, [far[0], far[1], a[2]], radius, radius), // in a layer's plane
        3 => strut(a, [far[0], a[1], a[2]], radius, other),    // along the rows
        4 => strut(a, [a[0], far[1], a[2] + 1], radius, radius), // down the columns, nearly flat
        5 => strut(a, [a[0], a[1], a[2] + 3 * SUPPORT], 1, other), // upright, from needle to thick
        6 => strut(a, far, 1, 1),                              // thin
        7 => strut(a, a, radius, radius),                      // a ball
        8 => strut(a, far, radius, other),
        _ => strut(a, near, radius, radius),
    }
}

/// Every pixel against the reference, and equal bits on every instruction set.
fn check(lattice: &Lattice) -> Result<(), TestCaseError> {
    let pitch_um = f64::from(SUPPORT) / lattice.support_px;
    let raster = Raster {
        pixel_um: [pitch_um, pitch_um * 1.1],
        build_height_um: 1e9,
        ..raster(Mirror { x: lattice.struts.len().is_multiple_of(2), y: lattice.struts.len().is_multiple_of(3) })
    };
    let joint = Joint::Convolution { support_um: f64::from(SUPPORT) };
    let part = Part::on(raster, &lattice.struts, joint, Depth::Bit, 833.0);
    let beams: Vec<_> = lattice.struts.iter().map(beam).collect();
    let layers = part.layers(2, 0);
    for instructions in InstructionSet::available() {
        prop_assert_eq!(&part.layers_with(instructions, 1, 0), &layers);
    }
    // Without fused multiply-add its bits may differ, where the processor has it.
    let portable = part.layers_with(InstructionSet::PORTABLE, 1, 0);
    for (layer, (bitmap, portable)) in layers.iter().zip(&portable).enumerate() {
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let p = part.point(x, y, layer);
            let field: f64 = beams.iter().map(|beam| beam_field(beam, f64::from(SUPPORT), p)).sum();
            for bitmap in [bitmap, portable] {
                let agrees = lit(bitmap, x, y) == (field >= 1.0) || (field - 1.0).abs() < UNDECIDED;
                prop_assert!(agrees, "layer {layer}, pixel {x}, {y}: field {field}");
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(properties::cases(30))]

    #[test]
    fn hostile_lattices_agree_with_the_reference(lattice in lattice()) {
        check(&lattice)?;
    }

    #[test]
    fn far_from_the_origin_as_well(lattice in lattice(), far in prop::array::uniform3(-1_000_000_000..1_000_000_000_i32)) {
        let moved = |node: [i32; 3]| [0, 1, 2].map(|axis| node[axis] + far[axis]);
        let struts = lattice.struts.iter().map(|strut| Strut { a: moved(strut.a), b: moved(strut.b), ..*strut });
        check(&Lattice { struts: struts.collect(), ..lattice })?;
    }
}

/// Thousands of thin struts meet in one node: their fields, each far below the isovalue, add up.
#[test]
fn thousands_of_struts_meet_in_one_node() {
    for support_px in [2.7, 9.0] {
        let scale = f64::from(SUPPORT) / support_px;
        let centre = [f64::from(WIDTH) / 2.0 * scale, f64::from(HEIGHT) / 2.0 * scale].map(|x| x as i32);
        let struts: Vec<Strut> = (0..3000)
            .map(|k| {
                // Directions spread evenly over the sphere.
                let (height, turn) = (1.0 - (f64::from(k) + 0.5) / 1500.0, f64::from(k) * 2.399_963);
                let level = (1.0 - height * height).sqrt();
                let end =
                    [level * turn.cos(), level * turn.sin(), height].map(|x| (x * 3.0 * f64::from(SUPPORT)) as i32);
                let node = [centre[0], centre[1], 3 * SUPPORT];
                let radius = 1 + k as u32 % 3;
                Strut {
                    caps: Caps::default(),
                    ..strut(node, [0, 1, 2].map(|axis| node[axis] + end[axis]), radius, radius)
                }
            })
            .collect();
        check(&Lattice { support_px, struts }).expect("agrees");
    }
}
