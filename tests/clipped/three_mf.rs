//! Clipping as 3MF states it.

use std::fmt::Write as _;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use layerd::buildfile::{BodyHeader, BuildFile, Joint, JointChoice, Keeps, PackError, PackReport, Strut};
use layerd::layer::{Bitmap, Depth, Mirror};
use proptest::prelude::*;

use crate::pack_bench::{Bench, HEAD, notes, packed_lattice, said};
use crate::shapes::{Mesh, ball, cuboid};
use crate::slice_part::strut;
use crate::{Clipped, Packed, properties, sliced};

/// Nodes of the test's lattice, millimetres: a post and an arm.
const NODES: [[i32; 3]; 3] = [[0, 0, 0], [0, 0, 4], [3, 1, 4]];

const BEAMS: &str = r#"<b:beams><b:beam v1="0" v2="1"/><b:beam v1="1" v2="2"/></b:beams>"#;

/// The mesh of an object, whose lengths are micrometres here and millimetres there, and what stands beside its triangles.
fn mesh_text(mesh: &Mesh, beside: &str) -> String {
    let (mut vertices, mut triangles) = (String::new(), String::new());
    for (number, triangle) in mesh.0.iter().enumerate() {
        for corner in triangle {
            let [x, y, z] = (*corner / 1000.0).to_array();
            write!(vertices, r#"<vertex x="{x}" y="{y}" z="{z}"/>"#).expect("a string grows");
        }
        let [a, b, c] = [0, 1, 2].map(|corner| 3 * number + corner);
        write!(triangles, r#"<triangle v1="{a}" v2="{b}" v3="{c}"/>"#).expect("a string grows");
    }
    format!("<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles>{beside}</mesh>")
}

/// An object 7 with the test's lattice, whose attributes are these, and an object 4 of that mesh.
fn model(attributes: &str, mesh: &str, build: &str) -> String {
    let nodes: String = NODES.iter().map(|[x, y, z]| format!(r#"<vertex x="{x}" y="{y}" z="{z}"/>"#)).collect();
    format!(
        r#"{HEAD}><resources><object id="4" name="Clip">{mesh}</object><object id="7" name="Tower"><mesh>
        <vertices>{nodes}</vertices><b:beamlattice radius="0.3" minlength="0.001" {attributes}>{BEAMS}</b:beamlattice></mesh>
        </object></resources><build>{build}</build></model>"#
    )
}

fn attributes(keeps: Keeps) -> &'static str {
    match keeps {
        Keeps::Inside => r#"clippingmode="inside" clippingmesh="4""#,
        // As published samples write it.
        Keeps::Outside => r#"clipping="outside" clippingmesh="4""#,
    }
}

/// A build item of the lattice at that place.
fn item(place: &DAffine3) -> String {
    let values = place.to_cols_array().map(|value| value.to_string()).join(" ");
    format!(r#"<item objectid="7" transform="{values}"/>"#)
}

/// The lattice and its clip at a place, as a build file has them. Transforms are such that nothing is rounded.
fn placed(keeps: Keeps, mesh: &Mesh, place: &DAffine3) -> Clipped {
    let node = |number: usize| {
        let at = place.transform_point3(DVec3::from(NODES[number].map(f64::from)));
        (at * 1000.0).round().to_array().map(|at| at as i32)
    };
    let struts: [Strut; 2] = [strut(node(0), node(1), 300, 300), strut(node(1), node(2), 300, 300)];
    let mut mesh = mesh.clone().moved(place.matrix3, place.translation * 1000.0);
    if place.matrix3.determinant() < 0.0 {
        mesh = mesh.reversed();
    }
    Clipped::new(&struts, Joint::Union, keeps, &mesh)
}

fn packed(bench: &Bench, text: &str) -> Result<(Packed, PackReport), PackError> {
    let (report, _) = bench.model(text)?;
    let file = BuildFile::open(&bench.path("out.layerd")).expect("what pack writes is whole");
    file.verify().expect("it agrees with itself");
    Ok((Packed { file: Arc::new(file), _directory: tempfile::tempdir().expect("temporary directory") }, report))
}

/// What the layers of a file should be: those of all clipped lattices.
fn expected(packed: &Packed, all: &[Clipped], depth: Depth) -> [Vec<Bitmap>; 2] {
    let plan = packed.plan(depth, Mirror::default(), 40.0);
    let mut expected: Vec<Bitmap> = Vec::new();
    for clipped in all {
        let [lattice, clip] =
            [0, 1].map(|body| sliced(|| clipped.alone().into_iter().nth(body).unwrap_or_default(), &plan, 1, 0));
        expected.resize_with(lattice.len(), || Bitmap::new(plan.raster.width_px, plan.raster.height_px, depth));
        for (expected, (lattice, clip)) in expected.iter_mut().zip(lattice.iter().zip(&clip)) {
            for (out, (lattice, clip)) in expected.data_mut().iter_mut().zip(lattice.data().iter().zip(clip.data())) {
                let left = if clipped.keeps == Keeps::Inside { *clip } else { 255 - clip };
                *out = if depth == Depth::Grey { (*out).max(*lattice.min(&left)) } else { *out | lattice & left };
            }
        }
    }
    [packed.layers(&plan, 2, 0), expected]
}

fn place(matrix3: DMat3, translation: [f64; 3]) -> DAffine3 {
    DAffine3 { matrix3, translation: translation.into() }
}

/// A ball around the lattice's corner, from which it reaches out on all sides.
fn around_corner() -> Mesh {
    ball([500.0, 250.0, 3500.0], 1500.0, 3)
}

#[test]
fn a_clip_moves_along_with_its_lattice_and_each_place_has_its_own() {
    let quarter = DMat3::from_cols(DVec3::Z, DVec3::Y, -DVec3::X);
    let mirrored = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)) * quarter;
    let apart = [place(DMat3::IDENTITY, [0.0; 3]), place(quarter, [9.0, 0.0, 3.0]), place(mirrored, [-9.0, 2.0, 1.0])];
    // Each mesh reaches the other's lattice.
    let near =
        [place(DMat3::IDENTITY, [0.0; 3]), place(DMat3::IDENTITY, [0.5, 0.25, 1.0]), place(mirrored, [0.0, 0.5, 4.0])];
    for (places, pairs) in [(apart, 1), (near, 3)] {
        for keeps in [Keeps::Inside, Keeps::Outside] {
            for depth in [Depth::Bit, Depth::Grey] {
                let bench = Bench::new();
                let build: String = places.iter().map(item).collect();
                let text = model(attributes(keeps), &mesh_text(&around_corner(), ""), &build);
                let (packed, report) = packed(&bench, &text).unwrap_or_else(|error| panic!("{error}"));
                assert_eq!(report.notes, Vec::<String>::new());
                assert_eq!(packed.header().bodies.len(), 2 * pairs, "{keeps:?}");
                let all = places.map(|place| placed(keeps, &around_corner(), &place));
                let [found, expected] = expected(&packed, &all, depth);
                assert!(found == expected, "{keeps:?}, {depth:?}, {pairs}");
            }
        }
    }
}

/// Turns and mirrors that map axes to axes.
fn any_turn() -> impl Strategy<Value = DMat3> {
    let axes = Just([DVec3::X, DVec3::Y, DVec3::Z]).prop_shuffle();
    (axes, prop::array::uniform3(any::<bool>())).prop_map(|(axes, signs)| {
        let [x, y, z] = [0, 1, 2].map(|axis| if signs[axis] { axes[axis] } else { -axes[axis] });
        DMat3::from_cols(x, y, z)
    })
}

proptest! {
    #![proptest_config(properties::cases(20))]

    /// Whether places share bodies or not.
    #[test]
    fn wherever_lattices_are_placed_each_is_clipped_by_its_own_mesh(
        places in prop::collection::vec((any_turn(), prop::array::uniform3(-20..20_i32)), 1..6), inside in any::<bool>(), grey in any::<bool>(),
    ) {
        let keeps = if inside { Keeps::Inside } else { Keeps::Outside };
        let depth = if grey { Depth::Grey } else { Depth::Bit };
        let places: Vec<_> =
            places.iter().map(|(turn, quarters)| place(*turn, quarters.map(|at| f64::from(at) / 4.0))).collect();
        let build: String = places.iter().map(item).collect();
        let text = model(attributes(keeps), &mesh_text(&around_corner(), ""), &build);
        let (packed, _) = packed(&Bench::new(), &text).unwrap_or_else(|error| panic!("{error}"));
        let all: Vec<_> = places.iter().map(|place| placed(keeps, &around_corner(), place)).collect();
        let [found, expected] = expected(&packed, &all, depth);
        prop_assert!(found == expected);
    }
}

#[test]
fn lattices_that_the_same_mesh_clips_share_bodies() {
    for joint in [None, Some(JointChoice::Convolution { support_mm: Some(0.5) })] {
        let mut bench = Bench::new();
        bench.options.joint = joint;
        let lattice = format!(r#"<b:beamlattice radius="0.3" minlength="0" {}>{BEAMS}"#, attributes(Keeps::Inside));
        let object = |number: u32| {
            format!(
                r#"<object id="{number}"><mesh><vertices><vertex x="{number}" y="0" z="1"/><vertex x="0" y="0" z="4"/>
                <vertex x="0" y="{number}" z="1"/></vertices>{lattice}</b:beamlattice></mesh></object>"#
            )
        };
        let objects: String = (11..19).map(object).collect();
        let build: String = (11..19).map(|number| format!(r#"<item objectid="{number}"/>"#)).collect();
        let text = model(attributes(Keeps::Inside), &mesh_text(&around_corner(), ""), &build);
        let (packed, report) = packed(&bench, &text.replace("</resources>", &format!("{objects}</resources>")))
            .unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(packed.header().bodies.len(), 2);
        assert_eq!(packed_lattice(&report).strut_count, 16);
        // Seen from the corner, all are within the ball.
        assert!(packed.header().bounds.max[2] > 4200 && packed.header().bottom_um < 3600.0, "{:?}", packed.header());
    }
}

#[test]
fn in_components_of_other_parts_it_is_the_same() {
    let text = model(attributes(Keeps::Inside), &mesh_text(&around_corner(), ""), "")
        .replace("</resources>", r#"<object id="9"><components><component objectid="7" transform="0 1 0 -1 0 0 0 0 1 0 0 2"/></components></object></resources>"#)
        .replace("<build></build>", r#"<build><item objectid="9"/></build>"#);
    let (packed, _) = packed(&Bench::new(), &text).unwrap_or_else(|error| panic!("{error}"));
    let turned = place(DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z), [0.0, 0.0, 2.0]);
    let [found, expected] = expected(&packed, &[placed(Keeps::Inside, &around_corner(), &turned)], Depth::Bit);
    assert!(found == expected);
}

#[test]
fn options_turn_and_scale_lattice_and_clip() {
    let mut bench = Bench::new();
    let text = model(attributes(Keeps::Outside), &mesh_text(&around_corner(), ""), r#"<item objectid="7"/>"#);
    (bench.options.rotate_deg, bench.options.scale) = ([90.0, 0.0, 0.0], [2.0; 3]);
    let (packed, _) = packed(&bench, &text).unwrap_or_else(|error| panic!("{error}"));
    let height_um = f64::from(packed.header().bounds.max[2]) - packed.header().bottom_um;
    // y becomes z: the post is 0.6 mm wide, and the arm rises to 1.3 mm.
    assert!((height_um - 3200.0).abs() < 25.0, "{height_um}");
}

#[test]
fn only_the_lattice_is_clipped_and_the_clip_is_printed_only_if_it_is_in_the_build() {
    let slab = cuboid([-1000.0, -1000.0, 1000.0], [1000.0, 1000.0, 2000.0]);
    let whole = |build: &str| {
        let text = model(attributes(Keeps::Inside), &mesh_text(&slab, ""), build);
        let (packed, report) = packed(&Bench::new(), &text).unwrap_or_else(|error| panic!("{error}"));
        (packed.header().bottom_um, packed.header().bounds, report.header.bodies)
    };
    let (bottom_um, bounds, bodies) = whole(r#"<item objectid="7"/>"#);
    assert_eq!((bottom_um, bounds.min[2], bounds.max[2]), (1000.0, 1000, 2000));
    assert!(
        matches!(&bodies[..], [BodyHeader::Lattice(_), BodyHeader::Clip(clip)] if clip.surface.triangle_count == 12)
    );
    // A solid of its own, from which the lattice's vertices follow.
    let solid = r#"<triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/><triangle v1="1" v2="2" v3="3"/><triangle v1="0" v2="3" v3="2"/></triangles>"#;
    let text = model(attributes(Keeps::Inside), &mesh_text(&slab, ""), r#"<item objectid="7"/>"#)
        .replace(r#"<vertex x="3" y="1" z="4"/>"#, r#"<vertex x="3" y="1" z="4"/><vertex x="0" y="5" z="2"/>"#)
        .replace("<b:beamlattice", &format!("{solid}<b:beamlattice"));
    let (both, _) = packed(&Bench::new(), &text).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((both.header().bottom_um, both.header().bounds.max), (0.0, [3000, 5000, 4000]), "the solid is whole");
    assert!(matches!(&both.header().bodies[..], [BodyHeader::Lattice(_), BodyHeader::Clip(_), BodyHeader::Surface(_)]));
    let (_, bounds, bodies) = whole(r#"<item objectid="7"/><item objectid="4" transform="1 0 0 0 1 0 0 0 1 9 0 9"/>"#);
    assert_eq!((bodies.len(), bounds.min, bounds.max), (3, [-300, -1000, 1000], [10_000, 1000, 11_000]));
}

#[test]
fn lattices_that_are_clipped_and_others_are_printed_together() {
    let text = model(attributes(Keeps::Inside), &mesh_text(&around_corner(), ""), r#"<item objectid="7"/><item objectid="8"/>"#)
        .replace("</resources>", 
            r#"<object id="8"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="0" y="0" z="9"/></vertices>
            <b:beamlattice radius="0.2" minlength="0"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice></mesh></object></resources>"#
        );
    let (packed, _) = packed(&Bench::new(), &text).unwrap_or_else(|error| panic!("{error}"));
    let bodies = &packed.header().bodies;
    assert!(matches!(&bodies[..], [BodyHeader::Lattice(_), BodyHeader::Lattice(_), BodyHeader::Clip(_)]));
    assert_eq!((packed.header().bottom_um, packed.header().bounds.max[2]), (-200.0, 9200));
}

#[test]
fn a_clip_that_is_no_mesh_or_leaves_nothing_is_refused() {
    let bench = Bench::new();
    let item = r#"<item objectid="7"/>"#;
    let plain = model(attributes(Keeps::Inside), &mesh_text(&around_corner(), ""), item);
    let refused = |text: &str, parts: &[&str]| {
        let found = said(bench.model(text));
        assert!(parts.iter().all(|part| found.contains(part)), "{found}");
        assert!(!bench.path("out.layerd").exists(), "no file stays behind");
    };
    let clipped = "object 7 (Tower): its lattice is to be clipped (inside) by the mesh of object";
    let with_mesh = |id: &str| plain.replace(r#"clippingmesh="4""#, id);
    refused(&with_mesh(""), &[clipped, "has no clippingmesh"]);
    refused(&with_mesh(r#"clippingmesh="5""#), &[clipped, "object 5", "does not exist"]);
    refused(&with_mesh(r#"clippingmesh="four""#), &[clipped, "object four", "does not exist"]);
    refused(&with_mesh(r#"clippingmesh="7""#), &[clipped, "itself"]);
    let other =
        |object: &str| with_mesh(r#"clippingmesh="5""#).replace("</resources>", &format!("{object}</resources>"));
    refused(
        &other(r#"<object id="5"><components><component objectid="4"/></components></object>"#),
        &[clipped, "no triangles"],
    );
    let lattice =
        mesh_text(&around_corner(), &format!(r#"<b:beamlattice radius="1" minlength="0">{BEAMS}</b:beamlattice>"#));
    refused(&other(&format!(r#"<object id="5">{lattice}</object>"#)), &[clipped, "holds a lattice"]);
    refused(&plain.replace("\"inside\"", "\"between\""), &["clippingmode `between`", "none, inside and outside"]);
    let of = |mesh: &Mesh| model(attributes(Keeps::Inside), &mesh_text(mesh, ""), item);
    refused(&of(&around_corner().reversed()), &["object 4 (Clip)", "inside out"]);
    refused(&of(&Mesh(around_corner().0[..9].to_vec())), &["object 4 (Clip)", "open"]);
    refused(&of(&ball([9000.0; 3], 500.0, 1)), &["object 7 (Tower)", "leaves nothing"]);
    // Within the box of the lattice, but not within a beam.
    refused(&of(&ball([1500.0, 500.0, 1000.0], 500.0, 1)), &["object 7 (Tower)", "leaves nothing"]);
    let around = cuboid([-1000.0; 3], [5000.0; 3]);
    refused(&model(attributes(Keeps::Outside), &mesh_text(&around, ""), item), &["object 7 (Tower)", "leaves nothing"]);
}

#[test]
fn a_clip_with_a_hole_is_closed() {
    let mut slab = cuboid([-1000.0, -1000.0, 1000.0], [1000.0, 1000.0, 2000.0]);
    slab.0.pop();
    let text = model(attributes(Keeps::Inside), &mesh_text(&slab, ""), r#"<item objectid="7"/>"#);
    let (packed, report) = packed(&Bench::new(), &text).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((packed.header().bottom_um, packed.header().bounds.max[2]), (1000.0, 2000));
    assert!(report.notes[0].contains("object 4 (Clip)") && report.notes[0].contains("1 hole"), "{:?}", report.notes);
}

#[test]
fn without_clipping_the_whole_lattice_is_packed() {
    let mut bench = Bench::new();
    bench.options.lattice_only = true;
    let text = model(attributes(Keeps::Inside), &mesh_text(&around_corner(), ""), r#"<item objectid="7"/>"#);
    // Even without the mesh.
    for text in [text.replace("\"4\"", "\"5\""), text] {
        let (told, struts) = notes(&bench, &text);
        assert_eq!(struts.len(), 2);
        assert!(told.contains("clipped (inside)") && told.contains("the whole lattice"), "{told}");
    }
}

#[test]
fn too_many_lattices_within_one_another_are_counted() {
    let build = |step_mm: f64| {
        let places = (0..8).map(|number| place(DMat3::IDENTITY, [f64::from(number) * step_mm, 0.0, 0.0]));
        let build: String = places.map(|place| item(&place)).collect();
        model(attributes(Keeps::Outside), &mesh_text(&around_corner(), ""), &build)
    };
    let mut bench = Bench::new();
    let found = said(bench.model(&build(0.01)));
    assert!(
        found.contains("object 7 (Tower)") && found.contains("these are 8 such") && found.contains("at most 6"),
        "{found}"
    );
    let (apart, _) = packed(&bench, &build(10.0)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(apart.header().bodies.len(), 2);
    bench.options.joint = Some(JointChoice::Convolution { support_mm: None });
    let found = said(bench.model(&build(10.0)));
    assert!(
        found.contains("8 lattices are clipped by meshes of their own") && found.contains("--joint union"),
        "{found}"
    );
}
