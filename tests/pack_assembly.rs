//! 3MF packages of several parts, and components that place objects in objects.

mod pack_bench;

use std::fmt::Write;

use pack_bench::{Bench, ITEM, MODEL, RELATIONSHIPS, objects, packed_lattice, posts, said};

#[test]
fn part_names_are_compared_as_packages_do() {
    let bench = Bench::new();
    let text = posts("", &[0], ITEM);
    let named = |target: &str| RELATIONSHIPS.replace("/3D/odd name.model", target);
    let cases = [
        ("/3D/odd name.model", "3d/ODD NAME.MODEL"),
        ("/3D/odd%20name.model", "3D/odd name.model"),
        ("/3D/odd name.model", "3D/odd%20name.model"),
        ("3D/odd name.model", "/3D/odd name.model"),
        ("./3D/./odd name.model", "3D/odd name.model"),
        ("/3D/Other/../odd name.model", "./3D/odd name.model"),
        ("3D\\odd name.model", "3D/odd name.model"),
        ("/3D/odd name.model", "3D\\odd name.model"),
        ("/%33D/%6fdd%20name.m%6Fdel", "3D/odd name.model"),
        ("/3D/teil%C3%BC.model", "3D/teilü.model"),
    ];
    for (target, entry) in cases {
        for relationships in ["_rels/.rels", "_Rels/.RELS"] {
            let packed = bench.package(&[(relationships, &named(target)), (entry, &text)]);
            assert_eq!(packed.unwrap_or_else(|error| panic!("{target}, {entry}: {error}")).1.len(), 1);
        }
    }
    let found = said(bench.package(&[("_rels/.rels", &named("/3D/100%.model")), (MODEL, &text)]));
    assert!(found.contains("no part `3D/100%.model`"), "{found}");
    let found = said(bench.package(&[("_rels/.rels", RELATIONSHIPS), (MODEL, &text), ("3d/odd name.MODEL", &text)]));
    assert!(found.contains("several entries") && found.contains("3D/odd name.model"), "{found}");
    let external = named("http://example.org/3D/a.model\" TargetMode=\"External");
    assert!(said(bench.package(&[("_rels/.rels", &external), (MODEL, &text)])).contains("no relationship names"));
    let foreign = RELATIONSHIPS.replace("package/2006/relationships\"", "package/2006/other\"");
    assert!(said(bench.package(&[("_rels/.rels", &foreign), (MODEL, &text)])).contains("no relationship names"));
}

#[test]
fn parts_of_the_same_package_are_followed() {
    let bench = Bench::new();
    let resources = r#"<object id="1"><components><component objectid="7" p:path="/3D/Objects/a%20b.model" p:UUID="u"
        transform="1 0 0 0 1 0 0 0 1 0 100 0"/><component objectid="2"/></components></object><object id="2">MESH</object>"#;
    let build = r#"<item objectid="1" p:UUID="u"/><item objectid="7" p:path="3d/objects/INCH.model"
        transform="1 0 0 0 1 0 0 0 1 0 200 0"/>"#;
    let root = objects(resources, build).replace("<object id=\"2\">", "<object id=\"2\" p:UUID=\"v\">");
    // It has objects and a build of its own, which count for nothing here.
    let millimetres = posts("", &[0, 3], "<item objectid='7' transform='1 0 0 0 1 0 0 0 1 0 0 777'/>");
    let inches = posts("unit='inch'", &[0], "");
    let parts = [
        ("_rels/.rels", RELATIONSHIPS),
        (MODEL, root.as_str()),
        ("3D/Objects/a b.model", &millimetres),
        ("3D/Objects/inch.model", &inches),
        ("3D/Objects/unused.model", "is not read"),
    ];
    let (_, struts) = bench.package(&parts).expect("is fine");
    let mut found: Vec<_> = struts.iter().map(|strut| (strut.a, strut.b[2], strut.radius_a)).collect();
    found.sort_unstable();
    let expected = [
        ([0, 0, 0], 5000, 1000),
        ([0, 100_000, 0], 10_000, 1000),
        ([0, 200_000, 0], 254_000, 25_400),
        ([3000, 100_000, 0], 10_000, 1000),
    ];
    assert_eq!(found, expected);

    let found = said(bench.package(&parts[..3]));
    assert!(
        found.contains("`item` refers to object 7") && found.contains("no part `3d/objects/INCH.model`"),
        "{found}"
    );
    let missing = root.replace("<item objectid=\"7\"", "<item objectid=\"8\"");
    let found = said(bench.package(&[parts[0], (MODEL, &missing), parts[2], parts[3]]));
    assert!(found.contains("object 8 of 3d/objects/INCH.model, which does not exist"), "{found}");
    let wrong = millimetres.replace("r1=", "r0=").replace("v2=\"3\"", "v2=\"4\"");
    let found = said(bench.package(&[parts[0], parts[1], (parts[2].0, &wrong), parts[3]]));
    assert!(found.contains("3D/Objects/a b.model: object 7 (Posts)") && found.contains("beam 2: vertex 4"), "{found}");
    let used = millimetres.replace("<b:beams>", "<x:hollow/><b:beams>");
    let required = root.replacen("><resources>", " requiredextensions='x'><resources>", 1);
    let found = said(bench.package(&[parts[0], (MODEL, &required), (parts[2].0, &used), parts[3]]));
    assert!(found.contains("uses it (`hollow`)"), "another part's use counts: {found}");
}

#[test]
fn parts_that_contain_one_another_or_too_much_are_refused() {
    let bench = Bench::new();
    let component = |part: &str, id: u32| {
        format!("<object id='{id}'><components><component objectid='1' p:path='/{part}'/></components></object>")
    };
    let root = objects(&component("3D/a.model", 1), "<item objectid='1'/>");
    let (a, b) = (objects(&component("3D/b.model", 1), ""), objects(&component("3D/a.model", 1), ""));
    let found =
        said(bench.package(&[("_rels/.rels", RELATIONSHIPS), (MODEL, &root), ("3D/a.model", &a), ("3D/b.model", &b)]));
    let cycle = "contains itself through its components: object 1 of 3D/a.model → object 1 of 3D/b.model → object 1 of 3D/a.model";
    assert!(found.contains(cycle), "{found}");
    let own = said(bench.model(&objects(&component(MODEL, 1), "<item objectid='1'/>")));
    assert!(own.contains("object 1 contains itself"), "{own}");

    // A chain of parts is as deep as its components.
    let chain = |length: usize| {
        let link = |number: usize| {
            (format!("3D/{number}.model"), objects(&component(&format!("3D/{}.model", number + 1), 1), ""))
        };
        let mut parts: Vec<_> = (1..length).map(link).collect();
        parts.push((format!("3D/{length}.model"), objects("<object id='1'>MESH</object>", "")));
        parts
    };
    let root = objects("", "<item objectid='1' p:path='/3D/1.model'/>");
    for (length, fits) in [(32, true), (33, false)] {
        let chain = chain(length);
        let own = [("_rels/.rels", RELATIONSHIPS), (MODEL, root.as_str())];
        let parts: Vec<_> =
            own.into_iter().chain(chain.iter().map(|(name, text)| (name.as_str(), text.as_str()))).collect();
        match bench.package(&parts) {
            Ok((_, struts)) => assert!(fits && struts.len() == 1),
            Err(error) => assert!(!fits && error.to_string().contains("nested more than 32 deep"), "{error}"),
        }
    }

    let names: Vec<String> = (0..1100).map(|number| format!("3D/{number}.model")).collect();
    let items: String = names.iter().map(|name| format!("<item objectid='7' p:path='/{name}'/>")).collect();
    let (root, text) = (objects("", &items), posts("", &[0], ""));
    let own = [("_rels/.rels", RELATIONSHIPS), (MODEL, root.as_str())];
    let parts: Vec<_> = own.into_iter().chain(names.iter().map(|name| (name.as_str(), text.as_str()))).collect();
    assert!(said(bench.package(&parts)).contains("more than 1024 parts"));

    // Each part could be, all together are no lattice.
    let blank = format!("{text}{}", " ".repeat(20 << 20));
    let parts: Vec<_> = parts[2..6].iter().map(|(name, _)| (*name, blank.as_str())).collect();
    let items: String = names[..4].iter().map(|name| format!("<item objectid='7' p:path='/{name}'/>")).collect();
    let root = objects("", &items);
    let parts = [&[own[0], (MODEL, root.as_str())], parts.as_slice()].concat();
    assert!(said(bench.package(&parts)).contains("zip bomb"));
}

#[test]
fn the_list_of_components_has_to_fit_memory() {
    let mut bench = Bench::new();
    bench.options.memory_bytes = 1 << 20;
    let list = |count: usize| {
        let components = "<component objectid='1'/>".repeat(count);
        let objects = objects(&format!("<object id='1'>MESH</object><object id='2'><components>{components}"), ITEM);
        objects.replace("</resources>", "</components></object></resources>").replace(ITEM, "<item objectid='2'/>")
    };
    let (report, _) = bench.model(&list(400_000)).expect("is fine");
    assert!(report.notes.join("").contains("399999 exact duplicates"), "{:?}", report.notes);
    let found = said(bench.model(&list(600_000)));
    assert!(found.contains("more than 64 MiB") && found.contains("--memory"), "{found}");
}

#[test]
fn cells_are_placed_however_often_components_multiply_them() {
    let bench = Bench::new();
    let row = |id: usize, of: usize, axis: usize| {
        let component = |number: usize| {
            let mut at = [0; 3];
            at[axis] = 10 * number;
            let [x, y, z] = at;
            format!("<component objectid='{of}' transform='1 0 0 0 1 0 0 0 1 {x} {y} {z}'/>")
        };
        let components: String = (0..65).map(component).collect();
        format!("<object id='{id}'><components>{components}</components></object>")
    };
    let nested = ["<object id='1'>MESH</object>".into(), row(2, 1, 0), row(3, 2, 1), row(4, 3, 2)].concat();
    let (report, struts) = bench.model(&objects(&nested, "<item objectid='4'/>")).expect("is fine");
    assert_eq!(packed_lattice(&report).strut_count, 65 * 65 * 65);
    assert_eq!(struts.last().map(|strut| strut.a), Some([640_000; 3]));

    // The same in one list.
    let mut components = String::new();
    for number in 0..65 * 65 * 65 {
        let (x, y, z) = (10 * (number % 65), 10 * (number / 65 % 65), 10 * (number / 65 / 65));
        write!(components, "<component objectid='1' transform='1 0 0 0 1 0 0 0 1 {x} {y} {z}'/>")
            .expect("a string grows");
    }
    let flat = format!("<object id='1'>MESH</object><object id='2'><components>{components}</components></object>");
    let (_, listed) = bench.model(&objects(&flat, "<item objectid='2'/>")).expect("is fine");
    assert!(listed == struts);
}

/// Thirty-two levels of ten: more places than any disk has room for, in a file of a few kilobytes.
#[test]
fn more_places_than_fit_the_disk_are_refused_at_once() {
    let bench = Bench::new();
    let level = |id: usize| {
        let components = format!("<component objectid='{}'/>", id - 1).repeat(10);
        format!("<object id='{id}'><components>{components}</components></object>")
    };
    let levels: String = (2..32).map(level).collect();
    let found = said(bench.model(&objects(&format!("<object id='1'>MESH</object>{levels}"), "<item objectid='31'/>")));
    assert!(found.contains("are needed") && found.contains("make room"), "{found}");
}
