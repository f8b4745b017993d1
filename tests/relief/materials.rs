//! Height maps that materials of OBJ name (MTL).

use layerd::buildfile::{BodyHeader, BuildFile, PackError, PackReport, pack};

use crate::map;
use crate::objects::cuboid;
use crate::pack_bench::Bench;

const SIZE: [f64; 3] = [2.0, 1.6, 1.2];

/// Packs a box whose upper side has a material, with a library of this text, and returns its height and the notes.
fn packed(bench: &Bench, library: &str) -> Result<(f64, PackReport), PackError> {
    let text = cuboid(SIZE).obj();
    let mut lines: Vec<&str> = text.lines().collect();
    // The third and the fourth face are the upper side.
    let faces: Vec<usize> = (0..lines.len()).filter(|line| lines[*line].starts_with('f')).collect();
    lines.insert(faces[3] + 1, "usemtl plain");
    lines.insert(faces[2], "usemtl rough stone");
    let source = bench.file("in.obj", ("mtllib my library.mtl\n".to_owned() + &lines.join("\n")).as_bytes());
    bench.file("my library.mtl", library.as_bytes());
    bench.file("white map.png", &map([4, 4], |_| 1.0));
    bench.file("grey.png", &map([4, 4], |_| 0.5));
    bench.file("normals.png", &coloured([128, 128, 255]));
    bench.file("grey as RGB.png", &coloured([255; 3]));
    let output = bench.path("out.layerd");
    let report = pack(&[source], &output, &bench.options, &mut |_| {})?;
    let file = BuildFile::open(&output).expect("what pack writes is whole");
    file.verify().expect("it agrees with itself");
    let bounds = file.header().bounds;
    Ok((f64::from(bounds.max[2] - bounds.min[2]) / 1000.0, report))
}

/// A picture of one colour.
fn coloured(colour: [u8; 3]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 4, 4);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().expect("a head").write_image_data(&colour.repeat(16)).expect("texels");
    bytes
}

#[test]
fn maps_of_normals_are_left_out_with_a_note() {
    for statement in ["bump normals.png", "map_bump -bm 0.3 normals.png"] {
        let (height_mm, report) =
            packed(&Bench::new(), &format!("newmtl rough stone\n{statement}\n")).expect(statement);
        assert!((height_mm - SIZE[2]).abs() < 2e-3, "{height_mm} mm with `{statement}`");
        assert!(matches!(report.header.bodies[..], [BodyHeader::Surface(_)]), "no triangle has relief");
        let notes = report.notes.join("\n");
        let told = "normals.png: it has colours, so it holds normals, not heights; a map of heights is grey, or named by `disp`; \
                    this `bump` is left out";
        assert!(notes.contains(told) && !notes.contains("displaced by"), "{notes}");
    }
    for (statement, raised_mm) in
        [("bump -bm 0.2 grey as RGB.png", 0.2), ("disp -bm 0.2 normals.png", 0.2 * 128.0 / 255.0)]
    {
        let (height_mm, report) =
            packed(&Bench::new(), &format!("newmtl rough stone\n{statement}\n")).expect(statement);
        assert!((height_mm - SIZE[2] - raised_mm).abs() < 2e-3, "{height_mm} mm with `{statement}`");
        let notes = report.notes.join("\n");
        assert_eq!(notes.contains("has colours; its green channel is taken"), statement.starts_with("disp"), "{notes}");
    }
}

#[test]
fn maps_of_materials_displace_their_faces() {
    for (statement, raised_mm) in [
        ("disp white map.png", 1.0),
        ("disp -bm 0.25 white map.png", 0.25),
        ("disp white map.png -bm 0.25", 0.25),
        ("map_Disp -mm 0.1 0.5 -bm 2 grey.png", 0.7),
        ("bump -bm 0.2 -imfchan l -clamp on grey.png", 0.1),
        ("map_bump -o 0 0 0 -s 1 1 1 grey.png -bm 0.2", 0.1),
        ("bump -bm 9 white map.png\ndisp -bm 0.1 white map.png", 0.1),
        ("disp -bm 0.1 white map.png\nbump -bm 9 white map.png", 0.1),
        ("Kd 1 1 1\nmap_Kd colours.jpg", 0.0),
    ] {
        let library = format!("# a library\nnewmtl plain\nKd 0 0 0\nnewmtl rough stone\n{statement}\n");
        let (height_mm, report) = packed(&Bench::new(), &library).unwrap_or_else(|error| panic!("{error}"));
        assert!((height_mm - SIZE[2] - raised_mm).abs() < 2e-3, "{height_mm} mm with `{statement}`");
        let notes = report.notes.join("\n");
        assert_eq!(notes.contains("material rough stone: displaced by"), raised_mm > 0.0, "{notes}");
        assert_eq!(matches!(report.header.bodies[..], [BodyHeader::Relief(_)]), raised_mm > 0.0);
    }
}

#[test]
fn a_material_that_no_library_defines_is_named() {
    let note = |library: &str| {
        packed(&Bench::new(), &format!("newmtl plain\n{library}")).expect("can be packed").1.notes.join("\n")
    };
    let named = "no material library defines rough stone";
    assert!(note("newmtl rock\ndisp white map.png\n").contains(named));
    assert!(!note("newmtl rock\nKd 1 1 1\n").contains(named), "nothing would be displaced");
    assert!(!note("newmtl rough stone\nKd 1 1 1\nnewmtl rock\ndisp white map.png\n").contains(named));
}

#[test]
fn the_options_say_how_high() {
    let library = "newmtl rough stone\ndisp white map.png\n";
    let mut bench = Bench::new();
    bench.options.relief.height_mm = Some(0.4);
    assert!((packed(&bench, library).expect("can be packed").0 - SIZE[2] - 0.4).abs() < 2e-3);
    bench.options.relief.offset_mm = Some(-0.1);
    assert!((packed(&bench, library).expect("can be packed").0 - SIZE[2] - 0.3).abs() < 2e-3);
    bench.options.relief.height_mm = Some(0.0);
    let (height_mm, report) = packed(&bench, library).expect("can be packed");
    assert!((height_mm - SIZE[2]).abs() < 2e-3, "a height of 0 leaves maps out");
    assert!(matches!(report.header.bodies[..], [BodyHeader::Surface(_)]));
    let mut scaled = Bench::new();
    scaled.options.scale = [2.0; 3];
    assert!((packed(&scaled, library).expect("can be packed").0 - 2.0 * (SIZE[2] + 1.0)).abs() < 4e-3);
}

#[test]
fn what_is_missing_or_wrong_is_named() {
    for (statement, expected) in [
        ("disp absent.png", "absent.png"),
        ("disp", "my library.mtl: line 2: a map without a file"),
        ("disp -bm x white map.png", "line 2: -bm: `x` is no number"),
        ("disp -o 0.5 0 0 white map.png", "-o 0.5 moves the map"),
        ("disp my library.mtl", "it is not a PNG"),
    ] {
        let error =
            packed(&Bench::new(), &format!("newmtl rough stone\n{statement}\n")).expect_err(statement).to_string();
        assert!(error.contains(expected), "`{error}` does not say `{expected}`");
    }
    let bench = Bench::new();
    let source = bench.file("lost.obj", ("mtllib lost.mtl\n".to_owned() + &cuboid(SIZE).obj()).as_bytes());
    let report = pack(&[source], &bench.path("out.layerd"), &bench.options, &mut |_| {}).expect("can be packed");
    let notes = report.notes.join("\n");
    assert!(notes.contains("lost.mtl") && notes.contains("left out"), "{notes}");
}
