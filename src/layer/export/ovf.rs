//! The layers of a part as an OpenVectorFormat file, which holds vectors and laser parameters. `tests/export_ovf.rs` reads it back.
//!
//! A file is a magic number, then the layers, then what holds for the whole job, all as protobuf messages with their length before them.
//! Tables at the end of each layer and of the file say where messages begin, so that a reader fetches any layer without the others. Of
//! the layers that are written the writer keeps only their place: 8 bytes a layer.
//!
//! Messages and tags are those of the schema of OpenVectorFormat 1.x; only fields that are used stand here.

use std::collections::BTreeMap;
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

use prost::Message;

use crate::layer::{LaserParameters, MarkClass, Run, Vectors};
use crate::output::Output;

/// What a file begins with. The place of the file's table follows.
const MAGIC: [u8; 4] = *b"LVF!";

/// Key of the only part of a file.
const PART: i32 = 1;

#[derive(Clone, PartialEq, Message)]
struct Job {
    #[prost(message, optional, tag = "2")]
    meta_data: Option<JobMetaData>,
    #[prost(btree_map = "int32, message", tag = "3")]
    marking_params: BTreeMap<i32, MarkingParams>,
    #[prost(btree_map = "int32, message", tag = "4")]
    parts: BTreeMap<i32, Part>,
    #[prost(int32, tag = "6")]
    work_plane_count: i32,
}

#[derive(Clone, PartialEq, Message)]
struct JobMetaData {
    #[prost(uint64, tag = "2")]
    version: u64,
    #[prost(string, tag = "3")]
    job_name: String,
    #[prost(message, optional, tag = "6")]
    bounds: Option<Box2D>,
}

#[derive(Clone, PartialEq, Message)]
struct Part {
    #[prost(string, tag = "1")]
    name: String,
}

#[derive(Clone, PartialEq, Message)]
struct MarkingParams {
    #[prost(float, tag = "1")]
    laser_power_w: f32,
    #[prost(float, tag = "2")]
    laser_speed_mm_s: f32,
    #[prost(float, tag = "3")]
    laser_focus_shift_mm: f32,
    #[prost(float, tag = "4")]
    point_exposure_time_us: f32,
    #[prost(float, tag = "5")]
    jump_speed_mm_s: f32,
    #[prost(float, tag = "6")]
    point_exposure_repetitions: f32,
    #[prost(float, tag = "11")]
    jump_delay_us: f32,
    #[prost(float, tag = "14")]
    mark_delay_us: f32,
    #[prost(float, tag = "15")]
    polygon_delay_us: f32,
    #[prost(string, tag = "26")]
    name: String,
}

#[derive(Clone, Copy, PartialEq, Message)]
struct Box2D {
    #[prost(float, tag = "1")]
    x_min: f32,
    #[prost(float, tag = "2")]
    y_min: f32,
    #[prost(float, tag = "3")]
    x_max: f32,
    #[prost(float, tag = "4")]
    y_max: f32,
}

/// A layer without its vectors.
#[derive(Clone, PartialEq, Message)]
struct WorkPlane {
    #[prost(float, tag = "4")]
    z_mm: f32,
    #[prost(int32, tag = "8")]
    block_count: i32,
    #[prost(int32, tag = "10")]
    number: i32,
    #[prost(message, optional, tag = "13")]
    meta_data: Option<WorkPlaneMetaData>,
}

#[derive(Clone, PartialEq, Message)]
struct WorkPlaneMetaData {
    #[prost(message, optional, tag = "7")]
    bounds: Option<Box2D>,
}

#[derive(Clone, PartialEq, Message)]
struct VectorBlock {
    #[prost(oneof = "VectorData", tags = "1, 2, 3")]
    data: Option<VectorData>,
    #[prost(int32, tag = "50")]
    marking_params_key: i32,
    #[prost(message, optional, tag = "100")]
    meta_data: Option<BlockMetaData>,
    #[prost(message, optional, tag = "101")]
    lpbf: Option<LpbfMetaData>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum VectorData {
    /// Connected points.
    #[prost(message, tag = "1")]
    Lines(Points),
    /// Two points a vector.
    #[prost(message, tag = "2")]
    Hatches(Points),
    /// Timed points.
    #[prost(message, tag = "3")]
    Points(Points),
}

/// x and y by turns, millimetres.
#[derive(Clone, PartialEq, Message)]
struct Points {
    #[prost(float, repeated, tag = "1")]
    coordinates_mm: Vec<f32>,
}

#[derive(Clone, PartialEq, Message)]
struct BlockMetaData {
    #[prost(int32, tag = "3")]
    part_key: i32,
}

#[derive(Clone, Copy, PartialEq, Message)]
struct LpbfMetaData {
    /// 0 for the volume, 1 for a contour.
    #[prost(int32, tag = "1")]
    part_area: i32,
    /// 0 inside, 1 for a down-skin, 2 for an up-skin.
    #[prost(int32, tag = "2")]
    skin_type: i32,
}

/// Where the parts of the file begin.
#[derive(Clone, PartialEq, Message)]
struct JobTable {
    #[prost(int64, tag = "1")]
    job_shell_at: i64,
    #[prost(int64, repeated, tag = "2")]
    work_planes_at: Vec<i64>,
}

/// Where the parts of a layer begin.
#[derive(Clone, PartialEq, Message)]
struct WorkPlaneTable {
    #[prost(int64, tag = "1")]
    shell_at: i64,
    #[prost(int64, repeated, tag = "2")]
    blocks_at: Vec<i64>,
}

/// Writes a file layer by layer.
#[derive(Debug)]
pub struct OvfWriter {
    output: Output,
    /// Length of the file so far.
    at: i64,
    job: Job,
    table: JobTable,
}

impl OvfWriter {
    /// Begins a file. `name` is that of the part; `lasers` has the parameters of each class, in the order of the classes' numbers.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn create(path: &Path, name: &str, lasers: &[LaserParameters; MarkClass::ALL.len()]) -> io::Result<Self> {
        let output = Output::create(path)?;
        let mut file = output.file();
        file.write_all(&MAGIC)?;
        file.write_all(&0_i64.to_le_bytes())?;
        let params = |class: MarkClass| (class as i32, marking_params(class, &lasers[class as usize]));
        let job = Job {
            meta_data: Some(JobMetaData { version: 1, job_name: name.into(), bounds: None }),
            marking_params: MarkClass::ALL.into_iter().map(params).collect(),
            parts: BTreeMap::from([(PART, Part { name: name.into() })]),
            work_plane_count: 0,
        };
        Ok(Self { output, at: (MAGIC.len() + size_of::<i64>()) as i64, job, table: JobTable::default() })
    }

    /// Writes the next layer, whose top is `top_um` above the bottom of the part.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn layer(&mut self, top_um: f64, vectors: &Vectors) -> io::Result<()> {
        let begin = self.at;
        self.table.work_planes_at.push(begin);
        let mut file = Places { file: BufWriter::new(self.output.file()), at: begin };
        // The place of the layer's table, which is known at its end.
        file.write(&0_i64.to_le_bytes())?;
        let mut blocks_at = Vec::new();
        for (class, data) in blocks(vectors.runs()) {
            blocks_at.push(file.message(&block(class, data))?);
        }
        let bounds = bounds(vectors);
        let shell_at = file.message(&WorkPlane {
            z_mm: (top_um / 1000.0) as f32,
            block_count: i32::try_from(blocks_at.len()).map_err(|_| io::Error::other("too many blocks in a layer"))?,
            number: self.job.work_plane_count,
            meta_data: Some(WorkPlaneMetaData { bounds }),
        })?;
        let table_at = file.message(&WorkPlaneTable { shell_at, blocks_at })?;
        file.file.flush()?;
        self.at = file.at;
        self.output.file().write_all_at(&table_at.to_le_bytes(), begin as u64)?;
        self.job.work_plane_count += 1;
        if let (Some(bounds), Some(meta_data)) = (bounds, &mut self.job.meta_data) {
            let all = meta_data.bounds.get_or_insert(bounds);
            *all = Box2D {
                x_min: all.x_min.min(bounds.x_min),
                y_min: all.y_min.min(bounds.y_min),
                x_max: all.x_max.max(bounds.x_max),
                y_max: all.y_max.max(bounds.y_max),
            };
        }
        Ok(())
    }

    /// Ends the file, which appears under its name.
    ///
    /// # Errors
    /// Whatever the file system says; nothing is left behind then.
    pub fn finish(mut self) -> io::Result<()> {
        let mut file = Places { file: BufWriter::new(self.output.file()), at: self.at };
        self.table.job_shell_at = file.message(&self.job)?;
        let table_at = file.message(&self.table)?;
        file.file.flush()?;
        drop(file);
        self.output.file().write_all_at(&table_at.to_le_bytes(), MAGIC.len() as u64)?;
        self.output.publish()
    }
}

/// Writes, and knows where in the file.
struct Places<W: Write> {
    file: W,
    at: i64,
}

impl<W: Write> Places<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)?;
        self.at += bytes.len() as i64;
        Ok(())
    }

    /// Writes a message with its length before it. Returns where it begins.
    fn message(&mut self, message: &impl Message) -> io::Result<i64> {
        let at = self.at;
        self.write(&message.encode_length_delimited_to_vec())?;
        Ok(at)
    }
}

/// What the blocks of a layer hold: its runs. Single points of a class that follow each other are one block.
fn blocks<'a>(runs: impl Iterator<Item = (MarkClass, Run<'a>)>) -> impl Iterator<Item = (MarkClass, VectorData)> {
    let mut runs = runs.peekable();
    std::iter::from_fn(move || {
        let (class, run) = runs.next()?;
        let data = match run {
            Run::Path(&[point_um]) => {
                let mut coordinates_mm = millimetres([point_um]);
                let is_next = |(next, run): &(MarkClass, Run<'_>)| *next == class && matches!(run, Run::Path([_]));
                while let Some((_, Run::Path(points))) = runs.next_if(is_next) {
                    coordinates_mm.extend(millimetres(points.iter().copied()));
                }
                VectorData::Points(Points { coordinates_mm })
            }
            Run::Path(points) => VectorData::Lines(Points { coordinates_mm: millimetres(points.iter().copied()) }),
            Run::Hatches(frame, lines) => {
                let ends = lines.iter().flat_map(|hatch| [hatch.from_um, hatch.to_um].map(|at| (hatch.line, at)));
                let points = ends.map(|(line, along_um)| frame.point_um(line, along_um));
                VectorData::Hatches(Points { coordinates_mm: millimetres(points) })
            }
        };
        Some((class, data))
    })
}

/// Coordinates to less than a hundredth of a micrometre in a field of 100 mm.
fn millimetres(points_um: impl IntoIterator<Item = [i32; 2]>) -> Vec<f32> {
    points_um.into_iter().flatten().map(|um| (f64::from(um) / 1000.0) as f32).collect()
}

fn block(class: MarkClass, data: VectorData) -> VectorBlock {
    let (part_area, skin_type) = match class {
        MarkClass::Contour => (1, 0),
        MarkClass::Hatch | MarkClass::Thin | MarkClass::Point => (0, 0),
        MarkClass::DownSkin => (0, 1),
        MarkClass::UpSkin => (0, 2),
    };
    VectorBlock {
        data: Some(data),
        marking_params_key: class as i32,
        meta_data: Some(BlockMetaData { part_key: PART }),
        lpbf: Some(LpbfMetaData { part_area, skin_type }),
    }
}

fn marking_params(class: MarkClass, laser: &LaserParameters) -> MarkingParams {
    let thousandth = |number: u32| (f64::from(number) / 1000.0) as f32;
    MarkingParams {
        laser_power_w: thousandth(laser.power_mw),
        laser_speed_mm_s: thousandth(laser.mark_speed_um_s),
        laser_focus_shift_mm: (f64::from(laser.focus_um) / 1000.0) as f32,
        point_exposure_time_us: laser.point_time_us as f32,
        jump_speed_mm_s: thousandth(laser.jump_speed_um_s),
        point_exposure_repetitions: 1.0,
        jump_delay_us: laser.jump_delay_us as f32,
        mark_delay_us: laser.mark_delay_us as f32,
        polygon_delay_us: laser.polygon_delay_us as f32,
        name: format!("{class:?}"),
    }
}

/// The box around a layer's vectors; `None` if there are none.
fn bounds(vectors: &Vectors) -> Option<Box2D> {
    let mut points = vectors.marks().flat_map(|mark| [mark.from_um, mark.to_um]);
    let first = points.next()?;
    let (mut low, mut high) = (first, first);
    for point in points {
        low = [low[0].min(point[0]), low[1].min(point[1])];
        high = [high[0].max(point[0]), high[1].max(point[1])];
    }
    let mm = |um: i32| (f64::from(um) / 1000.0) as f32;
    Some(Box2D { x_min: mm(low[0]), y_min: mm(low[1]), x_max: mm(high[0]), y_max: mm(high[1]) })
}
