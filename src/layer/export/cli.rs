//! The layers of a part as a Common Layer Interface file (CLI 2.0): binary, in the long forms, which every reader knows.
//!
//! A unit is a micrometre, so that whole micrometres are exact in the file's 32-bit floating point numbers. The height of a layer is
//! that of its top. CLI has no laser parameters and no points: a point is a line without length. `tests/export_vectors.rs` reads the
//! files back.

use std::io::{self, BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

use crate::layer::{HatchFrame, HatchLine, Run, Vectors};
use crate::output::Output;

// Commands.
const LAYER: u16 = 127;
const POLYLINE: u16 = 130;
const HATCHES: u16 = 132;

// Directions of a polyline.
const CLOCKWISE: i32 = 0;
const COUNTER_CLOCKWISE: i32 = 1;
const OPEN: i32 = 2;

/// The only part of a file. Its label is in the header.
const PART: i32 = 1;

/// Most bytes of a label. Readers keep it in a line of the header.
const MAX_LABEL_BYTES: usize = 64;

/// Writes a CLI file layer by layer. It keeps none of them.
#[derive(Debug)]
pub struct CliWriter {
    output: Output,
    buffer: Vec<u8>,
    /// Where the header's dimensions stand.
    dimension_at: u64,
    layers_left: u32,
    low_um: [i32; 2],
    high_um: [i32; 2],
    top_um: f64,
}

impl CliWriter {
    /// Begins a file of `layer_count` layers. The label names the part; letters that a header cannot have become `_`.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn create(path: &Path, label: &str, layer_count: u32) -> io::Result<Self> {
        let output = Output::create(path)?;
        let is_plain = |letter: &char| letter.is_ascii_alphanumeric() || "-_. ".contains(*letter);
        let label: String = label.chars().map(|c| if is_plain(&c) { c } else { '_' }).take(MAX_LABEL_BYTES).collect();
        let mut file = output.file();
        let begin =
            format!("$$HEADERSTART\n$$BINARY\n$$UNITS/0.001\n$$VERSION/200\n$$LABEL/{PART},{label}\n$$DIMENSION/");
        let dimension = dimension([0; 2], [0; 2], 0.0);
        write!(file, "{begin}{dimension}\n$$LAYERS/{layer_count}\n$$HEADEREND")?;
        Ok(Self {
            output,
            buffer: Vec::new(),
            dimension_at: begin.len() as u64,
            layers_left: layer_count,
            low_um: [i32::MAX; 2],
            high_um: [i32::MIN; 2],
            top_um: 0.0,
        })
    }

    /// Writes the next layer, whose top is `top_um` above the bottom of the part. The vectors lie in the field: no coordinate is negative.
    ///
    /// # Errors
    /// Whatever the file system says; and if there are more layers than announced.
    pub fn layer(&mut self, top_um: f64, vectors: &Vectors) -> io::Result<()> {
        let Some(layers_left) = self.layers_left.checked_sub(1) else {
            return Err(io::Error::other("there are more layers than the file's header says"));
        };
        self.layers_left = layers_left;
        self.top_um = top_um;
        let mut file = BufWriter::new(self.output.file());
        file.write_all(&LAYER.to_le_bytes())?;
        file.write_all(&(top_um as f32).to_le_bytes())?;
        for (_, run) in vectors.runs() {
            self.buffer.clear();
            match run {
                Run::Path(points) => put_polyline(&mut self.buffer, points)?,
                Run::Hatches(frame, lines) => put_hatches(&mut self.buffer, frame, lines)?,
            }
            file.write_all(&self.buffer)?;
        }
        file.flush()?;
        for point_um in vectors.marks().flat_map(|mark| [mark.from_um, mark.to_um]) {
            let [x, y] = point_um;
            self.low_um = [self.low_um[0].min(x), self.low_um[1].min(y)];
            self.high_um = [self.high_um[0].max(x), self.high_um[1].max(y)];
        }
        Ok(())
    }

    /// Ends the file, which appears under its name.
    ///
    /// # Errors
    /// Whatever the file system says; and if layers are missing. Nothing is left behind then.
    pub fn finish(self) -> io::Result<()> {
        if self.layers_left > 0 {
            return Err(io::Error::other("there are fewer layers than the file's header says"));
        }
        if self.low_um[0] <= self.high_um[0] {
            let dimension = dimension(self.low_um, self.high_um, self.top_um);
            self.output.file().write_all_at(dimension.as_bytes(), self.dimension_at)?;
        }
        self.output.publish()
    }
}

/// The box around the part, millimetres. It has the same length for all parts, because it is known after the layers.
fn dimension([x0, y0]: [i32; 2], [x1, y1]: [i32; 2], top_um: f64) -> String {
    let [x0, y0, x1, y1] = [x0, y0, x1, y1].map(|um| f64::from(um) / 1000.0);
    let z1 = top_um / 1000.0;
    format!("{x0:011.4},{y0:011.4},{:011.4},{x1:011.4},{y1:011.4},{z1:011.4}", 0.0)
}

/// Number of points or lines as the file has it.
fn count(length: usize) -> io::Result<[u8; 4]> {
    let count =
        i32::try_from(length).map_err(|_| io::Error::other("more points in a line than a CLI file can count"))?;
    Ok(count.to_le_bytes())
}

fn put_polyline(bytes: &mut Vec<u8>, points: &[[i32; 2]]) -> io::Result<()> {
    // Readers expect two points at least.
    let points = if let [point] = points { &[*point; 2] } else { points };
    bytes.extend(POLYLINE.to_le_bytes());
    bytes.extend(PART.to_le_bytes());
    bytes.extend(direction(points).to_le_bytes());
    bytes.extend(count(points.len())?);
    points.iter().for_each(|point_um| put_point(bytes, *point_um));
    Ok(())
}

fn put_hatches(bytes: &mut Vec<u8>, frame: &HatchFrame, lines: &[HatchLine]) -> io::Result<()> {
    bytes.extend(HATCHES.to_le_bytes());
    bytes.extend(PART.to_le_bytes());
    bytes.extend(count(lines.len())?);
    for HatchLine { line, from_um, to_um } in lines {
        put_point(bytes, frame.point_um(*line, *from_um));
        put_point(bytes, frame.point_um(*line, *to_um));
    }
    Ok(())
}

fn put_point(bytes: &mut Vec<u8>, point_um: [i32; 2]) {
    // Exact up to 16.7 m.
    bytes.extend(point_um.into_iter().flat_map(|um| (um as f32).to_le_bytes()));
}

/// The direction of a polyline; that of a ring is the sign of its area.
fn direction(points: &[[i32; 2]]) -> i32 {
    let [first, .., last] = points else { return OPEN };
    if points.len() < 4 || first != last {
        return OPEN;
    }
    let twice_area: i128 = points
        .windows(2)
        .map(|pair| {
            let [[x0, y0], [x1, y1]] = [pair[0], pair[1]].map(|point_um| point_um.map(i128::from));
            x0 * y1 - x1 * y0
        })
        .sum();
    if twice_area < 0 { CLOCKWISE } else { COUNTER_CLOCKWISE }
}
