//! OpenVectorFormat files, read back by tables and messages of the test's own.

use std::collections::HashMap;

use layerd::layer::export::OvfWriter;
use layerd::layer::{HatchLine, MarkClass, Vectors, hatch_frame};
use layerd_wire::encoding::LaserParameters;
use prost::Message;

/// Fields as the schema has them, by number and type.
#[derive(Clone, PartialEq, Message)]
struct Job {
    #[prost(message, repeated, tag = "1")]
    work_planes: Vec<WorkPlane>,
    #[prost(message, optional, tag = "2")]
    job_meta_data: Option<JobMetaData>,
    #[prost(map = "int32, message", tag = "3")]
    marking_params_map: HashMap<i32, MarkingParams>,
    #[prost(map = "int32, message", tag = "4")]
    parts_map: HashMap<i32, Part>,
    #[prost(int32, tag = "6")]
    num_work_planes: i32,
}

#[derive(Clone, PartialEq, Message)]
struct JobMetaData {
    #[prost(string, tag = "3")]
    job_name: String,
    #[prost(message, optional, tag = "6")]
    bounds: Option<AxisAlignedBox2D>,
}

#[derive(Clone, PartialEq, Message)]
struct Part {
    #[prost(string, tag = "1")]
    name: String,
}

#[derive(Clone, PartialEq, Message)]
struct MarkingParams {
    #[prost(float, tag = "1")]
    laser_power_in_w: f32,
    #[prost(float, tag = "2")]
    laser_speed_in_mm_per_s: f32,
    #[prost(float, tag = "3")]
    laser_focus_shift_in_mm: f32,
    #[prost(float, tag = "4")]
    point_exposure_time_in_us: f32,
    #[prost(float, tag = "5")]
    jump_speed_in_mm_s: f32,
    #[prost(float, tag = "11")]
    jump_delay_in_us: f32,
    #[prost(float, tag = "14")]
    mark_delay_in_us: f32,
    #[prost(float, tag = "15")]
    polygon_delay_in_us: f32,
}

#[derive(Clone, PartialEq, Message)]
struct WorkPlane {
    #[prost(message, repeated, tag = "1")]
    vector_blocks: Vec<VectorBlock>,
    #[prost(float, tag = "4")]
    z_pos_in_mm: f32,
    #[prost(int32, tag = "8")]
    num_blocks: i32,
    #[prost(int32, tag = "10")]
    work_plane_number: i32,
}

#[derive(Clone, PartialEq, Message)]
struct VectorBlock {
    #[prost(message, optional, tag = "1")]
    line_sequence: Option<Points>,
    #[prost(message, optional, tag = "2")]
    hatches: Option<Points>,
    #[prost(message, optional, tag = "3")]
    point_sequence: Option<Points>,
    #[prost(int32, tag = "50")]
    marking_params_key: i32,
    #[prost(message, optional, tag = "101")]
    lpbf_metadata: Option<LpbfMetadata>,
}

#[derive(Clone, PartialEq, Message)]
struct Points {
    #[prost(float, repeated, tag = "1")]
    points: Vec<f32>,
}

#[derive(Clone, PartialEq, Message)]
struct LpbfMetadata {
    #[prost(int32, tag = "1")]
    part_area: i32,
    #[prost(int32, tag = "2")]
    skin_type: i32,
}

#[derive(Clone, PartialEq, Message)]
struct AxisAlignedBox2D {
    #[prost(float, tag = "1")]
    x_min: f32,
    #[prost(float, tag = "2")]
    y_min: f32,
    #[prost(float, tag = "3")]
    x_max: f32,
    #[prost(float, tag = "4")]
    y_max: f32,
}

/// Both tables: of the file, and of a layer.
#[derive(Clone, PartialEq, Message)]
struct Lut {
    #[prost(int64, tag = "1")]
    shell: i64,
    #[prost(int64, repeated, tag = "2")]
    positions: Vec<i64>,
}

fn at<M: Message + Default>(file: &[u8], place: i64) -> M {
    M::decode_length_delimited(&file[place as usize..]).expect("a message")
}

fn place(file: &[u8], from: usize) -> i64 {
    i64::from_le_bytes(*file[from..].first_chunk().expect("eight bytes"))
}

/// Reads a file as the format's own reader does: by its tables.
fn read(file: &[u8]) -> Job {
    assert_eq!(file[..4], [0x4c, 0x56, 0x46, 0x21]);
    let lut: Lut = at(file, place(file, 4));
    let mut job: Job = at(file, lut.shell);
    assert!(job.work_planes.is_empty(), "the shell has no layers");
    assert_eq!(job.num_work_planes as usize, lut.positions.len());
    for position in lut.positions {
        let layer: Lut = at(file, place(file, position as usize));
        let mut plane: WorkPlane = at(file, layer.shell);
        assert_eq!(plane.num_blocks as usize, layer.positions.len());
        plane.vector_blocks = layer.positions.iter().map(|position| at(file, *position)).collect();
        job.work_planes.push(plane);
    }
    job
}

fn layer(number: i32) -> Vectors {
    let mut vectors = Vectors::default();
    let at = 1000 + 100 * number;
    vectors.push_path(MarkClass::Contour, &[[at, 1000], [at + 60, 1000], [at + 30, 1040], [at, 1000]]);
    let line = |line, from_um, to_um| HatchLine { line, from_um, to_um };
    let frame = hatch_frame([at, 1000], 67.0, 61_234);
    vectors.push_hatches(MarkClass::Hatch, frame, &[line(1, 0, 90), line(2, 88, 3)]);
    vectors.push_hatches(MarkClass::UpSkin, frame, &[line(-3, 0, 500)]);
    vectors.push_hatches(MarkClass::DownSkin, frame, &[line(-4, 0, 500)]);
    vectors.push_path(MarkClass::Thin, &[[5, 7], [400, 9]]);
    vectors.push_path(MarkClass::Point, &[[77_777, 88_888]]);
    vectors.push_path(MarkClass::Point, &[[77_900, 99_999]]);
    vectors.push_path(MarkClass::Thin, &[[5, 7]]);
    vectors
}

/// The vectors of a layer: class, then the two ends in micrometres.
fn marks(plane: &WorkPlane) -> Vec<(i32, [[i32; 2]; 2])> {
    let mut marks = Vec::new();
    for block in &plane.vector_blocks {
        let pairs = |points: &Points| -> Vec<[i32; 2]> {
            let um = |mm: f32| (f64::from(mm) * 1000.0).round() as i32;
            let (pairs, rest) = points.points.as_chunks::<2>();
            assert!(rest.is_empty());
            pairs.iter().map(|pair| pair.map(um)).collect()
        };
        let ends: Vec<[[i32; 2]; 2]> = match (&block.line_sequence, &block.hatches, &block.point_sequence) {
            (Some(points), None, None) => pairs(points).windows(2).map(|pair| [pair[0], pair[1]]).collect(),
            (None, Some(points), None) => pairs(points).as_chunks::<2>().0.to_vec(),
            (None, None, Some(points)) => pairs(points).into_iter().map(|point| [point; 2]).collect(),
            other => panic!("a block of one kind, not {other:?}"),
        };
        marks.extend(ends.into_iter().map(|ends| (block.marking_params_key, ends)));
    }
    marks
}

#[test]
fn a_file_has_every_vector_of_every_layer_and_the_lasers() {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("part.ovf");
    let lasers = [0, 1, 2, 3, 4, 5].map(|class| LaserParameters {
        power_mw: 190_500 + class,
        mark_speed_um_s: 800_000,
        jump_speed_um_s: 5_000_000,
        focus_um: -250,
        jump_delay_us: 100,
        mark_delay_us: 50,
        polygon_delay_us: 20,
        point_time_us: 400,
    });
    let mut writer = OvfWriter::create(&path, "a part", &lasers).expect("begun");
    for number in 0..5 {
        let vectors = if number == 3 { Vectors::default() } else { layer(number) };
        writer.layer(30.0 * f64::from(number + 1), &vectors).expect("written");
    }
    assert!(!path.exists(), "a file appears whole");
    writer.finish().expect("ended");
    assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);

    let job = read(&std::fs::read(&path).expect("the file"));
    let meta_data = job.job_meta_data.expect("meta data");
    let bounds = AxisAlignedBox2D { x_min: 0.005, y_min: 0.007, x_max: 77.9, y_max: 99.999 };
    assert_eq!((meta_data.job_name.as_str(), meta_data.bounds), ("a part", Some(bounds)));
    assert_eq!(job.parts_map[&1].name, "a part");
    assert_eq!(job.marking_params_map.len(), 6);
    let expected = MarkingParams {
        laser_power_in_w: 190.503,
        laser_speed_in_mm_per_s: 800.0,
        laser_focus_shift_in_mm: -0.25,
        point_exposure_time_in_us: 400.0,
        jump_speed_in_mm_s: 5000.0,
        jump_delay_in_us: 100.0,
        mark_delay_in_us: 50.0,
        polygon_delay_in_us: 20.0,
    };
    assert_eq!(job.marking_params_map[&3], expected);
    for (number, plane) in job.work_planes.iter().enumerate() {
        assert_eq!(plane.work_plane_number as usize, number);
        assert_eq!(plane.z_pos_in_mm, (0.03 * (number + 1) as f64) as f32);
        let vectors = if number == 3 { Vectors::default() } else { layer(number as i32) };
        let expected: Vec<_> = vectors.marks().map(|mark| (mark.class as i32, [mark.from_um, mark.to_um])).collect();
        assert_eq!(marks(plane), expected, "layer {number}");
    }
    let blocks = &job.work_planes[0].vector_blocks;
    let kinds = blocks.iter().map(|block| block.lpbf_metadata.as_ref().expect("meta data"));
    let kinds: Vec<_> = kinds.map(|kind| (kind.part_area, kind.skin_type)).collect();
    assert_eq!(kinds, [(1, 0), (0, 0), (0, 2), (0, 1), (0, 0), (0, 0), (0, 0)], "two points are one block");
}
