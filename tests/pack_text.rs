//! Edge text as editors and programs in the field write it.

mod pack_bench;

use layerd::buildfile::Strut;
use pack_bench::{Bench, said};

fn packed(bench: &Bench, bytes: &[u8]) -> (String, Vec<Strut>) {
    let packed = bench.pack(&bench.file("in.txt", bytes));
    let (report, struts) = packed.unwrap_or_else(|error| panic!("{error}: {:?}", String::from_utf8_lossy(bytes)));
    (report.notes.join("\n"), struts)
}

const TEXT: &str = "3 0.5\n0 0 0 0 0 5\n1e0 0 0 1 0 5 0.25\n-2 0 0 2 0 5\n";

#[test]
fn marks_comments_and_line_ends_of_any_editor_change_nothing() {
    let bench = Bench::new();
    let (_, expected) = packed(&bench, TEXT.as_bytes());
    let commented = "# made by a tool\n\n// 7 8 9\n3 0.5\n   # inside\n0 0 0 0 0 5\n\t// 1 2 3 4 5 6\n1e0 0 0 1 0 5 0.25\n//\n-2 0 0 2 0 5\n#";
    let long = format!("#{}\n{TEXT}//{}\n", "-".repeat(5000), "=".repeat(200_000));
    let latin1 = [b"# gr\xF6\xDFer\n".as_slice(), TEXT.as_bytes()].concat();
    let texts: Vec<Vec<u8>> = vec![commented.into(), long.into(), latin1, TEXT.trim_end().into()];
    for text in texts.iter().chain([&TEXT.into()]) {
        let with_ends = |end: &str| -> Vec<u8> {
            text.split_inclusive(|&byte| byte == b'\n')
                .flat_map(|line| match line.strip_suffix(b"\n") {
                    Some(line) => [line, end.as_bytes()].concat(),
                    None => line.to_vec(),
                })
                .collect()
        };
        for end in ["\n", "\r\n", "\r"] {
            for mark in ["", "\u{feff}"] {
                for padding in ["", "\0", "\u{1a}", "\n\u{1a}\0\0\n", "\r\n\u{1a}"] {
                    let bytes = [mark.as_bytes(), &with_ends(end), padding.as_bytes()].concat();
                    let (notes, struts) = packed(&bench, &bytes);
                    assert_eq!((struts, notes.as_str()), (expected.clone(), ""), "{end:?} {mark:?} {padding:?}");
                }
            }
        }
    }
}

#[test]
fn lines_are_counted_alike_whatever_ends_them() {
    let bench = Bench::new();
    // More than a block of 256 KiB, with line ends on both sides of its end.
    for end in ["\n", "\r\n", "\r", "\n\r", "\r\r\n"] {
        for shift in 0..3 {
            let count = 30_000;
            let mut text = format!("# {}{end}{count} 0.5{end}", "-".repeat(shift));
            for line in 0..count {
                text += &format!("{line} 0 0 {line} 0 5{end}");
            }
            let (_, struts) = packed(&bench, text.as_bytes());
            assert_eq!(struts.len(), count, "{end:?}");
            let line = 1 + (count + 1) * if end == "\n\r" || end == "\r\r\n" { 2 } else { 1 };
            let found = said(bench.text(&text.replace("29999 0 0", "29999 O O")));
            assert!(found.contains(&format!("in.txt:{line}: `O` is not a number")), "{end:?}: {found}");
            let found = said(bench.text(&text.replacen("30000 ", "29999 ", 1)));
            assert!(
                found.contains(&format!("in.txt:{line}: the first line announces 29999 struts")),
                "{end:?}: {found}"
            );
        }
    }
}

#[test]
fn what_is_no_text_to_its_end_is_refused_by_name() {
    let bench = Bench::new();
    for bytes in [u16::to_le_bytes as fn(u16) -> [u8; 2], u16::to_be_bytes] {
        let utf16: Vec<u8> = "\u{feff}".encode_utf16().chain(TEXT.encode_utf16()).flat_map(bytes).collect();
        let found = said(bench.pack(&bench.file("in.txt", &utf16)));
        assert!(found.contains("in.txt: the file is UTF-16 text") && found.contains("save it as UTF-8"), "{found}");
    }
    for mark in ["\0", "\u{1a}"] {
        let inside = TEXT.replace("\n1e0", &format!("\n{mark}1e0"));
        assert!(said(bench.text(&inside)).contains("in.txt:3: "));
        // The mark ends one block, and text begins another.
        let behind = format!("{TEXT}{}{TEXT}", mark.repeat(300 << 10));
        let found = said(bench.text(&behind));
        assert!(found.contains("in.txt:5: text follows after a NUL or Ctrl-Z"), "{found}");
        let (_, struts) = packed(&bench, format!("{TEXT}{}", mark.repeat(600 << 10)).as_bytes());
        assert_eq!(struts.len(), 3);
    }
    for nothing in ["\u{feff}", "# only a comment", "\0\0", "\r\r"] {
        assert!(said(bench.text(nothing)).contains("the file is empty"), "{nothing:?}");
    }
}

#[test]
fn struts_without_length_are_left_out_and_counted() {
    let bench = Bench::new();
    let (notes, struts) = packed(&bench, b"4 0.5\n0 0 0 0 0 5\n1 2 3 1 2 3\n1 2 3 1 2 3.0001\n9 9 9 9.0 9 9 0.1\n");
    assert_eq!(struts.len(), 1);
    assert!(notes.contains("left out 3 struts shorter than the file's resolution of 0.001 mm"), "{notes}");
    assert!(said(bench.text("1 0.5\n1 2 3 1 2 3\n")).contains("nothing to print (1 strut shorter"));
}
