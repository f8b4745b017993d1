//! A layer of scan vectors as an SVG picture, to look at.
//!
//! One unit is a micrometre, y goes up, and lines are as wide as the beam. Jumps lie above them, thin and dotted.
//! `tests/export_vectors.rs` reads the files back.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::layer::{MarkClass, Run, Vectors};
use crate::output::Output;

/// Width of the lines of jumps, and length of their dots, micrometres.
const JUMP_WIDTH_UM: u32 = 4;
const JUMP_DOT_UM: u32 = 20;

/// Writes a layer. The picture shows the field, whose sides are `field_um`; the beam's diameter is `beam_um`. The file appears whole or
/// not at all, whatever ends the program.
///
/// # Errors
/// Whatever the file system says; nothing is left behind then.
pub fn write_svg(path: &Path, vectors: &Vectors, field_um: [u32; 2], beam_um: f64) -> io::Result<()> {
    let output = Output::create(path)?;
    let mut file = BufWriter::new(output.file());
    write(&mut file, vectors, field_um, beam_um)?;
    file.flush()?;
    drop(file);
    output.publish()
}

fn write(file: &mut impl Write, vectors: &Vectors, [width, height]: [u32; 2], beam_um: f64) -> io::Result<()> {
    let (width_mm, height_mm) = (f64::from(width) / 1000.0, f64::from(height) / 1000.0);
    writeln!(file, r#"<?xml version="1.0" encoding="UTF-8"?>"#)?;
    writeln!(
        file,
        r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width_mm}mm" height="{height_mm}mm" viewBox="0 0 {width} {height}">"#
    )?;
    writeln!(file, r##"<rect width="{width}" height="{height}" fill="#ffffff"/>"##)?;
    writeln!(
        file,
        r#"<g transform="matrix(1 0 0 -1 0 {height})" fill="none" stroke-linecap="round" stroke-linejoin="round">"#
    )?;
    writeln!(file, r#"<g stroke-width="{beam_um}">"#)?;
    let mut open = None;
    for (class, run) in vectors.runs() {
        // One element for the runs of a class that follow each other.
        if open != Some(class) {
            if open.is_some() {
                writeln!(file, r#""/>"#)?;
            }
            write!(file, r#"<path class="{}" stroke="{}" d=""#, name(class), colour(class))?;
            open = Some(class);
        }
        write_run(file, &run)?;
    }
    if open.is_some() {
        writeln!(file, r#""/>"#)?;
    }
    writeln!(file, "</g>")?;
    write!(
        file,
        r##"<path class="jump" stroke="#9e9e9e" stroke-width="{JUMP_WIDTH_UM}" stroke-dasharray="{JUMP_DOT_UM}" d=""##
    )?;
    write_jumps(file, vectors)?;
    writeln!(file, "\"/>\n</g>\n</svg>")
}

fn write_run(file: &mut impl Write, run: &Run<'_>) -> io::Result<()> {
    match run {
        // A line of no length with round ends is a dot.
        Run::Path([[x, y]]) => write!(file, "M{x} {y}h0"),
        Run::Path(points) => points.iter().enumerate().try_for_each(|(index, [x, y])| {
            let letter = if index == 0 { 'M' } else { 'L' };
            write!(file, "{letter}{x} {y}")
        }),
        Run::Hatches(frame, lines) => lines.iter().try_for_each(|line| {
            let [[x0, y0], [x1, y1]] = [line.from_um, line.to_um].map(|along_um| frame.point_um(line.line, along_um));
            write!(file, "M{x0} {y0}L{x1} {y1}")
        }),
    }
}

fn write_jumps(file: &mut impl Write, vectors: &Vectors) -> io::Result<()> {
    let mut last_um: Option<[i32; 2]> = None;
    for mark in vectors.marks() {
        let [x1, y1] = mark.from_um;
        if let Some([x0, y0]) = last_um.filter(|last_um| *last_um != mark.from_um) {
            write!(file, "M{x0} {y0}L{x1} {y1}")?;
        }
        last_um = Some(mark.to_um);
    }
    Ok(())
}

/// Name of a class in the file.
fn name(class: MarkClass) -> &'static str {
    match class {
        MarkClass::Contour => "contour",
        MarkClass::Hatch => "hatch",
        MarkClass::UpSkin => "up-skin",
        MarkClass::DownSkin => "down-skin",
        MarkClass::Thin => "thin",
        MarkClass::Point => "point",
    }
}

/// Colours that differ for people who do not tell red from green, too.
fn colour(class: MarkClass) -> &'static str {
    match class {
        MarkClass::Contour => "#0072b2",
        MarkClass::Hatch => "#e69f00",
        MarkClass::UpSkin => "#56b4e9",
        MarkClass::DownSkin => "#009e73",
        MarkClass::Thin => "#cc79a7",
        MarkClass::Point => "#d55e00",
    }
}
