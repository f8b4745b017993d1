//! Meshes of 3MF.

use std::fmt::Write as _;
use std::path::PathBuf;

use crate::pack_bench::{self, BEAM, Bench, HEAD, ITEM, MODEL, RELATIONSHIPS};
use crate::{box_triangles, corner, packed, volume_mm3};

/// A mesh of 3MF.
fn mesh(low: [f32; 3], high: [f32; 3]) -> String {
    let mut xml = "<mesh><vertices>".to_owned();
    for number in 0..8 {
        let [x, y, z] = corner(number, low, high);
        write!(xml, r#"<vertex x="{x}" y="{y}" z="{z}"/>"#).expect("a string");
    }
    xml += "</vertices><triangles>";
    for [a, b, c] in box_triangles() {
        write!(xml, r#"<triangle v1="{a}" v2="{b}" v3="{c}"/>"#).expect("a string");
    }
    xml + "</triangles></mesh>"
}

fn package(bench: &Bench, model: &str) -> PathBuf {
    // Packs and fails or not; the package is what counts.
    let _ = bench.package(&[("_rels/.rels", RELATIONSHIPS), (MODEL, model)]);
    bench.path("in.3mf")
}

#[test]
fn solids_of_3mf_stand_beside_lattices_also_mirrored() {
    let bench = Bench::new();
    let solid = mesh([0.0; 3], [8.0, 2.0, 1.0]);
    let lattice = pack_bench::model("", "", BEAM, "", "");
    let model = lattice.replace("</resources>", &format!(r#"<object id="20" name="Foot">{solid}</object></resources>"#)).replace(
        "<build></build>",
        r#"<build><item objectid="7"/><item objectid="20"/><item objectid="20" transform="-1 0 0 0 1 0 0 0 1 0 20 0"/></build>"#,
    );
    let (report, triangles) = packed(&bench, &[package(&bench, &model)]).expect("a lattice and two boxes");
    assert_eq!((report.header.bodies.len(), triangles.len()), (2, 24));
    assert_eq!(report.header.lattices().next().map(|lattice| lattice.strut_count), Some(1));
    // A post of radius 1 mm and height 10 mm with round ends, of which a quarter of the lowest mm lies in the foot.
    let post = std::f64::consts::PI * 10.0 + 4.0 / 3.0 * std::f64::consts::PI - std::f64::consts::PI / 4.0;
    assert!((volume_mm3(&bench) - 32.0 - post).abs() < 0.7, "{} mm³", volume_mm3(&bench));

    let holed = model.replacen(r#"<triangle v1="0" v2="4" v3="6"/>"#, "", 1);
    let (report, found) = packed(&bench, &[package(&bench, &holed)]).expect("holes of one triangle");
    assert!(found == triangles, "each of the two boxes gets its triangle back");
    let note =
        report.notes.iter().find(|note| note.starts_with("closed 2 holes with 2 triangles; the widest is 2.236 mm"));
    assert!(note.is_some_and(|note| note.contains("object 20 (Foot)")), "{:?}", report.notes);
    let open = holed.replacen(r#"<triangle v1="0" v2="6" v3="2"/>"#, "", 1);
    let found = packed(&bench, &[package(&bench, &open)]).expect_err("it has a hole").to_string();
    assert!(found.contains("object 20 (Foot)") && found.contains("open"), "{found}");
    let wild = model.replacen(r#"v3="6""#, r#"v3="60""#, 1);
    let found = packed(&bench, &[package(&bench, &wild)]).expect_err("a vertex is missing").to_string();
    assert!(found.contains("triangle 1: vertex 60; there are 8 vertices"), "{found}");
}

#[test]
fn lattice_only_leaves_solids_out_with_a_note() {
    let mut bench = Bench::new();
    let solid = mesh([0.0; 3], [8.0, 2.0, 1.0]);
    let beam = r#"<b:beamlattice radius="1" minlength="0.001"><b:beams><b:beam v1="0" v2="7"/></b:beams></b:beamlattice></mesh>"#;
    let both = solid.replace("</mesh>", beam);
    let model = format!(
        r#"{HEAD}><resources><object id="7" name="Both">{both}</object></resources><build>{ITEM}</build></model>"#
    );
    let (report, triangles) = packed(&bench, &[package(&bench, &model)]).expect("a solid and a beam in one mesh");
    assert_eq!((report.header.bodies.len(), triangles.len(), report.notes.len()), (2, 12, 0));
    bench.options.lattice_only = true;
    let (report, triangles) = packed(&bench, &[package(&bench, &model)]).expect("the beam");
    assert_eq!((report.header.bodies.len(), triangles.len()), (1, 0));
    assert!(
        report.notes.iter().any(|note| note.contains("object 7 (Both): it holds a solid mesh")),
        "{:?}",
        report.notes
    );
}
