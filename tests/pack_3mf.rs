//! 3MF as programs in the field write it: namespaces, extensions, what the build prints, and texts of any length.

mod pack_bench;

use pack_bench::{Bench, HEAD, ITEM, MODEL, RELATIONSHIPS, model, notes, objects, posts, said};

#[test]
fn attributes_and_elements_belong_to_their_namespaces() {
    let bench = Bench::new();
    let plain = model("", "", r#"<b:beams><b:beam v1="0" v2="1" r2="2"/></b:beams>"#, "", ITEM);
    let (_, expected) = notes(&bench, &plain);
    let vendor = plain
        .replace("<vertex x=\"0\" y=\"0\" z=\"0\"/>", "<vertex x:x=\"3\" x=\"0\" x:y=\"4\" y=\"0\" z=\"0\" x:z=\"9\"/>")
        .replace("v1=\"0\"", "x:v1=\"2\" x:v2=\"2\" x:r1=\"3\" x:r2=\"4\" x:cap1=\"butt\" b2:r1=\"5\" v1=\"0\"")
        .replace("radius=\"1\"", "x:radius=\"5\" x:ballmode=\"all\" x:clippingmode=\"inside\" b:radius=\"1\"")
        .replace(
            "objectid=\"7\"",
            "x:objectid=\"8\" x:transform=\"no\" x:path=\"/no.model\" x:printable=\"0\" objectid=\"7\"",
        )
        .replace("id=\"7\" name", "x:id=\"8\" x:type=\"other\" id=\"7\" name")
        .replace("<b:beams>", "<x:beam v1=\"1\" v2=\"2\"/><x:more><b:beam v1=\"1\" v2=\"2\"/></x:more><b:beams>")
        .replace("<build>", "<x:build><item objectid=\"8\"/></x:build><build>");
    assert_eq!(notes(&bench, &vendor).1, expected, "nothing of the vendor's is taken for the lattice's");

    // The prefix means nothing: another one, and none.
    let renamed = plain.replace("b:", "lattice:").replace("xmlns:b=", "xmlns:lattice=");
    assert_eq!(notes(&bench, &renamed).1, expected);
    let uri = "http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02";
    let unprefixed = plain
        .replace("<b:beamlattice", &format!("<beamlattice xmlns=\"{uri}\""))
        .replace("<b:", "<")
        .replace("</b:", "</");
    assert_eq!(notes(&bench, &unprefixed).1, expected);
    let swapped = plain.replace(uri, "http://example.org/another");
    assert!(said(bench.model(&swapped)).contains("nothing to print"), "a prefix alone is no lattice");

    let twice = [
        ("r2=\"2\"", "r2=\"2\" r2=\"3\""),
        ("r2=\"2\"", "r2=\"2\" b:r2=\"3\""),
        ("r2=\"2\"", "xmlns:c=\"URI\" b:r2=\"2\" c:r2=\"3\""),
        ("id=\"7\" name", "id=\"7\" id=\"9\" name"),
    ];
    for (once, twice) in twice {
        let found = said(bench.model(&plain.replacen(once, &twice.replace("URI", uri), 1)));
        assert!(found.contains("has the attribute") && found.contains("twice"), "{found}");
    }
    for (bound, unbound) in [(" r2=", " nobody:r2="), ("<b:beams>", "<nobody:beams/><b:beams>")] {
        let found = said(bench.model(&plain.replacen(bound, unbound, 1)));
        assert!(found.contains("`nobody:") && found.contains("bound to no namespace"), "{found}");
    }
}

#[test]
fn a_lattice_in_a_displacement_mesh_finds_its_vertices() {
    let mut bench = Bench::new();
    for uri in [
        "http://schemas.3mf.io/3dmanufacturing/displacement/2023/10",
        "http://schemas.microsoft.com/3dmanufacturing/displacement/2022/07",
    ] {
        let displaced = posts(&format!("xmlns:d='{uri}'"), &[0, 5], ITEM)
            .replace("<mesh>", "<d:displacementmesh>")
            .replace("</mesh>", "</d:displacementmesh>")
            .replace("<vert", "<d:vert")
            .replace("</vert", "</d:vert");
        bench.options.lattice_only = false;
        let (nothing, struts) = notes(&bench, &displaced);
        assert_eq!((struts.len(), struts[1].b, nothing.as_str()), (2, [5000, 0, 10_000], ""));
        bench.options.lattice_only = true;
        let (notes, alone) = notes(&bench, &displaced);
        assert_eq!(alone, struts);
        assert!(notes.contains("displacement mesh"), "{notes}");
    }
}

#[test]
fn required_extensions_that_change_nothing_are_noted_and_others_refused() {
    let bench = Bench::new();
    let sets = "xmlns:t='http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07'";
    let text = posts(&format!("{sets} requiredextensions='b t'"), &[0], ITEM);
    let (told, _) = notes(&bench, &text);
    assert!(
        told.contains("`t`") && told.contains("trianglesets/2021/07") && told.contains("cannot change the shape"),
        "{told}"
    );

    let secure = "xmlns:sc='http://schemas.microsoft.com/3dmanufacturing/securecontent/2019/04'";
    let text = posts(&format!("{secure} requiredextensions=' b  sc x '"), &[0], ITEM);
    let (told, _) = notes(&bench, &text);
    for name in ["`sc`", "securecontent/2019/04", "`x`", "http://example.org/unheard-of", "does not use it"] {
        assert!(told.contains(name), "{told}");
    }
    let keystore = RELATIONSHIPS.replace(
        "</Relationships>",
        r#"<Relationship Target="/Secure/keystore.xml" Id="k" Type="http://schemas.microsoft.com/3dmanufacturing/2019/04/keystore"/>
        </Relationships>"#,
    );
    let found = said(bench.package(&[("_rels/.rels", &keystore), (MODEL, &text)]));
    assert!(found.contains("keystore") && found.contains("encrypted"), "{found}");

    let required = posts("requiredextensions='x'", &[0], ITEM);
    for (from, used) in [("<b:beams>", "<x:hollow/><b:beams>"), ("radius=", "x:hollow=\"1\" radius=")] {
        let found = said(bench.model(&required.replace(from, used)));
        let says = |part: &str| found.contains(part);
        assert!(says("http://example.org/unheard-of") && says("uses it (`hollow`)") && says("shape"), "{found}");
    }
    assert!(
        !notes(&bench, &posts("", &[0], ITEM).replace("<b:beams>", "<x:hollow/><b:beams>")).0.contains("unheard-of")
    );
    let unbound = said(bench.model(&posts("requiredextensions='nobody'", &[0], ITEM)));
    assert!(unbound.contains("`nobody`") && unbound.contains("no namespace"), "{unbound}");
    let long = posts(&format!("xmlns:l='{}' requiredextensions='l'", "u".repeat(2000)), &[0], ITEM);
    assert!(said(bench.model(&long)).contains("longer than 1024 bytes"));
    let many: String = (0..100).map(|n| format!("<a xmlns='urn:{n}'/>")).collect();
    assert!(said(bench.model(&format!("{HEAD}>{many}</model>"))).contains("more than 64 namespaces"));
}

#[test]
fn only_what_the_build_prints_is_packed() {
    let bench = Bench::new();
    let none = said(bench.model(&posts("", &[0], "")));
    assert!(none.contains("no build items") && none.contains("place its objects in the build"), "{none}");

    let two = r#"<object id="1">MESH</object><object id="2" type="other" name="Gauge">MESH</object>
        <object id="3"><components><component objectid="1"/><component objectid="2"/></components></object>
        <object id="4" type="other"><components><component objectid="1"/></components></object>"#;
    let build = r#"<item objectid="2"/><item objectid="3"/><item objectid="4" transform="1 0 0 0 1 0 0 0 1 9 0 0"/>"#;
    let (told, struts) = notes(&bench, &objects(two, build));
    assert_eq!(struts.len(), 1, "object 1 by way of object 3");
    assert!(told.contains("2 objects of type `other`"), "{told}");
    assert!(told.contains("object 2 (Gauge), object 4"), "{told}");
    let solid = two.replace("name=\"Gauge\">MESH", "><mesh><triangles><triangle v1=\"0\"/></triangles></mesh>");
    assert_eq!(notes(&bench, &objects(&solid, build)).1.len(), 1, "nobody minds a mesh that is not printed");

    let build = r#"<item objectid="1"/><item objectid="1" printable="0" transform="1 0 0 0 1 0 0 0 1 9 0 0"/>
        <item objectid="1" printable="false" transform="1 0 0 0 1 0 0 0 1 19 0 0"/>
        <item objectid="1" printable="1" transform="1 0 0 0 1 0 0 0 1 29 0 0"/>"#;
    let (told, struts) = notes(&bench, &objects(two, build));
    assert_eq!(struts.iter().map(|strut| strut.a[0]).collect::<Vec<_>>(), [0, 29_000]);
    assert!(told.contains("2 build items marked printable=\"0\": object 1, object 1"), "{told}");
    let many = format!("<item objectid=\"1\"/>{}", "<item objectid=\"1\" printable=\"0\"/>".repeat(9));
    assert!(notes(&bench, &objects(two, &many)).0.ends_with(
        "9 build items marked printable=\"0\": object 1, \
        object 1, object 1, object 1, object 1, …"
    ));

    for (build, why) in
        [("<item objectid=\"2\"/>", "type `other`"), ("<item objectid=\"1\" printable=\"0\"/>", "printable=")]
    {
        let found = said(bench.model(&objects(two, build)));
        assert!(found.contains("nothing to print") && found.contains(why), "{found}");
    }
    assert!(said(bench.model(&objects(two, "<item objectid='1' printable='no'/>"))).contains("printable = `no`"));
    assert!(said(bench.model(&objects("<object id='1' type='ghost'/>", ITEM))).contains("type `ghost`"));
}

#[test]
fn beams_without_length_are_left_out_and_counted() {
    let bench = Bench::new();
    let lattice = r#"<b:beams><b:beam v1="0" v2="1"/><b:beam v1="2" v2="2"/><b:beam v1="1" v2="1"/></b:beams>"#;
    let (told, struts) = notes(&bench, &model("", "", lattice, "", ITEM));
    assert_eq!(struts.len(), 1);
    assert!(told.contains("left out 2 beams of no length"), "{told}");

    // Two vertices at one place, and two that fall on one quantum.
    let close = r#"<vertex x="8" y="0" z="10"/><vertex x="8" y="0" z="10"/><vertex x="8" y="0" z="10.0001"/>"#;
    let lattice = r#"<b:beams><b:beam v1="0" v2="1"/><b:beam v1="2" v2="3"/><b:beam v1="3" v2="4"/></b:beams>"#;
    let text = model("", "", lattice, "", ITEM)
        .replace(r#"<vertex x="8" y="0" z="10"/>"#, close)
        .replace("minlength=\"0.001\"", "minlength=\"0\"");
    let (told, struts) = notes(&bench, &text);
    assert_eq!(struts.len(), 1);
    assert!(told.contains("2 struts shorter than the file's resolution"), "{told}");

    let all = said(bench.model(&model("", "", r#"<b:beams><b:beam v1="1" v2="1"/></b:beams>"#, "", ITEM)));
    assert!(all.contains("nothing to print") && all.contains("1 beam of no length"), "{all}");
}

#[test]
fn long_texts_and_comments_are_passed_over() {
    let bench = Bench::new();
    let plain = posts("", &[0, 4], ITEM);
    let (_, expected) = notes(&bench, &plain);
    let long = "<b:beam v1='0' v2='9'/> - ] ? ".repeat(60_000);
    let between = [
        format!("<metadata name=\"Notes\">{}</metadata>", long.replace('<', "&lt;")),
        format!("<!--{}-->", long),
        format!("<!--> {long} --->"),
        format!("<![CDATA[{long}]]]>"),
        format!("<?program {long}??>"),
        "\u{feff}stray text".into(),
        "<!---->".into(),
    ];
    for text in &between {
        for at in ["<resources>", "<b:beams>", "</build>", "<object"] {
            let (told, struts) = notes(&bench, &plain.replacen(at, &format!("{text}{at}"), 1));
            assert_eq!((struts, told.as_str()), (expected.clone(), ""));
        }
    }
    // Whatever crosses the end of a buffer of 64 KiB.
    let pieces = "<!-- - -- ->x--><?a ? > ?><![CDATA[ ]] > ]>x]]><metadata name='>'> a &lt; b </metadata>";
    for shift in 0..=2 * pieces.len() {
        let text = format!("<resources><!--{}-->{pieces}", "-".repeat((64 << 10) - HEAD.len() - shift));
        assert_eq!(notes(&bench, &plain.replacen("<resources>", &text, 1)).1, expected, "{shift}");
    }
    let quoted = plain.replace("name=\"Posts\"", "name=\"<!-- a > b -->\"");
    assert_eq!(notes(&bench, &quoted).1, expected, "a value is no comment");
    for (unended, expected) in [("<!-- ", "truncated"), ("<![CDATA[ ]]", "truncated"), ("<!ELEMENT a>", "neither")] {
        let found = said(bench.model(&plain.replace("</model>", unended)));
        assert!(found.contains(expected), "{found}");
    }
    let utf16: Vec<u8> = "\u{feff}".encode_utf16().chain(plain.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let utf16 = bench.package_bytes(&[("_rels/.rels", RELATIONSHIPS.as_bytes()), (MODEL, &utf16)]);
    assert!(said(utf16).contains("UTF-16"));
}
