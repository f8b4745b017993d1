//! The displacement extension of 3MF.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;
use layerd::buildfile::{BodyHeader, BuildFile, DisplacementOptions, Tile};
use layerd::layer::Depth;

use crate::objects::cuboid;
use crate::pack_bench::{Bench, MODEL, RELATIONSHIPS, said};
use crate::{Part, map};

const SIZE: [f64; 3] = [2.0, 1.6, 1.2];

/// How a file writes the names of the extension.
struct Spelling {
    uri: &'static str,
    coordinate: &'static str,
    axes: [&'static str; 3],
    height: &'static str,
    /// Where `did` stands: on the object, the triangles or each triangle.
    did_on: &'static str,
    is_nid_on_coordinates: bool,
}

const USUAL: Spelling = Spelling {
    uri: "http://schemas.3mf.io/3dmanufacturing/displacement/2023/10",
    coordinate: "disp2dcoord",
    axes: ["x", "y", "z"],
    height: "height",
    did_on: "triangle",
    is_nid_on_coordinates: false,
};

/// A box whose upper side is displaced upwards. `map` has the attributes of the map, `item` those of the build item.
fn model(spelling: &Spelling, map: &str, group: &str, item: &str) -> String {
    let Spelling { uri, coordinate, axes: [x, y, z], height, did_on, is_nid_on_coordinates } = spelling;
    let did = |on: &str| if *did_on == on { r#" did="7""# } else { "" };
    let [of_group, of_coordinates] = if *is_nid_on_coordinates { ["", r#" nid="8""#] } else { [r#" nid="8""#, ""] };
    let (mut vertices, mut triangles, mut coordinates) = (String::new(), String::new(), String::new());
    for (number, corners) in cuboid(SIZE).triangles.iter().enumerate() {
        let is_top = corners.iter().all(|corner| corner.at.z == SIZE[2]);
        for corner in corners {
            let DVec3 { x, y, z } = corner.at;
            let [u, v] = corner.texture;
            writeln!(vertices, r#"<d:vertex x="{x}" y="{y}" z="{z}"/>"#).expect("a string");
            writeln!(coordinates, r#"<d:{coordinate} u="{u}" v="{v}" n="0"{of_coordinates}/>"#).expect("a string");
        }
        let [a, b, c] = [3 * number, 3 * number + 1, 3 * number + 2];
        let displaced =
            if is_top { format!(r#" d1="{a}" d2="{b}" d3="{c}"{}"#, did("triangle")) } else { String::new() };
        writeln!(triangles, r#"<d:triangle v1="{a}" v2="{b}" v3="{c}"{displaced}/>"#).expect("a string");
    }
    format!(
        r#"<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" xmlns:d="{uri}" requiredextensions="d" unit="millimeter">
        <resources><d:displacement2d id="3" path="/3D/map.png" {map}/>
        <d:normvectorgroup id="8"><d:normvector {x}="0" {y}="0" {z}="5"/></d:normvectorgroup>
        <d:disp2dgroup id="7" dispid="3"{of_group} {height}="0.3" {group}>{coordinates}</d:disp2dgroup>
        <object id="1"{}><d:displacementmesh><d:vertices>{vertices}</d:vertices><d:triangles{}>{triangles}</d:triangles></d:displacementmesh>
        </object></resources><build><item objectid="1" {item}/></build></model>"#,
        did("object"),
        did("triangles")
    )
}

/// Packs a model with a map, and returns the part.
fn packed(model: &str, map: &[u8]) -> Part {
    let bench = Bench::new();
    let parts = [("_rels/.rels", RELATIONSHIPS.as_bytes()), (MODEL, model.as_bytes()), ("3D/map.png", map)];
    let (report, _) = bench.package_bytes(&parts).unwrap_or_else(|error| panic!("{error}"));
    part(bench, report)
}

fn part(bench: Bench, report: layerd::buildfile::PackReport) -> Part {
    let file = BuildFile::open(&bench.path("out.layerd")).expect("what pack writes is whole");
    file.verify().expect("it agrees with itself");
    Part { _bench: bench, file: Arc::new(file), report }
}

/// Half of the map is white.
fn step() -> Vec<u8> {
    map([64, 64], |[u, _]| if u > 0.5 { 1.0 } else { 0.0 })
}

#[test]
fn all_spellings_mean_the_same() {
    let expected = packed(&model(&USUAL, "", "", ""), &step());
    let plan = expected.plan(Depth::Bit);
    let layers = expected.layers(&plan, 1, 0);
    for spelling in [
        Spelling { uri: "http://schemas.microsoft.com/3dmanufacturing/displacement/2022/07", ..USUAL },
        Spelling { uri: "http://example.org/displacement/2031/01", coordinate: "disp2dcoords", ..USUAL },
        Spelling { coordinate: "disp2coord", axes: ["nx", "ny", "nz"], ..USUAL },
        Spelling { height: "depth", did_on: "triangles", ..USUAL },
        Spelling { did_on: "object", is_nid_on_coordinates: true, ..USUAL },
    ] {
        let found = packed(&model(&spelling, r#"contenttype="image/png""#, "", ""), &step());
        assert_eq!(found.file.header().bounds, expected.file.header().bounds);
        assert!(found.layers(&plan, 1, 0) == layers);
    }
    // Published files name the vectors of the group instead of the group.
    let misnamed = model(&USUAL, "", "", "").replace(r#"did="7""#, r#"did="8""#);
    assert!(packed(&misnamed, &step()).layers(&plan, 1, 0) == layers);
}

#[test]
fn a_transform_acts_on_the_displaced_shape() {
    let value = |u: f64| 0.2 + 0.6 * u;
    let ramp = map([256, 1], |[u, _]| value(u));
    let clamped = r#"tilestyleu="clamp" tilestylev="clamp""#;
    let inside = |at: DVec3| {
        let height = 0.1 + 0.3 * value((at.x / SIZE[0]).clamp(0.5 / 256.0, 1.0 - 0.5 / 256.0));
        at.min(DVec3::from(SIZE) + DVec3::Z * height - at).min_element()
    };
    for (name, transform) in [
        ("twice as large", glam::DMat3::from_diagonal(DVec3::splat(2.0))),
        ("turned", glam::DMat3::from_rotation_x(0.7) * glam::DMat3::from_rotation_z(1.2)),
        ("stretched", glam::DMat3::from_diagonal(DVec3::new(1.5, 0.7, 2.5))),
        ("mirrored", glam::DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))),
        ("sheared", glam::DMat3::from_cols(DVec3::X, DVec3::new(0.3, 1.0, 0.0), DVec3::new(0.4, 0.0, 1.3))),
    ] {
        let columns = transform.to_cols_array().map(|part| part.to_string()).join(" ");
        let part =
            packed(&model(&USUAL, clamped, r#"offset="0.1""#, &format!(r#"transform="{columns} 0 0 0""#)), &ramp);
        let plan = part.plan(Depth::Bit);
        let back = transform.inverse();
        // Distances are those of the shape before it is transformed: about as long.
        let farthest = part.farthest_mm(&plan, |at| inside(back * at));
        assert!(farthest < 0.003, "{name}: {farthest} mm");
    }
}

#[test]
fn factors_channels_and_nearest_texels_count() {
    let coloured = {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().expect("a head");
        writer.write_image_data(&[255, 0, 51, 102, 255, 0, 51, 102]).expect("texels");
        drop(writer);
        bytes
    };
    for (channel, value) in [("R", 1.0), ("G", 0.0), ("B", 0.2), ("A", 0.4)] {
        let part = packed(&model(&USUAL, &format!(r#"channel="{channel}""#), "", ""), &coloured);
        let plan = part.plan(Depth::Bit);
        let top = SIZE[2] + 0.3 * value;
        let farthest = part.farthest_mm(&plan, |at| at.min(DVec3::new(SIZE[0], SIZE[1], top) - at).min_element());
        assert!(farthest < 0.002, "{channel}: {farthest} mm");
    }
    let half = model(&USUAL, "", "", "").replace(r#"n="0""#, r#"n="0" f="0.5""#);
    let part = packed(&half, &map([4, 4], |_| 1.0));
    let top = DVec3::new(SIZE[0], SIZE[1], SIZE[2] + 0.15);
    assert!(part.farthest_mm(&part.plan(Depth::Bit), |at| at.min(top - at).min_element()) < 0.002);
    let nearest = packed(&model(&USUAL, r#"filter="nearest" tilestyleu="none""#, "", ""), &step());
    let inside = |at: DVec3| {
        let is_high = at.x > SIZE[0] / 2.0;
        let top = DVec3::new(SIZE[0], SIZE[1], SIZE[2] + if is_high { 0.3 } else { 0.0 });
        at.min(top - at).min_element().min(if at.z > SIZE[2] { (at.x - SIZE[0] / 2.0).abs() } else { f64::MAX })
    };
    // A step is as steep as a facet is short.
    assert!(nearest.farthest_mm(&nearest.plan(Depth::Bit), inside) < 0.051);
}

#[test]
fn what_is_missing_or_wrong_is_named() {
    let bench = Bench::new();
    let whole = model(&USUAL, "", "", "");
    let png = step();
    for (from, to, expected) in [
        (r#"path="/3D/map.png""#, r#"path="/3D/absent.png""#, "3D/absent.png"),
        (r#"path="/3D/map.png""#, "", "`displacement2d` without path"),
        (r#"dispid="3""#, r#"dispid="9""#, "dispid = 9: there is no `displacement2d`"),
        (r#"nid="8""#, r#"nid="9""#, "nid = 9: there is no `normvectorgroup`"),
        (r#"nid="8""#, "", "have a nid"),
        (r#"did="7""#, r#"did="99""#, "did = 99: there is no `disp2dgroup`"),
        (r#"did="7""#, r#"did="x""#, "did = `x`"),
        (r#"did="7""#, "", "has a did"),
        (r#"d1="6""#, r#"d1="999""#, "d1 = 999; group 7 has 36 coordinates"),
        (r#"z="5""#, r#"z="0""#, "has no direction"),
        (r#"z="5""#, "", "`normvector` without z"),
        (r#"height="0.3""#, "", "without height"),
        (r#"height="0.3""#, r#"height="inf""#, "not a finite number"),
        (r#"u="0""#, r#"u="1e30""#, "allowed are -500 to 500"),
        (r#"n="0""#, r#"n="3""#, "n = 3; group 8 has 1 vectors"),
        (r#"path="/3D/map.png""#, r#"path="/3D/map.png" contenttype="image/jpeg""#, "only image/png is read"),
        (r#"path="/3D/map.png""#, r#"path="/3D/map.png" channel="Q""#, "channel `Q`"),
        (r#"path="/3D/map.png""#, r#"path="/3D/map.png" filter="x""#, "filter `x`"),
        (r#"path="/3D/map.png""#, r#"path="/3D/map.png" tilestylev="x""#, "tilestylev = `x`"),
        (r#"<d:disp2dgroup id="7""#, r#"<d:disp2dgroup id="8""#, "did = 7"),
        (
            r#"<d:normvectorgroup id="8">"#,
            r#"<d:normvectorgroup id="8"/><d:normvectorgroup id="8">"#,
            "two displacement resources",
        ),
    ] {
        assert!(whole.contains(from), "{from}");
        let model = if from.starts_with("d1") { whole.replacen(from, to, 1) } else { whole.replace(from, to) };
        let parts = [("_rels/.rels", RELATIONSHIPS.as_bytes()), (MODEL, model.as_bytes()), ("3D/map.png", &png[..])];
        let error = said(bench.package_bytes(&parts));
        assert!(error.contains(expected), "`{error}` does not say `{expected}`");
    }
}

#[test]
fn a_second_map_is_refused_and_both_are_named() {
    let mut bench = Bench::new();
    let map = bench.file("other.png", &step());
    bench.options.relief.map = Some(DisplacementOptions { map, tile: Tile::Wrap });
    bench.options.relief.height_mm = Some(0.5);
    let (model, png) = (model(&USUAL, "", "", ""), step());
    let parts = [("_rels/.rels", RELATIONSHIPS.as_bytes()), (MODEL, model.as_bytes()), ("3D/map.png", &png[..])];
    let error = said(bench.package_bytes(&parts));
    for told in ["object 1", "3D/map.png", "other.png", "leave out --displacement", "--height"] {
        assert!(error.contains(told), "`{error}` does not say `{told}`");
    }
    // Without it, the height replaces that of the file.
    bench.options.relief.map = None;
    let (report, _) = bench.package_bytes(&parts).unwrap_or_else(|error| panic!("{error}"));
    let bounds = report.header.bounds;
    let height_mm = f64::from(bounds.max[2] - bounds.min[2]) / 1000.0;
    assert!((height_mm - SIZE[2] - 0.5).abs() < 2e-3, "{height_mm} mm");
}

#[test]
fn the_published_sample_has_one_rough_side() {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let path = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from).join("cube_displacement_oneside.3mf");
    if !path.exists() {
        return crate::skip::skipped(&format!("there is no {}", path.display()));
    }
    let bench = Bench::new();
    let (report, _) = bench.pack(&path).unwrap_or_else(|error| panic!("{error}"));
    let part = part(bench, report);
    assert!(matches!(&part.file.header().bodies[..], [BodyHeader::Relief(relief)] if relief.patch_count == 12));
    let bytes = part.file.file_bytes();
    assert!(bytes < 20_000, "{bytes} bytes for a texture of 16 KB");
    let bounds = part.file.header().bounds;
    let size_mm = [0, 1, 2].map(|axis| f64::from(bounds.max[axis] - bounds.min[axis]) / 1000.0);
    assert!((size_mm[0] - 40.0).abs() < 0.01 && (size_mm[2] - 40.0).abs() < 0.01, "{size_mm:?}");
    assert!(size_mm[1] > 40.5 && size_mm[1] <= 41.51, "the map lifts one side by up to 1.5 mm: {size_mm:?}");
}
