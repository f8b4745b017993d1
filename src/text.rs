//! Makes text from outside safe to show: names of files and jobs, and texts of a device.
//!
//! A terminal obeys control characters, and bidirectional controls and other invisible characters can make a text look like
//! another. All of them are escaped. Messages of the daemon, the log and `layerctl` pass through it.

use std::borrow::Cow;
use std::io::Write;

/// Longest name that is shown, characters: it fits a terminal's line together with a job's number, state and layers.
const MAX_NAME_CHARS: usize = 48;
/// Characters shown of the end of a shortened name, where numbers and extensions are.
const END_SHOWN: usize = 16;

/// Whether a terminal obeys or hides the character: controls (Unicode `Cc`), format characters (`Cf`), and line and paragraph
/// separators (`Zl`, `Zp`).
pub(crate) fn is_hidden(character: char) -> bool {
    character.is_control()
        || matches!(
            u32::from(character),
            0xAD | 0x600..=0x605
                | 0x61C
                | 0x6DD
                | 0x70F
                | 0x890..=0x891
                | 0x8E2
                | 0x180E
                | 0x200B..=0x200F
                | 0x2028..=0x202E
                | 0x2060..=0x206F
                | 0xFEFF
                | 0xFFF9..=0xFFFB
                | 0x110BD
                | 0x110CD
                | 0x13430..=0x1343F
                | 0x1BCA0..=0x1BCA3
                | 0x1D173..=0x1D17A
                | 0xE0001
                | 0xE0020..=0xE007F
        )
}

/// Escapes hidden characters as Rust does (`\u{202e}`); line breaks stay.
pub(crate) fn plain(text: &str) -> String {
    escaped(text, |character| character != '\n' && is_hidden(character))
}

/// Like [`plain`], but escapes line breaks too, so that the text stays on one line.
pub(crate) fn plain_line(text: &str) -> String {
    escaped(text, is_hidden)
}

/// The name of a job, part or recipe as lists show it: on one line, and shortened in its middle if it is too long.
pub(crate) fn short_name(name: &str) -> String {
    let name = plain_line(name);
    let length = name.chars().count();
    if length <= MAX_NAME_CHARS {
        return name;
    }
    let begin = MAX_NAME_CHARS - END_SHOWN - 1;
    let (first, last) = (name.chars().take(begin), name.chars().skip(length - END_SHOWN));
    first.chain(['…']).chain(last).collect()
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> String {
    let mut plain = String::with_capacity(text.len());
    for character in text.chars() {
        if is_escaped(character) {
            plain.extend(character.escape_default());
        } else {
            plain.push(character);
        }
    }
    plain
}

/// A size in the largest unit that fits: `17 bytes`, `1.4 KiB`, `18.9 MiB`, `3.0 GiB`.
pub(crate) fn size_text(bytes: u64) -> String {
    let unit = match bytes {
        0..1024 => return count_text(bytes, "byte"),
        1024..0x10_0000 => ("KiB", 10),
        0x10_0000..0x4000_0000 => ("MiB", 20),
        _ => ("GiB", 30),
    };
    format!("{:.1} {}", bytes as f64 / f64::from(1 << unit.1), unit.0)
}

/// A plate height, given in micrometres: `10.539 mm`, in one form everywhere.
pub(crate) fn mm_text(um: impl Into<f64>) -> String {
    format!("{:.3} mm", um.into() / 1000.0)
}

/// A layer as in `layer 3`, or `layer 3 (stiff)` if it names one of several materials.
pub(crate) fn layer_text(layer: u32, material: Option<&str>) -> String {
    material.map_or_else(|| format!("layer {layer}"), |material| format!("layer {layer} ({})", plain_line(material)))
}

/// A count and its noun, with a plural in -s: `1 layer`, `2 layers`.
pub(crate) fn count_text(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// Quotes a word for a shell if needed, so that a suggested command can be copied.
pub(crate) fn shell_word(word: &str) -> Cow<'_, str> {
    // Only a NUL cannot be quoted, and no path has one.
    shlex::try_quote(word).unwrap_or(Cow::Borrowed(word))
}

/// Writes one line to stderr, with hidden characters escaped. Errors are ignored, where `eprintln!` would panic.
pub(crate) fn eprint(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", plain(text));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_obeys_or_hides_is_escaped() {
        assert_eq!(plain("a\u{1b}[31mb\nc"), "a\\u{1b}[31mb\nc");
        assert_eq!(plain_line("a\nb\tc"), "a\\nb\\tc");
        for hidden in ['\u{202a}', '\u{202e}', '\u{2066}', '\u{2069}', '\u{200e}', '\u{200f}', '\u{61c}', '\u{feff}'] {
            let shown = plain(&format!("part{hidden}fdp"));
            assert_eq!(shown, format!("part\\u{{{:x}}}fdp", u32::from(hidden)));
        }
        for visible in ["Würfel 1.layerd", "部品", "Wu\u{308}rfel", "a \"quoted\" \\ name", "قطعة"] {
            assert_eq!(plain(visible), visible);
        }
    }

    #[test]
    fn sizes_and_counts_read_well() {
        let sizes = [0, 1, 1023, 1024, 1407, (1 << 20) - 1, 64 << 20, 3 << 30, 5 << 40].map(size_text);
        let expected = [
            "0 bytes",
            "1 byte",
            "1023 bytes",
            "1.0 KiB",
            "1.4 KiB",
            "1024.0 KiB",
            "64.0 MiB",
            "3.0 GiB",
            "5120.0 GiB",
        ];
        assert_eq!(sizes, expected);
        assert_eq!([0, 1, 2].map(|count| count_text(count, "layer")), ["0 layers", "1 layer", "2 layers"]);
    }

    #[test]
    fn a_plate_height_has_one_form() {
        assert_eq!([10_539, 30_000, 0].map(mm_text), ["10.539 mm", "30.000 mm", "0.000 mm"]);
    }

    #[test]
    fn a_word_for_a_shell_is_quoted_where_it_must_be() {
        assert_eq!(shell_word("/run/layerd/control.sock"), "/run/layerd/control.sock");
        assert_eq!(shell_word("my part.layerd"), "'my part.layerd'");
    }

    #[test]
    fn a_long_name_is_shortened_in_its_middle() {
        assert_eq!(short_name("part.layerd"), "part.layerd");
        let shown = short_name(&format!("{}_0042.layerd", "ü".repeat(200)));
        assert_eq!(shown.chars().count(), MAX_NAME_CHARS);
        assert!(shown.starts_with("üüü") && shown.contains('…') && shown.ends_with("_0042.layerd"), "{shown}");
        assert_eq!(short_name("a\nb"), "a\\nb");
    }
}
