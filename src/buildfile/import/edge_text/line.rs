//! One line of edge text: its numbers, and errors that repeat the line. `tests/pack_text.rs` shows them.

use std::path::Path;

use glam::DVec3;

use crate::buildfile::error::PackError;
use crate::buildfile::import::lane::Beam;
use crate::buildfile::import::materials::{MaterialNames, Mixture};
use crate::buildfile::model::Caps;

/// Longest line, bytes. Seven numbers of 17 digits take 175.
pub(super) const MAX_LINE_BYTES: usize = 1024;

/// Longest text that an error repeats, characters: enough to find the line, and still one line of a terminal.
const MAX_QUOTE_CHARS: usize = 40;

/// Numbers in the line of a strut: two points and a radius.
const FIELDS: usize = 7;

/// A line as it should be.
const STRUT: &str = "a strut is `x1 y1 z1 x2 y2 z2 [radius [material [material2]]]`";

/// An error with its line. Of several errors, the first in the file is reported.
pub(super) struct LineError {
    pub(super) line: u64,
    pub(super) error: PackError,
}

impl LineError {
    /// An error that names file and line and repeats the line.
    pub(super) fn at(path: &Path, line: u64, text: &[u8], problem: &str) -> Self {
        let text = String::from_utf8_lossy(&text[..text.len().min(MAX_LINE_BYTES)]);
        let problem = format!("{problem}; the line reads `{}`", quote(text.trim_ascii()));
        Self { line, error: PackError::input(place(path, line), problem) }
    }
}

/// The lines of a block, each with its end: LF, CR LF or CR.
pub(super) fn lines(mut bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let (line, rest) = bytes.split_at(line_length(bytes));
        bytes = rest;
        (!line.is_empty()).then_some(line)
    })
}

/// The length of the first line of `bytes`, including its end.
pub(super) fn line_length(bytes: &[u8]) -> usize {
    memchr::memchr2(b'\n', b'\r', bytes).map_or(bytes.len(), |end| behind_end(bytes, end))
}

/// Offset of the next line, if this line's text ends at `end`.
fn behind_end(bytes: &[u8], end: usize) -> usize {
    end + if bytes[end..].starts_with(b"\r\n") { 2 } else { 1 }
}

/// Whether a line is blank or a comment.
pub(super) fn is_blank(line: &[u8]) -> bool {
    let text = line.trim_ascii();
    text.is_empty() || text.starts_with(b"#") || text.starts_with(b"//")
}

/// `FILE:LINE`.
pub(super) fn place(path: &Path, line: u64) -> String {
    format!("{}:{line}", path.display())
}

/// The first line: `count radius [convolution_radius [kernel_size]]`.
pub(super) struct Header {
    pub(super) count: u64,
    pub(super) radius: f64,
    pub(super) convolution_radius: Option<f64>,
}

impl Header {
    /// Parses the first line.
    ///
    /// # Errors
    /// A text that says what was found and what is expected.
    pub(super) fn parse(line: &[u8]) -> Result<Self, String> {
        const EXPECTED: &str = "the first line must be `count radius convolution_radius kernel_size`";
        let mut fields = text(line)?.split_ascii_whitespace();
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

/// The numbers in the line of a strut, and the material at each end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Numbers<'a> {
    values: [f64; FIELDS],
    count: usize,
    materials: Option<[&'a str; 2]>,
}

impl<'a> Numbers<'a> {
    /// Parses the first line of `bytes` if it contains only plain decimals, as nearly every line does. Returns the numbers and the length
    /// of the line. `None` if it needs [`Numbers::parse`], for an error or an exponent.
    pub(super) fn plain(bytes: &[u8]) -> Option<(Self, usize)> {
        let mut numbers = Self::default();
        let mut at = 0;
        loop {
            match bytes.get(at) {
                None => return Some((numbers, at)),
                Some(b'\n' | b'\r') => return Some((numbers, behind_end(bytes, at))),
                Some(b' ' | b'\t') => at += 1,
                Some(_) => {
                    let value = numbers.values.get_mut(numbers.count)?;
                    (*value, at) = plain_decimal(bytes, at)?;
                    numbers.count += 1;
                }
            }
        }
    }

    /// Reads a line.
    ///
    /// # Errors
    /// A text that says what was found and what is expected.
    pub(super) fn parse(line: &'a [u8]) -> Result<Self, String> {
        let mut numbers = Self::default();
        if is_blank(line) {
            return Ok(numbers);
        }
        let mut fields = text(line)?.split_ascii_whitespace();
        for (value, field) in numbers.values.iter_mut().zip(&mut fields) {
            *value = number(field)?;
            numbers.count += 1;
        }
        if let Some(first) = fields.next() {
            if first.parse::<f64>().is_ok() {
                return Err(format!("`{}` after the radius, which is no name of a material; {STRUT}", quote(first)));
            }
            numbers.materials = Some([first, fields.next().unwrap_or(first)]);
        }
        if fields.next().is_some() {
            return Err(format!("more than 9 fields; {STRUT}"));
        }
        Ok(numbers)
    }

    /// Whether the line was blank or a comment.
    pub(super) fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The strut.
    ///
    /// # Errors
    /// A text that says what is wrong with the numbers.
    pub(super) fn strut(&self, default_radius: f64, names: &MaterialNames) -> Result<Beam, String> {
        let [x1, y1, z1, x2, y2, z2, stated_radius] = self.values;
        let radius = match self.count {
            6 => default_radius,
            FIELDS => stated_radius,
            count => return Err(format!("{count} fields; {STRUT}")),
        };
        if radius <= 0.0 {
            let whose = if self.count == FIELDS { "" } else { ", from the first line" };
            return Err(format!("radius {radius}{whose}; it must be greater than 0"));
        }
        let mixture = self.materials.map(|ends| mixture(ends, names)).transpose()?;
        let (a, b) = (DVec3::new(x1, y1, z1), DVec3::new(x2, y2, z2));
        Ok(Beam { a, b, radius_a: radius, radius_b: radius, caps: Caps::default(), mixture })
    }
}

/// What a strut consists of, whose ends are of these materials.
fn mixture(ends: [&str; 2], names: &MaterialNames) -> Result<Mixture, String> {
    let [a, b] = ends;
    let a = Mixture::of(names.number(a)?);
    Ok(if ends[0] == ends[1] { a } else { Mixture::between(&a, &Mixture::of(names.number(b)?)) })
}

/// Powers of ten that an `f64` represents exactly, as many as a number below 2⁵³ has digits.
const POWERS: [f64; 17] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16];

/// Parses `[-]digits[.digits]`. Returns the number and the offset of its end. The quotient of two exact numbers is correctly rounded
/// (Clinger 1990, "How to read floating point numbers accurately"). `None` if there are too many digits for that, or another notation.
fn plain_decimal(bytes: &[u8], mut at: usize) -> Option<(f64, usize)> {
    let negative = bytes.get(at) == Some(&b'-');
    at += usize::from(negative);
    let begin = at;
    let mut mantissa = 0u64;
    let mut digits = |at: &mut usize| {
        while let Some(digit) = bytes.get(*at).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit < 10) {
            // May wrap if there are too many digits, which is checked below.
            mantissa = mantissa.wrapping_mul(10).wrapping_add(digit.into());
            *at += 1;
        }
    };
    digits(&mut at);
    let (mut count, mut decimals) = (at - begin, 0);
    if bytes.get(at) == Some(&b'.') {
        at += 1;
        let begin = at;
        digits(&mut at);
        decimals = at - begin;
        count += decimals;
    }
    let ended = matches!(bytes.get(at), None | Some(b' ' | b'\n' | b'\t' | b'\r'));
    if !ended || !(1..POWERS.len()).contains(&count) || mantissa > 1 << 53 {
        return None;
    }
    let value = mantissa as f64 / POWERS[decimals];
    Some((if negative { -value } else { value }, at))
}

fn number(field: &str) -> Result<f64, String> {
    let value = field.parse().map_err(|_| format!("`{}` is not a number", quote(field)))?;
    if f64::is_finite(value) { Ok(value) } else { Err(format!("`{}` is not a finite number", quote(field))) }
}

fn text(line: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(line).map_err(|_| "the line is not text; a compressed file must be unpacked first".into())
}

fn quote(text: &str) -> String {
    let mut quoted: String = text.chars().take(MAX_QUOTE_CHARS).flat_map(char::escape_default).collect();
    if text.chars().nth(MAX_QUOTE_CHARS).is_some() {
        quoted.push('…');
    }
    quoted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_decimals_are_read_as_the_standard_library_reads_them() {
        let mut state = 1u64;
        for round in 0..20_000usize {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let mut digits = format!("{}", state >> (round % 64));
            digits.insert(digits.len().saturating_sub(round % 20), '.');
            let text = format!("{}{digits}", ["", "-"][round % 2]);
            if let Some((value, length)) = plain_decimal(text.as_bytes(), 0) {
                assert_eq!((value.to_bits(), length), (text.parse::<f64>().expect("a number").to_bits(), text.len()));
            }
        }
        assert_eq!(
            plain_decimal(b"-0.000 7", 0).map(|(value, end)| (value.to_bits(), end)),
            Some(((-0.0f64).to_bits(), 6))
        );
        assert_eq!(plain_decimal(b"12.3456\r\n", 0), Some((12.3456, 7)));
    }

    #[test]
    fn whatever_is_no_plain_decimal_is_left_to_the_whole_parser() {
        for text in
            ["", "-", ".", "1e5", "+1", "nan", "0x1", "1.2.3", "--1", "99999999999999999", "0.00000000000000001"]
        {
            assert_eq!(plain_decimal(text.as_bytes(), 0), None, "{text}");
        }
        assert!(Numbers::plain(b"1 2 3 4 5 6 7 8\n").is_none());
        let line = b"1 -2.5\t3 4e0 5 6 7\r\n1";
        assert!(Numbers::plain(line).is_none());
        let (plain, length) = Numbers::plain(b"1 -2.5\t3 4 5 6 7\r\n1").expect("is plain");
        assert_eq!((plain, length), (Numbers::parse(&line[..20]).expect("is fine"), 18));
    }
}
