//! Edge text: a line `count radius convolution_radius kernel_size`, then one strut a line, `x1 y1 z1 x2 y2 z2 [radius]`,
//! millimetres, in any order. As written by GPULatticeSlicer.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use glam::DVec3;

use crate::buildfile::collect::{Beam, Collector};
use crate::buildfile::model::Caps;
use crate::buildfile::pack::{PackError, PackOptions};

/// Longest line: seven numbers of 17 digits take 175 bytes.
const LINE_LIMIT_BYTES: u64 = 1024;

/// Most of a line that an error repeats.
const QUOTE_LIMIT_CHARS: usize = 40;

/// Reads one file.
///
/// # Errors
/// [`PackError`] names file and line, and repeats what stands there.
pub(super) fn import(
    path: &Path,
    _options: &PackOptions,
    collector: &mut Collector<'_>,
    progress: &mut dyn FnMut(u64),
) -> Result<(), PackError> {
    let file = File::open(path).map_err(|source| PackError::Read { path: path.into(), source })?;
    let mut lines =
        Lines { path, reader: BufReader::with_capacity(64 << 10, file), number: 0, bytes: 0, line: Vec::new() };
    let header = match lines.next()? {
        Some(text) => Header::parse(text).map_err(|problem| lines.error(&problem))?,
        None => return Err(PackError::input(path.display().to_string(), "the file is empty")),
    };
    if let Some(support_mm) = header.convolution_radius.filter(|radius| *radius > 0.0) {
        collector.stated_support(path.display().to_string(), support_mm);
    }
    let mut count = 0u64;
    while let Some(text) = lines.next()? {
        if count == header.count {
            return Err(lines.error(&format!("the first line announces {} struts, but there are more", header.count)));
        }
        let beam = parse_strut(text, header.radius).map_err(|problem| lines.error(&problem))?;
        collector.beam(&beam, &|| lines.place())?;
        count += 1;
        if count.is_multiple_of(1 << 14) {
            progress(lines.bytes);
        }
    }
    if count != header.count {
        let problem =
            format!("the first line announces {} struts, but {count} follow; is the file cut short?", header.count);
        return Err(PackError::input(path.display().to_string(), problem));
    }
    Ok(())
}

struct Header {
    count: u64,
    radius: f64,
    convolution_radius: Option<f64>,
}

impl Header {
    fn parse(text: &str) -> Result<Self, String> {
        const EXPECTED: &str = "the first line must be `count radius convolution_radius kernel_size`";
        let mut fields = text.split_ascii_whitespace();
        let mut field = |name: &str| fields.next().ok_or_else(|| format!("{EXPECTED}; {name} is missing"));
        let (count, radius) = (field("count")?, field("radius")?);
        let count = count.parse().map_err(|_| format!("{EXPECTED}; count is `{}`", quote(count)))?;
        let radius = number(radius)?;
        let rest = fields.map(number).collect::<Result<Vec<_>, _>>()?;
        if rest.len() > 2 {
            return Err(format!("{EXPECTED}; there are {} fields", rest.len() + 2));
        }
        Ok(Self { count, radius, convolution_radius: rest.first().copied() })
    }
}

fn parse_strut(text: &str, default_radius: f64) -> Result<Beam, String> {
    let mut values = [0.0; 7];
    let mut count = 0;
    for field in text.split_ascii_whitespace() {
        let value = values.get_mut(count).ok_or("more than 7 fields; a strut is `x1 y1 z1 x2 y2 z2 [radius]`")?;
        *value = number(field)?;
        count += 1;
    }
    let radius = match count {
        6 => default_radius,
        7 => values[6],
        _ => return Err(format!("{count} fields; a strut is `x1 y1 z1 x2 y2 z2 [radius]`")),
    };
    if radius <= 0.0 {
        return Err(format!("radius {radius}; it must be greater than 0"));
    }
    let [x1, y1, z1, x2, y2, z2, _] = values;
    let (a, b) = (DVec3::new(x1, y1, z1), DVec3::new(x2, y2, z2));
    if a == b {
        return Err("the strut has no length: both ends are the same point".into());
    }
    Ok(Beam { a, b, radius_a: radius, radius_b: radius, caps: Caps::default() })
}

fn number(field: &str) -> Result<f64, String> {
    let value = field.parse().map_err(|_| format!("`{}` is not a number", quote(field)))?;
    if f64::is_finite(value) { Ok(value) } else { Err(format!("`{}` is not a finite number", quote(field))) }
}

fn quote(text: &str) -> String {
    let mut quoted: String = text.chars().take(QUOTE_LIMIT_CHARS).flat_map(char::escape_default).collect();
    if text.chars().nth(QUOTE_LIMIT_CHARS).is_some() {
        quoted.push('…');
    }
    quoted
}

/// Lines of bounded length, numbered from 1; blank ones are passed over.
struct Lines<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    number: u64,
    bytes: u64,
    line: Vec<u8>,
}

impl Lines<'_> {
    fn next(&mut self) -> Result<Option<&str>, PackError> {
        loop {
            self.line.clear();
            let read = self.reader.by_ref().take(LINE_LIMIT_BYTES).read_until(b'\n', &mut self.line);
            let length = read.map_err(|source| PackError::Read { path: self.path.into(), source })?;
            if length == 0 {
                return Ok(None);
            }
            self.number += 1;
            self.bytes += length as u64;
            if length as u64 == LINE_LIMIT_BYTES && self.line.last() != Some(&b'\n') {
                return Err(
                    self.error(&format!("the line is longer than {LINE_LIMIT_BYTES} bytes; is this edge text?"))
                );
            }
            if !self.line.trim_ascii().is_empty() {
                break;
            }
        }
        match std::str::from_utf8(&self.line) {
            Ok(text) => Ok(Some(text)),
            Err(_) => Err(self.error("the line is not text")),
        }
    }

    fn place(&self) -> String {
        format!("{}:{}", self.path.display(), self.number)
    }

    fn error(&self, problem: &str) -> PackError {
        let text = String::from_utf8_lossy(self.line.trim_ascii());
        PackError::input(self.place(), format!("{problem}; the line reads `{}`", quote(&text)))
    }
}
