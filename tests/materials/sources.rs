//! Materials as edge text and 3MF name them: what is packed, and what is refused.

use layerd::buildfile::{BlendBegin, Joint, JointChoice, Materials, PackReport, Shares, Split, Strut};

use crate::pack_bench::{Bench, HEAD, said};

const W: u16 = Shares::WHOLE;

fn materials(report: &PackReport) -> &Materials {
    report.header.materials.as_ref().expect("it has materials")
}

/// Name, and share at both ends, of all struts in the order of the bodies.
fn shares(report: &PackReport, struts: &[Strut]) -> Vec<(String, [u16; 2])> {
    let mut struts = struts.iter();
    let mut all = Vec::new();
    for (lattice, material) in report.header.lattices().zip(&materials(report).of_bodies) {
        for strut in struts.by_ref().take(lattice.total() as usize) {
            all.push((materials(report).names[usize::from(*material)].clone(), [strut.shares.a, strut.shares.b]));
        }
    }
    all
}

#[test]
fn edge_text_names_a_material_or_one_at_each_end() {
    let mut bench = Bench::new();
    let text = "4 0.5 0 0\n0 0 0 0 0 5 0.5 steel\n0 0 9 0 0 5 0.5 copper steel\n3 0 0 3 0 5 0.4 copper\n6 0 0 6 0 5\n";
    let (report, struts) = bench.text(text).expect("is packed");
    assert_eq!(materials(&report).names, ["copper", "default", "steel"]);
    assert_eq!(materials(&report).of_bodies, [0, 1, 2]);
    let expected = [
        ("copper", [W, W]),
        // The beam was given from above; its lower end is steel.
        ("copper", [0, W]),
        ("default", [W, W]),
        ("steel", [W, W]),
        ("steel", [W, 0]),
    ];
    assert_eq!(shares(&report, &struts), expected.map(|(name, shares)| (name.to_owned(), shares)));
    assert!(report.notes.iter().any(|note| note.contains("copper, default, steel")), "{:?}", report.notes);
    assert!(report.header.joined().is_some());

    // In the order in which they are renamed; what becomes one material is one body.
    let rename = |pairs: &[(&str, &str)]| pairs.iter().map(|(from, to)| ((*from).into(), (*to).into())).collect();
    bench.options.materials = rename(&[("steel", "a"), ("default", "b"), ("copper", "b")]);
    let (report, struts) = bench.text(text).expect("is packed");
    assert_eq!(materials(&report).names, ["a", "b"]);
    let found = shares(&report, &struts);
    let expected =
        [("a", [W, W]), ("a", [W, 0]), ("b", [W, W]), ("b", [W, W]), ("b", [0, W])].map(|(n, s)| (n.to_owned(), s));
    assert_eq!(found, expected, "file order within a body");

    // One material: no mixture is left, and nothing is joined.
    bench.options.materials = rename(&[("steel", "a"), ("default", "a"), ("copper", "a")]);
    let (report, struts) = bench.text(text).expect("is packed");
    assert_eq!((materials(&report).names.as_slice(), report.header.joined()), (&["a".to_owned()][..], None));
    assert!(struts.iter().all(|strut| strut.shares == Shares::default()));
}

#[test]
fn a_part_without_materials_has_none() {
    let mut bench = Bench::new();
    let text = "1 0.5 0 0\n0 0 0 0 0 5 0.5\n";
    let (report, _) = bench.text(text).expect("is packed");
    let plain = std::fs::read(bench.path("out.layerd")).expect("is there");
    assert_eq!((report.header.materials, report.notes), (None, vec![]));
    bench.options.split = Split::Max;
    bench.text(text).expect("is packed");
    assert_eq!(
        std::fs::read(bench.path("out.layerd")).expect("is there"),
        plain,
        "nothing is stored for what is not there"
    );
    bench.options.materials = vec![("default".into(), "rigid".into())];
    let (report, _) = bench.text(text).expect("is packed");
    assert_eq!(materials(&report).names, ["rigid"]);
}

#[test]
fn materials_that_cannot_be_are_refused_in_words() {
    let mut bench = Bench::new();
    for (text, expected) in [
        ("1 0.1 0 0\n0 0 0 1 1 1 1 1\n", "`1` after the radius, which is no name of a material"),
        ("1 0.1 0 0\n0 0 0 1 1 1 1 a b c\n", "in.txt:2: more than 9 fields"),
        ("1 0.1 0 0\n0 0 0 1 1 1 steel\n", "`steel` is not a number"),
    ] {
        let found = said(bench.text(text));
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
    }
    let nine: String = (0..9).map(|number| format!("{number} 0 0 {number} 0 5 0.4 m{number}\n")).collect();
    let found = said(bench.text(&format!("9 0.4 0 0\n{nine}")));
    assert!(found.contains("one too many: a part may have 8") && found.contains("--materials"), "{found}");
    let long = "x".repeat(65);
    let found = said(bench.text(&format!("1 0.4 0 0\n0 0 0 0 0 5 0.4 {long}\n")));
    assert!(found.contains("1 to 64 bytes"), "{found}");
    for (from, to, expected) in [
        ("steal", "a", "the sources name no material `steal`, but 1 other: steel"),
        ("steel", "\u{7}", "no control characters"),
    ] {
        bench.options.materials = vec![(from.into(), to.into())];
        let found = said(bench.text("1 0.4 0 0\n0 0 0 0 0 5 0.4 steel\n"));
        assert!(found.contains("--materials") && found.contains(expected), "{found}");
    }
    bench.options.materials = vec![("steel".into(), "a".into()), ("steel".into(), "b".into())];
    assert!(said(bench.text("1 0.4 0 0\n0 0 0 0 0 5 0.4 steel\n")).contains("`steel` is named twice"));
    bench.options.materials = vec![("steel".into(), "a".into())];
    assert!(said(bench.text("1 0.4 0 0\n0 0 0 0 0 5 0.4\n")).contains("the sources name no material"));
}

#[test]
fn angles_become_where_a_blend_begins() {
    let mut bench = Bench::new();
    let least = |theta1, theta2| match JointChoice::elliptic(None, theta1, theta2).map_err(|error| error.to_string()) {
        Ok(JointChoice::Elliptic { begins: BlendBegin::Least(least), .. }) => Ok(least),
        Ok(_) => panic!("it is elliptic"),
        Err(error) => Err(error),
    };
    let tangent = 20.0_f64.to_radians().tan();
    let [c, s] = least(20.0, None).expect("in range");
    assert!((c - tangent).abs() < 1e-12 && (s - tangent).abs() < 1e-12, "symmetric by default");
    let [c, s] = least(20.0, Some(80.0)).expect("in range");
    assert!((c - 10.0_f64.to_radians().tan()).abs() < 1e-12 && (s - tangent).abs() < 1e-12);
    for (theta1, theta2, told) in [
        (0.0, None, "--theta1 0: allowed is 0.1 to 44.9"),
        (45.0, None, "--theta1 45"),
        (20.0, Some(40.0), "--theta2 40: allowed is 45.1 to 89.9"),
    ] {
        let found = least(theta1, theta2).expect_err("out of range");
        assert!(found.contains(told), "{found}");
    }
    assert!(least(f64::NAN, None).is_err());

    let three = "3 0.5 0 0\n0 0 0 0 0 5 0.5 a\n3 0 0 3 0 5 0.5 b\n6 0 0 6 0 5 0.5 c\n";
    bench.options.joint = Some(JointChoice::elliptic(None, 20.0, Some(80.0)).expect("in range"));
    let found = said(bench.text(three));
    assert!(found.contains("--theta2") && found.contains("3 materials"), "{found}");
    bench.options.joint = Some(JointChoice::elliptic(None, 20.0, None).expect("in range"));
    let (report, _) = bench.text(three).expect("is packed");
    let joint = report.header.lattices().next().expect("it has one").joint;
    assert!(
        matches!(joint, Joint::Elliptic { support_um, least: [one, other] } if support_um == 750.0 && one == other)
    );
}

const RESOURCES: &str = r##"<basematerials id="1"><base name="steel" displaycolor="#808080"/><base name=" copper "/></basematerials>
 <m:compositematerials id="2" matid="1" matindices="0 1"><m:composite values="3 1"/><m:composite values="0 0"/><m:composite values="0.5"/>
 </m:compositematerials>
 <m:colorgroup id="3"><m:color color="#FF0000"/></m:colorgroup>
 <m:multiproperties id="4" pids="1 3"><m:multi pindices="1 0"/><m:multi pindices=""/></m:multiproperties>
 <m:multiproperties id="5" pids="3"><m:multi pindices="0"/></m:multiproperties>"##;

/// A 3MF of one object of these attributes, whose lattice has these attributes and beams.
fn model(object: &str, lattice: &str, beams: &str) -> String {
    format!(
        r#"{HEAD} xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" requiredextensions="b m"><resources>{RESOURCES}
        <object id="7" {object}><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="0" y="0" z="10"/><vertex x="8" y="0" z="10"/></vertices>
        <b:beamlattice radius="1" minlength="0.001" {lattice}><b:beams>{beams}</b:beams></b:beamlattice></mesh></object>
        </resources><build><item objectid="7"/></build></model>"#
    )
}

#[test]
fn beams_lattices_and_objects_name_properties() {
    let bench = Bench::new();
    let beam = r#"<b:beam v1="0" v2="1" PROPERTIES/>"#;
    let steel = vec![("steel", [W, W])];
    let copper = vec![("copper", [W, W])];
    let three_quarters = [49_151, 16_384];
    let mixed = |first: u16, second: u16| vec![("copper", [W - first, W - second]), ("steel", [first, second])];
    for (object, lattice, properties, expected) in [
        (r#"pid="1" pindex="1""#, "", "", copper.clone()),
        (r#"pid="1" pindex="1""#, r#"pid="1" pindex="0""#, "", steel.clone()),
        (r#"pid="1" pindex="1""#, r#"pid="1" pindex="1""#, r#"pid="1" p1="0""#, steel.clone()),
        ("", r#"pid="1" pindex="1""#, r#"p1="0""#, steel.clone()),
        ("", "", r#"pid="1" p1="0" p2="0""#, steel.clone()),
        ("", "", r#"pid="4" p1="0""#, copper.clone()),
        ("", "", r#"pid="4" p1="1""#, steel.clone()),
        ("", "", r#"pid="2" p1="0""#, mixed(three_quarters[0], three_quarters[0])),
        // Weights of nothing are equal shares; a short list ends with zeros.
        ("", "", r#"pid="2" p1="1" p2="2""#, mixed(32_768, W)),
    ] {
        let text = model(object, lattice, &beam.replace("PROPERTIES", properties));
        let (report, struts) = bench.model(&text).unwrap_or_else(|error| panic!("{error}: {properties}"));
        let expected: Vec<_> = expected.into_iter().map(|(name, shares)| (name.to_owned(), shares)).collect();
        assert_eq!(shares(&report, &struts), expected, "{object} {lattice} {properties}");
    }
    for colours in [r#"pid="3" p1="0""#, r#"pid="5" p1="0""#, ""] {
        let (report, _) = bench.model(&model("", "", &beam.replace("PROPERTIES", colours))).expect("is packed");
        assert_eq!(report.header.materials, None, "colours are no materials");
    }
}

#[test]
fn balls_have_one_material() {
    let bench = Bench::new();
    let beams = r#"<b:beam v1="0" v2="1" pid="1" p1="0"/>"#;
    let text = model("", r#"b2:ballmode="mixed" b2:ballradius="2" pid="1" pindex="1""#, beams);
    let text = text.replace(
        "</b:beams>",
        r#"</b:beams><b2:balls><b2:ball vindex="0" r="2"/><b2:ball vindex="1" r="3" pid="2" p="0"/></b2:balls>"#,
    );
    let (report, struts) = bench.model(&text).expect("is packed");
    let balls: Vec<_> = struts
        .iter()
        .zip(shares(&report, &struts))
        .filter(|(strut, _)| strut.is_ball())
        .map(|(_, named)| named)
        .collect();
    let expected = [("copper", [W, W]), ("copper", [16_384; 2]), ("steel", [49_151; 2])];
    assert_eq!(balls, expected.map(|(name, shares)| (name.to_owned(), shares)));
}

#[test]
fn what_3mf_forbids_is_refused_in_words() {
    let bench = Bench::new();
    let beam = |properties: &str| model("", "", &format!(r#"<b:beam v1="0" v2="1" {properties}/>"#));
    for (properties, told) in [
        (r#"pid="1" p1="0" p2="1""#, "a gradient from base material `steel` to `copper`, which 3MF forbids"),
        (r#"pid="4" p1="0" p2="1""#, "a gradient from base material"),
        (r#"pid="9" p1="0""#, "property group 9 is not there"),
        (r#"pid="1" p1="2""#, "property 2 of group 1, which has 2"),
        (r#"pid="2" p1="3""#, "property 3 of group 2, which has 3"),
        (r#"pid="x" p1="3""#, "pid = `x`"),
        (r#"pid="1" p1="-1""#, "p1 = `-1`"),
    ] {
        let found = said(bench.model(&beam(properties)));
        assert!(found.contains(told) && found.contains("beam 1"), "{found}");
    }
    let good = beam(r#"pid="2" p1="0""#);
    for (from, to, told) in [
        (r#"values="3 1""#, r#"values="3 -1""#, "0 or more"),
        (r#"values="3 1""#, r#"values="3 nan""#, "0 or more"),
        (r#"values="3 1""#, r#"values="a""#, "no list of numbers"),
        (r#"matindices="0 1""#, r#"matindices="0 7""#, "property 7 of group 1"),
        (r#"matid="1""#, r#"matid="3""#, "no base materials"),
        (r##"<base name="steel" displaycolor="#808080"/>"##, "<base/>", "`base` without name"),
        (r#"id="3""#, r#"id="1""#, "two groups of properties have the id 1"),
    ] {
        assert!(good.contains(from), "{from}");
        let found = said(bench.model(&good.replacen(from, to, 1)));
        assert!(found.contains(told), "{found}");
    }
}
