//! Packing: what sources mean, and how bad ones are refused.

mod pack_bench;
mod skip;

use std::path::{Path, PathBuf};
use std::process::Command;

use layerd::buildfile::{Cap, Joint, JointChoice, PackOptions, PackReport, pack};
use pack_bench::{BEAM, Bench, HEAD, ITEM, model, packed_lattice, said};
use skip::skipped;

#[test]
fn bad_edge_text_is_refused_with_file_line_and_text() {
    let bench = Bench::new();
    let cases = [
        ("2 0.1 0 0\n0 0 0 1 1 1\n0 0 0 nan 1 1\n", "in.txt:3: `nan` is not a finite number"),
        ("1 0.1 0 0\n0 0 0 inf 1 1\n", "in.txt:2: `inf`"),
        ("1 0.1 0 0\n0 0 0 1 one 1\n", "`one` is not a number"),
        ("1 0.1 0 0\n0 0 0 1 1\n", "in.txt:2: 5 fields"),
        ("1 0.1 0 0\n1 2 3 1 2 3\n", "nothing to print (1 strut shorter"),
        ("1 0.1 0 0\n1 2 3 1 2 4 0\n", "radius 0"),
        ("1 -2 0 0\n1 2 3 1 2 4\n", "radius -2"),
        ("3 0.1 0 0\n1 2 3 1 2 4\n", "announces 3 struts, but 1 follow"),
        ("0 0.1 0 0\n1 2 3 1 2 4\n", "in.txt:2: the first line announces 0 struts"),
        ("0 0.1 0 0\n", "nothing to print"),
        ("x 0.1 0 0\n", "in.txt:1"),
        ("", "empty"),
        ("1 0.1 0 0\n0 0 0 9e9 1 1\n", "9000000000"),
        ("1 0.0001 0 0\n0 0 0 9 1 1\n", "a radius of 0.0001 mm"),
    ];
    for (text, expected) in cases {
        let found = said(bench.text(text));
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
        assert!(!bench.path("out.layerd").exists(), "nothing is left behind by `{text}`");
    }
    assert!(said(bench.text(&format!("1 0.1 0 0\n{}", "0 ".repeat(5000)))).contains("longer than 1024 bytes"));
    assert!(said(bench.pack(&bench.file("in.step", b"step"))).contains(".3mf"));
    assert!(said(bench.pack(&bench.path("none.txt"))).contains("none.txt"));
}

#[test]
fn radius_and_support_follow_the_rule() {
    let mut bench = Bench::new();
    let text = "3 0.1 0.15 0\n0 0 0 0 0 5\n0 0 0 5 0 5 0.4\n0 0 5 0 0 0\n";
    bench.options.joint = Some(JointChoice::Convolution { support_mm: None });
    let (report, struts) = bench.text(text).expect("is fine");
    assert_eq!(packed_lattice(&report).joint, Joint::Convolution { support_um: 600.0 });
    assert_eq!(struts.len(), 2, "the reversed duplicate is merged");
    let notes = report.notes.join("\n");
    assert!(notes.contains("1 exact duplicate:") && notes.contains("0.15 mm"), "{notes}");
    bench.options.joint = Some(JointChoice::Convolution { support_mm: Some(0.42) });
    let found = said(bench.text(text));
    assert!(found.contains("in.txt:3") && found.contains("0.42") && found.contains("--support"), "{found}");
}

/// Legal, and rarely meant: one thick post sets the support of a fine lattice.
#[test]
fn a_support_that_is_wide_for_the_radii_is_told() {
    let mut bench = Bench::new();
    let thin: String = (0..9).map(|x| format!("{x} 0 0 {x} 1 1 0.1\n")).collect();
    bench.options.joint = Some(JointChoice::Convolution { support_mm: None });
    let (report, _) = bench.text(&format!("9 0.1 0 0\n{thin}")).expect("is fine");
    assert!(!report.notes.join("").contains("swell"), "{:?}", report.notes);
    let (report, _) = bench.text(&format!("10 0.1 0 0\n{thin}20 0 0 20 0 9 1\n")).expect("is fine");
    let notes = report.notes.join("\n");
    assert!(notes.contains("R = 1.5 mm is 8 times the mean radius") && notes.contains("--support"), "{notes}");
}

#[test]
fn a_quantum_bounds_the_error_along_each_axis_and_how_far_coordinates_reach() {
    let mut bench = Bench::new();
    let text = "2 0.1 0 0\n0.1234567 1.7654321 -0.5 3.3333333 2.0000049 7.7777777 0.2222222\n0.1 1 0 2 2 8 0.2\n";
    for quantum_um in [0.001, 0.1, 7.0, 250.0] {
        bench.options.quantum_um = quantum_um;
        let (report, struts) = bench.text(text).expect("is fine");
        assert_eq!(report.header.quantum_um, quantum_um);
        let strut = struts[0];
        let found = strut.a.into_iter().chain(strut.b).map(f64::from).chain([f64::from(strut.radius_a)]);
        let stated = [0.123_456_7, 1.765_432_1, -0.5, 3.333_333_3, 2.000_004_9, 7.777_777_7, 0.222_222_2];
        for (found, stated) in found.zip(stated) {
            let error_um = (found * quantum_um - stated * 1000.0).abs();
            assert!(error_um <= quantum_um / 2.0 * (1.0 + 1e-9), "{error_um} µm at a quantum of {quantum_um} µm");
        }
        let output = Command::new(env!("CARGO_BIN_EXE_layerctl")).arg("info").arg(bench.path("out.layerd")).output();
        let told = String::from_utf8(output.expect("layerctl runs").stdout).expect("is text");
        let expected =
            format!("{quantum_um} µm: coordinates differ from the source by at most {} µm", quantum_um / 2.0);
        assert!(told.contains(&expected), "{told}");
    }
    bench.options.quantum_um = 250.0;
    let (report, _) = bench.text("1 0.4 0 0\n0 0 0 0 0 5\n").expect("is fine");
    assert!(report.notes.join("").contains("2 quanta of 0.25 mm: rounding has changed it by up to 33 %"), "{report:?}");
    bench.options.quantum_um = 0.001;
    let found = said(bench.text("1 0.1 0 0\n0 0 0 2000 1 1\n"));
    assert!(found.contains("in.txt:2") && found.contains("0.001 µm") && found.contains("--quantum"), "{found}");
    bench.options.quantum_um = 250.0;
    let found = said(bench.text("1 0.1 0 0\n0 0 0 2000 1 1\n"));
    assert!(found.contains("a radius of 0.1 mm") && found.contains("--quantum"), "{found}");
    bench.options.quantum_um = 0.0;
    assert!(said(bench.text(text)).contains("--quantum 0: allowed is 0.001 to 1000 µm"));
}

#[test]
fn rotation_scale_and_units_apply_to_lengths_and_radii() {
    let mut bench = Bench::new();
    bench.options.rotate_deg = [90.0, 0.0, 90.0];
    bench.options.scale = [2.0; 3];
    let (_, struts) = bench.text("1 0.1 0 0\n0 1 0 0 2 0\n").expect("is fine");
    // About x, y goes to z; about z, z stays.
    assert_eq!((struts[0].a, struts[0].b, struts[0].radius_a), ([0, 0, 2000], [0, 0, 4000], 200));
    let bench = Bench::new();
    let units = [
        ("micron", 10),
        ("millimeter", 10_000),
        ("centimeter", 100_000),
        ("inch", 254_000),
        ("foot", 3_048_000),
        ("meter", 10_000_000),
    ];
    for (unit, height) in units {
        let (_, struts) = bench.model(&model(&format!("unit='{unit}'"), "", BEAM, "", ITEM)).expect("is fine");
        assert_eq!((struts[0].b[2], struts[0].radius_b), (height, height as u32 / 10), "{unit}");
    }
    assert!(said(bench.model(&model("unit='mile'", "", BEAM, "", ITEM))).contains("`mile`"));
}

/// The note that says how far round struts are off.
fn off_um(report: &PackReport) -> Option<f64> {
    let note = report.notes.iter().find(|note| note.contains("stretched differently"))?;
    Some(note.split("up to ").nth(1)?.split(' ').next()?.parse().expect("a number"))
}

/// Shrinkage differs between the plate's plane and the height.
#[test]
fn factors_for_each_axis_move_nodes_exactly_and_give_radii_their_mean() {
    let mut bench = Bench::new();
    let text = "1 0.5 0 0\n10 20 30 -40 50 60\n";
    bench.options.scale = [1.002, 1.002, 1.03];
    let (report, struts) = bench.text(text).expect("is fine");
    assert_eq!((struts[0].a, struts[0].b), ([10_020, 20_040, 30_900], [-40_080, 50_100, 61_800]));
    assert_eq!((struts[0].radius_a, off_um(&report)), (508, Some(7.0)), "500 · 1.016, and 500 · 0.014");
    bench.options.scale = [1.004; 3];
    let (report, struts) = bench.text(text).expect("is fine");
    assert_eq!((struts[0].radius_a, off_um(&report)), (502, None));
    // Along the printer's axes: the part's y lies along z by then.
    bench.options.scale = [1.0, 1.0, 1.02];
    bench.options.rotate_deg = [90.0, 0.0, 0.0];
    let (_, struts) = bench.text("1 0.5 0 0\n0 0 0 0 10 1\n").expect("is fine");
    assert_eq!((struts[0].a, struts[0].b), ([0, 0, 0], [0, -1000, 10_200]));
    bench.options.rotate_deg = [0.0; 3];
    // 25 µm are just allowed: 2 mm by 2.5 % of range.
    bench.options.scale = [1.0, 1.0, 1.025];
    let (report, _) = bench.text("1 2 0 0\n0 0 0 0 10 1\n").expect("is fine");
    assert_eq!(off_um(&report), Some(25.0));
    bench.options.scale = [1.0, 1.0, 1.026];
    let found = said(bench.text("1 2 0 0\n0 0 0 0 10 1\n"));
    let told =
        ["in.txt:2", "by 1.0000 to 1.0260", "off by up to 26 µm", "the limit is 25 µm", "differ by at most 0.025"];
    assert!(told.iter().all(|told| found.contains(told)), "{found}");
    bench.options.scale = [1.0, 0.0, 1.0];
    assert!(said(bench.text(text)).contains("--scale 1,0,1: allowed is"));
}

#[test]
fn transforms_that_stretch_count_together_with_the_factors() {
    let mut bench = Bench::new();
    let item = |x: f64, z: f64| format!(r#"<item objectid="7" transform="{x} 0 0 0 1 0 0 0 {z} 0 0 0"/>"#);
    let lattice = r#"<b:beams><b:beam v1="0" v2="2" r1="1" r2="0.5"/></b:beams>"#;
    let (report, struts) = bench.model(&model("", "", lattice, "", &item(1.0, 1.02))).expect("is fine");
    assert_eq!((struts[0].b, struts[0].radius_a, struts[0].radius_b), ([8000, 0, 10_200], 1010, 505));
    assert_eq!(off_um(&report), Some(10.0));
    let found = said(bench.model(&model("", "", lattice, "", &item(1.0, 2.0))));
    assert!(found.contains("object 7 (Tower): beam 1") && found.contains("the limit is 25 µm"), "{found}");
    // What the factors undo is round again.
    bench.options.scale = [1.0, 1.0, 0.5];
    let (report, struts) = bench.model(&model("", "", lattice, "", &item(1.0, 2.0))).expect("is fine");
    assert_eq!((struts[0].b, struts[0].radius_a, off_um(&report)), ([8000, 0, 10_000], 1000, None));
    assert!(said(bench.model(&model("", "", lattice, "", &item(1.0, 0.0)))).contains("flattens"));
    // Quarter turned, mirrored, and a hair off: as before, not a word.
    bench.options.scale = [1.0; 3];
    let turned = r#"<item objectid="7" transform="0 -2 0 2.000001 0 0 0 0 2 0 0 0"/>"#;
    let (report, struts) = bench.model(&model("", "", lattice, "", turned)).expect("is fine");
    assert_eq!((struts[0].radius_a, off_um(&report)), (2000, None));
}

#[test]
fn a_3mf_is_united_exactly_and_edge_text_is_a_convolution_unless_it_is_said_otherwise() {
    let mut bench = Bench::new();
    bench.options.joint = None;
    let tower = model("", "cap='butt'", BEAM, "", ITEM);
    let (report, struts) = bench.model(&tower).expect("is fine");
    assert_eq!((packed_lattice(&report).joint, report.notes.len()), (Joint::Union, 0), "{:?}", report.notes);
    assert_eq!((struts[0].caps.a, struts[0].caps.b), (Cap::Butt, Cap::Butt));
    let (report, _) = bench.text("1 0.5 0 0\n0 0 0 0 0 5\n").expect("is fine");
    assert_eq!(packed_lattice(&report).joint, Joint::Convolution { support_um: 750.0 });
    let both = [bench.path("in.3mf"), bench.path("in.txt")];
    let packed = |options: &PackOptions| pack(&both, &bench.path("out.layerd"), options, &mut |_| {});
    let found = packed(&bench.options).expect_err("two meanings").to_string();
    assert!(found.contains("--joint union or --joint convolution"), "{found}");
    let options = PackOptions { joint: Some(JointChoice::Convolution { support_mm: None }), ..bench.options.clone() };
    let report = packed(&options).expect("is said");
    assert_eq!(packed_lattice(&report).joint, Joint::Convolution { support_um: 1500.0 });
    assert!(report.notes.iter().any(|note| note.contains("the caps of 1 beam do not apply")), "{:?}", report.notes);
    // Caps do not make a second strut of the same one.
    bench.options = options;
    let twice =
        model("", "", r#"<b:beams><b:beam v1="0" v2="1" cap1="butt"/><b:beam v1="0" v2="1"/></b:beams>"#, "", ITEM);
    let (report, struts) = bench.model(&twice).expect("is fine");
    assert_eq!(struts.len(), 1);
    assert!(report.notes.join("").contains("1 exact duplicate:"), "{:?}", report.notes);
}

#[test]
fn items_and_components_place_beams_with_their_transforms() {
    let bench = Bench::new();
    let build = r#"<item objectid="7" transform="2 0 0 0 2 0 0 0 2 0 0 -3"/><item objectid="8" transform="1 0 0 0 1 0 0 0 1 0 0 50"/>"#;
    let lattice = r#"<b:beams><b:beam v1="1" v2="2" r1="1" r2="0.5"/></b:beams>"#;
    let (_, struts) = bench.model(&model("", "", lattice, "", build)).expect("is fine");
    assert_eq!((struts[0].a, struts[0].b), ([0, 0, 17_000], [16_000, 0, 17_000]));
    assert_eq!((struts[0].radius_a, struts[0].radius_b), (2000, 1000), "scaled by 2");
    assert_eq!((struts[1].a, struts[1].b), ([100_000, 0, 60_000], [100_000, 8000, 60_000]), "x becomes y, then moves");
    let oval = r#"<item objectid="7" transform="2 0 0 0 1 0 0 0 1 0 0 0"/>"#;
    assert!(said(bench.model(&model("", "", BEAM, "", oval))).contains("object 7 (Tower)"));
    let cycle = r#"</build></model>"#;
    let cyclic = format!(
        r#"{HEAD}><resources><object id="1"><components><component objectid="2"/></components></object>
        <object id="2"><components><component objectid="1"/></components></object></resources><build><item objectid="1"/>{cycle}"#
    );
    assert!(said(bench.model(&cyclic)).contains("contains itself"));
    assert!(
        said(bench.model(&model("", "", BEAM, "", r#"<item objectid="9"/>"#)))
            .contains("object 9, which does not exist")
    );
    assert!(
        said(bench.model(&model("", "", BEAM, "", r#"<item objectid="7" p:path="/o.model"/>"#))).contains("o.model")
    );
}

#[test]
fn caps_and_balls_follow_their_defaults() {
    let bench = Bench::new();
    let lattice =
        r#"<b:beams><b:beam v1="1" v2="0" cap1="butt"/></b:beams><b2:balls><b2:ball vindex="0" r="3"/></b2:balls>"#;
    let attributes = r#"cap="hemisphere" b2:ballmode="all" b2:ballradius="2""#;
    let (report, struts) =
        bench.model(&model("requiredextensions='b b2'", attributes, lattice, "", ITEM)).expect("is fine");
    assert_eq!(
        (packed_lattice(&report).strut_count, packed_lattice(&report).ball_count),
        (1, 2),
        "the unused vertex bears none"
    );
    let beam = struts.iter().find(|strut| !strut.is_ball()).expect("the beam");
    assert_eq!((beam.caps.a, beam.caps.b), (Cap::Hemisphere, Cap::Butt), "turned round, caps and all");
    let radii: Vec<_> = struts.iter().filter(|strut| strut.is_ball()).map(|ball| (ball.a[2], ball.radius_a)).collect();
    assert_eq!(radii, [(0, 3000), (10_000, 2000)]);
    let mixed = attributes.replace("\"all\"", "\"mixed\"");
    let (report, _) = bench.model(&model("", &mixed, lattice, "", ITEM)).expect("is fine");
    assert_eq!(packed_lattice(&report).ball_count, 1);
    let none = attributes.replace("\"all\"", "\"none\"");
    let (report, _) = bench.model(&model("", &none, lattice, "", ITEM)).expect("is fine");
    assert_eq!(packed_lattice(&report).ball_count, 0);
}

#[test]
fn what_is_no_lattice_is_refused_by_name_or_left_out_by_name() {
    let mut bench = Bench::new();
    let clipped = model("", r#"clipping="inside" clippingmesh="4""#, BEAM, "", ITEM);
    let what = "clipped (inside)";
    let found = said(bench.model(&clipped));
    assert!(found.contains("object 7 (Tower)") && found.contains(what) && found.contains("does not exist"), "{found}");
    bench.options.lattice_only = true;
    let (report, struts) = bench.model(&clipped).expect("the lattice stays");
    assert_eq!(struts.len(), 1);
    let told = report.notes.join("\n");
    assert!(told.contains("object 7 (Tower)") && told.contains(what), "{told}");
    let short = r#"<b:beams><b:beam v1="0" v2="1"/><b:beam v1="1" v2="2"/></b:beams>"#;
    let (report, struts) = bench.model(&model("", "", short, "", ITEM).replace("0.001", "9")).expect("is fine");
    assert_eq!(struts.len(), 1);
    assert!(report.notes.iter().any(|note| note.contains("left out 1 beam shorter")), "{:?}", report.notes);
}

#[test]
fn hostile_3mf_is_refused_in_words() {
    let bench = Bench::new();
    let deep = format!("{HEAD}>{}", "<a>".repeat(100));
    let bomb = format!("{HEAD}>{}", format!("<a/>{}", " ".repeat(1 << 19)).repeat(140));
    let long = format!("{HEAD}><a b='{}'/></model>", "x".repeat(2 << 20));
    let many = format!("{HEAD}><a {}/></model>", (0..200).map(|n| format!("a{n}='' ")).collect::<String>());
    let cases = [
        (deep, "nested more than 64"),
        (bomb, "zip bomb"),
        (long, "longer than"),
        (many, "more than 128 attributes"),
        (format!("{HEAD}><resources>"), "truncated"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><a/>".into(), "document type"),
        (model("", "", r#"<b:beams><b:beam v1="0" v2="9"/></b:beams>"#, "", ITEM), "beam 1: vertex 9; there are 3"),
        (model("", "", r#"<b:beams><b:beam v1="0" v2="0"/></b:beams>"#, "", ITEM), "1 beam of no length"),
        (model("", "", r#"<b:beams><b:beam v1="0" v2="1" r1="NaN"/></b:beams>"#, "", ITEM), "r1 = NaN"),
        (model("", "", r#"<b:beams><b:beam v1="0" v2="1" r1="-1"/></b:beams>"#, "", ITEM), "radii -1"),
        (model("", "", "", "", ITEM), "nothing to print"),
        (model("", "", BEAM, "", ""), "no build items"),
    ];
    for (model, expected) in cases {
        let found = said(bench.model(&model));
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
        assert!(!bench.path("out.layerd").exists());
    }
    assert!(said(bench.pack(&bench.file("bad.3mf", b"PK no zip at all"))).contains("not a 3MF file"));
}

#[test]
fn real_files_stay_below_ten_bytes_a_strut() {
    let data = std::env::var_os("LAYERD_DATA")
        .map_or(Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    if !data.is_dir() {
        skipped(&format!("{} is absent (set LAYERD_DATA)", data.display()));
        return;
    }
    let bench = Bench::new();
    for (name, struts) in [("pyramid.3mf", 391), ("spot_lattice.txt", 145_371)] {
        let (report, _) = bench.pack(&data.join(name)).expect("is fine");
        assert_eq!(packed_lattice(&report).strut_count, struts);
        let bytes = std::fs::metadata(bench.path("out.layerd")).expect("there").len();
        assert!(bytes < 10 * struts, "{name}: {bytes} bytes for {struts} struts");
    }
}
