//! A layer as scan vectors, in the order in which a laser marks them. `slice/scan` makes them, `device/encoding.rs` encodes them.

use layerd_wire::encoding::{HatchFrame, HatchLine, MarkClass};

/// A frame whose lines have an angle to the x axis, counter-clockwise, degrees. Its points follow from whole numbers alone, so that host
/// and device compute the same ones.
pub fn hatch_frame(origin_um: [i32; 2], angle_deg: f64, spacing_nm: u32) -> HatchFrame {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let along = [cos, sin].map(|share| (share * f64::from(1 << 30)).round() as i32);
    HatchFrame { origin_um, along, spacing_nm }
}

/// A run of vectors of one class. The laser jumps to its beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Run<'a> {
    /// Connected points, marked one after the other; a ring repeats its first point. A single point is marked for the class's point
    /// time.
    Path(&'a [[i32; 2]]),
    /// Hatches, with a jump to each.
    Hatches(&'a HatchFrame, &'a [HatchLine]),
}

/// One vector: a mark from one point to another, or a timed point if they are equal. Micrometres in the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mark {
    /// Its class.
    pub class: MarkClass,
    /// Where the laser goes on.
    pub from_um: [i32; 2],
    /// Where it goes off, unless the next mark begins there.
    pub to_um: [i32; 2],
}

/// The vectors of a layer. Coordinates are whole micrometres from the low corner of the field.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Vectors {
    runs: Vec<Stored>,
    points: Vec<[i32; 2]>,
    frames: Vec<HatchFrame>,
    lines: Vec<HatchLine>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stored {
    class: MarkClass,
    /// Number of a frame; `None` for a path.
    frame: Option<u32>,
    /// End of the run in `points` or in `lines`.
    end: usize,
}

impl Vectors {
    /// Adds a path. Nothing is added if it has no point.
    pub fn push_path(&mut self, class: MarkClass, points_um: &[[i32; 2]]) {
        if points_um.is_empty() {
            return;
        }
        self.points.extend_from_slice(points_um);
        self.runs.push(Stored { class, frame: None, end: self.points.len() });
    }

    /// Adds hatches. Nothing is added if there are none.
    pub fn push_hatches(&mut self, class: MarkClass, frame: HatchFrame, lines: &[HatchLine]) {
        if lines.is_empty() {
            return;
        }
        // A layer has a handful of frames: one for each class and island angle.
        let number = self.frames.iter().position(|known| *known == frame).unwrap_or_else(|| {
            self.frames.push(frame);
            self.frames.len() - 1
        });
        self.lines.extend_from_slice(lines);
        self.runs.push(Stored { class, frame: Some(number as u32), end: self.lines.len() });
    }

    /// Adds all vectors of others behind these.
    pub fn append(&mut self, others: &Self) {
        for (class, run) in others.runs() {
            match run {
                Run::Path(points_um) => self.push_path(class, points_um),
                Run::Hatches(frame, lines) => self.push_hatches(class, *frame, lines),
            }
        }
    }

    /// Makes room for this many more runs, points of paths and hatches, so that adding them does not take more memory than they need.
    pub fn reserve(&mut self, [runs, points, hatches]: [usize; 3]) {
        self.runs.reserve_exact(runs);
        self.points.reserve_exact(points);
        self.lines.reserve_exact(hatches);
    }

    /// Removes all vectors, and keeps the memory.
    pub fn clear(&mut self) {
        self.runs.clear();
        self.points.clear();
        self.frames.clear();
        self.lines.clear();
    }

    /// The runs in the order in which they are marked.
    pub fn runs(&self) -> impl Iterator<Item = (MarkClass, Run<'_>)> {
        let (mut point, mut line) = (0, 0);
        self.runs.iter().map(move |run| {
            let of = match run.frame {
                None => Run::Path(&self.points[std::mem::replace(&mut point, run.end)..run.end]),
                Some(frame) => {
                    let lines = &self.lines[std::mem::replace(&mut line, run.end)..run.end];
                    Run::Hatches(&self.frames[frame as usize], lines)
                }
            };
            (run.class, of)
        })
    }

    /// The vectors in the order in which they are marked.
    pub fn marks(&self) -> impl Iterator<Item = Mark> {
        self.runs().flat_map(|(class, run)| {
            let count = run.mark_count();
            (0..count).map(move |number| run.mark(class, number))
        })
    }

    /// Number of vectors.
    pub fn mark_count(&self) -> u64 {
        self.runs().map(|(_, run)| run.mark_count() as u64).sum()
    }

    /// Whether there are no vectors.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Memory, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.runs.capacity() * size_of::<Stored>()
            + self.points.capacity() * size_of::<[i32; 2]>()
            + self.frames.capacity() * size_of::<HatchFrame>()
            + self.lines.capacity() * size_of::<HatchLine>()
    }
}

impl Run<'_> {
    /// Number of vectors.
    pub fn mark_count(&self) -> usize {
        match self {
            Self::Path(points) => points.len().saturating_sub(1).max(1),
            Self::Hatches(_, lines) => lines.len(),
        }
    }

    /// A vector by its number, less than [`Run::mark_count`].
    fn mark(&self, class: MarkClass, number: usize) -> Mark {
        match *self {
            Self::Path(points) => {
                let (from_um, to_um) = (points[number], points[(number + 1).min(points.len() - 1)]);
                Mark { class, from_um, to_um }
            }
            Self::Hatches(frame, lines) => {
                let HatchLine { line, from_um, to_um } = lines[number];
                let [from_um, to_um] = [from_um, to_um].map(|along_um| frame.point_um(line, along_um));
                Mark { class, from_um, to_um }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_come_in_order_with_points_and_hatches() {
        let mut vectors = Vectors::default();
        vectors.push_path(MarkClass::Contour, &[[0, 0], [10, 0], [0, 10], [0, 0]]);
        let frame = hatch_frame([100, 200], 90.0, 60_000);
        let lines = [HatchLine { line: 0, from_um: 0, to_um: 50 }, HatchLine { line: 1, from_um: 50, to_um: -5 }];
        vectors.push_hatches(MarkClass::Hatch, frame, &lines);
        vectors.push_path(MarkClass::Point, &[[7, 8]]);
        vectors.push_path(MarkClass::Thin, &[]);
        let marks: Vec<_> = vectors.marks().map(|mark| (mark.class, mark.from_um, mark.to_um)).collect();
        assert_eq!(
            marks,
            [
                (MarkClass::Contour, [0, 0], [10, 0]),
                (MarkClass::Contour, [10, 0], [0, 10]),
                (MarkClass::Contour, [0, 10], [0, 0]),
                (MarkClass::Hatch, [100, 200], [100, 250]),
                // Left of a line that points along y is towards smaller x.
                (MarkClass::Hatch, [40, 250], [40, 195]),
                (MarkClass::Point, [7, 8], [7, 8]),
            ]
        );
        assert_eq!(vectors.mark_count(), 6);
    }

    #[test]
    fn points_of_a_frame_are_within_half_a_micrometre() {
        for angle_deg in [0.0, 13.7, 67.0, 134.0, 201.0, -90.0, 359.9] {
            let frame = hatch_frame([-5000, 70_000], angle_deg, 61_234);
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            for (line, along_um) in [(0, 0), (1, 1), (-700, 250_000), (4000, -120_000)] {
                let across_um = f64::from(line) * 61.234;
                let exact = [
                    -5000.0 + cos * f64::from(along_um) - sin * across_um,
                    70_000.0 + sin * f64::from(along_um) + cos * across_um,
                ];
                let found = frame.point_um(line, along_um);
                for axis in 0..2 {
                    assert!((f64::from(found[axis]) - exact[axis]).abs() < 0.501, "{angle_deg} {found:?} {exact:?}");
                }
            }
        }
    }
}
