//! Layers of vectors as files: each is read back by a reader of the test's own.

use layerd::layer::export::{CliWriter, write_svg};
use layerd::layer::{HatchLine, Mark, MarkClass, Run, Vectors, hatch_frame};

/// A layer with runs of every kind and class, which differs from layer to layer.
fn layer(number: i32) -> Vectors {
    let mut vectors = Vectors::default();
    let at = 1000 + 100 * number;
    vectors.push_path(MarkClass::Contour, &[[at, 1000], [at + 60, 1000], [at + 30, 1040], [at, 1000]]);
    vectors.push_path(MarkClass::Contour, &[[at + 20, 1010], [at + 30, 1020], [at + 40, 1010], [at + 20, 1010]]);
    let frame = hatch_frame([at, 1000], 67.0, 61_234);
    let line = |line, from_um, to_um| HatchLine { line, from_um, to_um };
    vectors.push_hatches(MarkClass::Hatch, frame, &[line(1, 0, 90), line(2, 88, 3), line(3, 10, 70)]);
    vectors.push_hatches(MarkClass::UpSkin, frame, &[line(-3, 0, 500)]);
    vectors.push_hatches(MarkClass::DownSkin, hatch_frame([at, 99_000], 0.0, 80_000), &[line(0, 500, 7)]);
    vectors.push_path(MarkClass::Thin, &[[5, 7], [400, 9], [99_999, 12_345]]);
    vectors.push_path(MarkClass::Point, &[[77_777, 88_888]]);
    vectors.push_path(MarkClass::Point, &[[77_900, 88_888]]);
    vectors
}

mod cli {
    use super::*;

    /// A CLI file, as its specification has the long forms.
    struct CliFile {
        header: Vec<String>,
        layers: Vec<(f32, Vec<Command>)>,
    }

    #[derive(Debug, PartialEq)]
    enum Command {
        Polyline { id: i32, direction: i32, points: Vec<[f32; 2]> },
        Hatches { id: i32, ends: Vec<[f32; 2]> },
    }

    struct Bytes<'a>(&'a [u8]);

    impl Bytes<'_> {
        fn take<const N: usize>(&mut self) -> [u8; N] {
            let (first, rest) = self.0.split_first_chunk().expect("more bytes");
            self.0 = rest;
            *first
        }

        fn long(&mut self) -> i32 {
            i32::from_le_bytes(self.take())
        }

        fn points(&mut self, count: i32) -> Vec<[f32; 2]> {
            let mut real = || f32::from_le_bytes(self.take());
            (0..count).map(|_| [real(), real()]).collect()
        }
    }

    fn read(bytes: &[u8]) -> CliFile {
        let end = b"$$HEADEREND";
        let at = bytes.windows(end.len()).position(|window| window == end).expect("an end of the header");
        let header = std::str::from_utf8(&bytes[..at]).expect("a header of ASCII").lines().map(str::to_owned).collect();
        let mut bytes = Bytes(&bytes[at + end.len()..]);
        let mut layers: Vec<(f32, Vec<Command>)> = Vec::new();
        while !bytes.0.is_empty() {
            match u16::from_le_bytes(bytes.take()) {
                127 => layers.push((f32::from_le_bytes(bytes.take()), Vec::new())),
                130 => {
                    let (id, direction, count) = (bytes.long(), bytes.long(), bytes.long());
                    let command = Command::Polyline { id, direction, points: bytes.points(count) };
                    layers.last_mut().expect("a layer").1.push(command);
                }
                132 => {
                    let (id, count) = (bytes.long(), bytes.long());
                    let command = Command::Hatches { id, ends: bytes.points(2 * count) };
                    layers.last_mut().expect("a layer").1.push(command);
                }
                other => panic!("command {other}"),
            }
        }
        CliFile { header, layers }
    }

    #[test]
    fn a_file_has_every_vector_of_every_layer() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("part.cli");
        let mut writer = CliWriter::create(&path, "a/part\n$$", 3).expect("begun");
        for number in 0..3 {
            writer.layer(30.0 * f64::from(number + 1), &layer(number)).expect("written");
        }
        assert!(!path.exists(), "a file appears whole");
        writer.finish().expect("ended");

        let file = read(&std::fs::read(&path).expect("the file"));
        assert_eq!(
            file.header,
            [
                "$$HEADERSTART",
                "$$BINARY",
                "$$UNITS/0.001",
                "$$VERSION/200",
                "$$LABEL/1,a_part___",
                "$$DIMENSION/000000.0050,000000.0070,000000.0000,000099.9990,000099.0000,000000.0900",
                "$$LAYERS/3",
            ]
        );
        assert_eq!(file.layers.iter().map(|layer| layer.0).collect::<Vec<_>>(), [30.0, 60.0, 90.0]);
        for (number, (_, commands)) in file.layers.iter().enumerate() {
            let vectors = layer(number as i32);
            let expected: Vec<_> = vectors.runs().map(|(_, run)| expected(&run)).collect();
            assert_eq!(*commands, expected, "layer {number}");
        }
        let directions = file.layers[0].1.iter().filter_map(|command| match command {
            Command::Polyline { direction, .. } => Some(*direction),
            Command::Hatches { .. } => None,
        });
        assert_eq!(directions.collect::<Vec<_>>(), [1, 0, 2, 2, 2], "outer, inner, three open");
    }

    fn expected(run: &Run<'_>) -> Command {
        let real = |point_um: [i32; 2]| point_um.map(|um| um as f32);
        match run {
            Run::Path(points) => {
                let is_ring = points.len() > 3 && points[0] == points[points.len() - 1];
                // The outer ring of a layer has its third point above the first two.
                let direction = if !is_ring { 2 } else { i32::from(points[1][1] <= points[0][1]) };
                let points = if points.len() == 1 { vec![points[0]; 2] } else { points.to_vec() };
                Command::Polyline { id: 1, direction, points: points.into_iter().map(real).collect() }
            }
            Run::Hatches(frame, lines) => {
                let ends = lines.iter().flat_map(|hatch| [(hatch.line, hatch.from_um), (hatch.line, hatch.to_um)]);
                let ends = ends.map(|(line, along_um)| real(frame.point_um(line, along_um)));
                Command::Hatches { id: 1, ends: ends.collect() }
            }
        }
    }

    #[test]
    fn a_wrong_number_of_layers_leaves_no_file() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("part.cli");
        let mut writer = CliWriter::create(&path, "part", 1).expect("begun");
        writer.layer(30.0, &Vectors::default()).expect("written");
        assert!(writer.layer(60.0, &Vectors::default()).is_err());
        let short = CliWriter::create(&path, "part", 1).expect("begun");
        assert!(short.finish().is_err());
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 0);
        // An empty part has the box of nothing.
        writer.finish().expect("ended");
        let file = read(&std::fs::read(&path).expect("the file"));
        assert_eq!((file.layers.len(), file.layers[0].1.len()), (1, 0));
    }
}

mod svg {
    use super::*;

    /// Two ends.
    type Line = [[i32; 2]; 2];

    /// The vectors of a file's paths with their classes, and its jumps.
    fn read(text: &str) -> (Vec<(String, Line)>, Vec<Line>) {
        let mut reader = quick_xml::Reader::from_str(text);
        let (mut marks, mut jumps) = (Vec::new(), Vec::new());
        loop {
            match reader.read_event().expect("well-formed") {
                quick_xml::events::Event::Eof => return (marks, jumps),
                quick_xml::events::Event::Empty(element) if element.name().as_ref() == "path" => {
                    let attribute = |name: &str| {
                        let found = element.try_get_attribute(name).expect("good attributes").expect("it has one");
                        found.value.into_owned()
                    };
                    let class = attribute("class");
                    for pair in pairs(&attribute("d")) {
                        if class == "jump" { jumps.push(pair) } else { marks.push((class.clone(), pair)) }
                    }
                }
                _ => {}
            }
        }
    }

    fn pairs(data: &str) -> Vec<Line> {
        let mut found = Vec::new();
        for line in data.split('M').skip(1) {
            if let Some(point) = line.strip_suffix("h0") {
                found.push([point_of(point); 2]);
                continue;
            }
            let points: Vec<_> = line.split('L').map(point_of).collect();
            found.extend(points.windows(2).map(|pair| [pair[0], pair[1]]));
        }
        found
    }

    fn point_of(text: &str) -> [i32; 2] {
        let (x, y) = text.split_once(' ').expect("two numbers");
        [x, y].map(|number| number.parse().expect("a whole number"))
    }

    #[test]
    fn a_picture_has_every_vector_and_every_jump() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("layer_000000.svg");
        let vectors = layer(0);
        write_svg(&path, &vectors, [100_000, 80_000], 62.5).expect("written");
        let text = std::fs::read_to_string(&path).expect("the file");
        let (marks, jumps) = read(&text);
        let names = ["contour", "hatch", "up-skin", "down-skin", "thin", "point"];
        let expected: Vec<_> = vectors
            .marks()
            .map(|Mark { class, from_um, to_um }| (names[class as usize].to_owned(), [from_um, to_um]))
            .collect();
        assert_eq!(marks, expected);
        let all: Vec<_> = vectors.marks().collect();
        let expected = all.windows(2).map(|pair| [pair[0].to_um, pair[1].from_um]).filter(|[from, to]| from != to);
        assert_eq!(jumps, expected.collect::<Vec<_>>());
        assert!(text.contains(r#"viewBox="0 0 100000 80000""#) && text.contains(r#"stroke-width="62.5""#));
        assert!(text.contains(r#"matrix(1 0 0 -1 0 80000)"#), "y goes up");

        write_svg(&path, &Vectors::default(), [100_000, 80_000], 62.5).expect("replaced");
        assert_eq!(read(&std::fs::read_to_string(&path).expect("the file")), (vec![], vec![]));
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
    }
}
