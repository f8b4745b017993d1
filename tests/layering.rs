//! Which module may know which. The table is the architecture; this test compares it with the imports in the sources. And every source
//! says where its subject is used or tested.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What each module may import, of the modules in this table. A module may always import itself and [`BASE`]. The crate `layerd-wire`
/// stands below all of them: it is a package of its own and cannot import any.
const MAY_KNOW: &[(&str, &[&str])] = &[
    ("layer", &[]),
    ("solid", &[]),
    ("stream", &[]),
    ("buildfile", &["solid"]),
    ("slice", &["layer", "solid", "buildfile", "stream"]),
    ("link", &[]),
    ("config", &["layer", "link"]),
    ("device", &["layer", "link", "config"]),
    ("pipeline", &["layer", "buildfile", "slice", "stream", "link", "config", "device"]),
    ("job", &["link", "config", "device"]),
    ("api", &["job"]),
    ("daemon", &["stream", "link", "config", "device", "pipeline", "job", "api"]),
    (
        "cli",
        &[
            "layer",
            "solid",
            "buildfile",
            "slice",
            "stream",
            "link",
            "config",
            "device",
            "pipeline",
            "job",
            "api",
            "daemon",
        ],
    ),
];

/// Small tools that know none of the above; every module may use them.
const BASE: &[&str] = &["codec", "deadline", "disk", "output", "random", "signals", "system", "text"];

/// An import: the line it stands on, counted from 1, and the module it names.
type Import = (usize, String);

/// Modules of this crate that a source names, as `crate::name` or `crate::{name, …}`; comments do not count.
fn imports(source: &str) -> Vec<Import> {
    let mut found = Vec::new();
    let code: String = source.lines().map(|line| line.split("//").next().unwrap_or("").to_owned() + "\n").collect();
    for (at, root) in code.match_indices("crate::") {
        // Another crate's root, as in `$crate::` or `my_crate::`, is not this one's.
        if code[..at].ends_with(|before: char| before == '$' || before == '_' || before.is_alphanumeric()) {
            continue;
        }
        let line = code[..at].matches('\n').count() + 1;
        let rest = &code[at + root.len()..];
        let names = rest.strip_prefix('{').map_or_else(|| vec![name(rest)], names_of_group);
        found.extend(names.into_iter().filter(|name| !name.is_empty()).map(|name| (line, name)));
    }
    found
}

/// The first name of each path in a group, from behind its opening brace.
fn names_of_group(group: &str) -> Vec<String> {
    let (mut depth, mut begins, mut names) = (0, true, Vec::new());
    for (at, letter) in group.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => begins = true,
            _ if begins && depth == 0 && !letter.is_whitespace() => {
                names.push(name(&group[at..]));
                begins = false;
            }
            _ => {}
        }
    }
    names
}

fn name(path: &str) -> String {
    path.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect()
}

/// A line for each import of a source of `module` that the table does not allow.
fn violations(module: &str, place: &Path, source: &str) -> String {
    let allowed = MAY_KNOW.iter().find(|(name, _)| *name == module).map_or(&[][..], |(_, allowed)| allowed);
    let mut told = String::new();
    for (line, import) in imports(source) {
        let is_module = MAY_KNOW.iter().any(|(name, _)| *name == import);
        if is_module && import != module && !allowed.contains(&import.as_str()) {
            writeln!(told, "{}:{line}: `{module}` must not know `{import}`", place.display()).expect("a string");
        }
    }
    told
}

/// All sources below a directory, or the one file.
fn sources(place: &Path) -> Vec<PathBuf> {
    if place.is_file() {
        return vec![place.into()];
    }
    let entries = std::fs::read_dir(place).unwrap_or_else(|error| panic!("{}: {error}", place.display()));
    let mut found: Vec<_> = entries.flat_map(|entry| sources(&entry.expect("an entry").path())).collect();
    found.retain(|path| path.extension().is_some_and(|extension| extension == "rs"));
    found.sort();
    found
}

/// The modules that stand beside `lib.rs`.
fn modules() -> Vec<(String, PathBuf)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let entries = std::fs::read_dir(&root).expect("the sources").map(|entry| entry.expect("an entry").path());
    let mut modules: Vec<_> = entries
        .map(|path| (path.file_stem().expect("a name").to_string_lossy().into_owned(), path))
        .filter(|(name, _)| name != "lib" && name != "bin")
        .collect();
    modules.sort();
    modules
}

#[test]
fn every_module_imports_only_what_it_may_know() {
    let mut told = String::new();
    for (module, place) in modules() {
        let known = MAY_KNOW.iter().any(|(name, _)| *name == module) || BASE.contains(&module.as_str());
        assert!(known, "src/{module} stands in no table of tests/layering.rs: say there what it may know");
        for file in sources(&place) {
            let source = std::fs::read_to_string(&file).expect("a source");
            let short = file.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap_or(&file);
            told += &violations(&module, short, &source);
        }
    }
    assert!(told.is_empty(), "{told}ARCHITECTURE.md says which module may know which, and why");
}

/// A module lower in the table is known by none above it, so there are no circles between modules.
#[test]
fn the_table_has_no_circles() {
    for (at, (module, allowed)) in MAY_KNOW.iter().enumerate() {
        let above: Vec<_> = MAY_KNOW[..at].iter().map(|(name, _)| name).collect();
        for known in *allowed {
            assert!(above.contains(&known), "`{module}` may know `{known}`, which does not stand above it");
        }
    }
}

#[test]
fn a_planted_import_is_found_with_its_place() {
    let place = Path::new("src/solid/planted.rs");
    let planted = "//! Says crate::daemon in a comment only.\nuse crate::text;\n\nuse crate::{\n    output::Output,\n    daemon::{Api, Log},\n};\n";
    assert_eq!(violations("solid", place, planted), "src/solid/planted.rs:4: `solid` must not know `daemon`\n");
    let inline = "fn f() { crate::job::Engine::new(); my_crate::daemon::f(); $crate::daemon::f() }";
    assert_eq!(violations("solid", place, inline), "src/solid/planted.rs:1: `solid` must not know `job`\n");
    assert_eq!(violations("daemon", place, inline), "");
    assert_eq!(
        violations("text", place, "use crate::solid::Beam;"),
        "src/solid/planted.rs:1: `text` must not know `solid`\n"
    );
}

/// The text of a file's `//!`.
fn module_doc(source: &str) -> String {
    source.lines().filter_map(|line| line.strip_prefix("//!")).map(|line| line.to_owned() + "\n").collect()
}

/// What stands between backticks in a text, code blocks left out.
fn quoted(text: &str) -> Vec<&str> {
    let prose = text.split("```").step_by(2);
    prose.flat_map(|prose| prose.split('`').skip(1).step_by(2)).collect()
}

/// Whether a text has an example, or names a place where its subject is used or tested.
fn says_where(doc: &str) -> bool {
    doc.contains("```") || doc.contains("](") || !quoted(doc).is_empty()
}

/// Paths in the text of `file` that name no file: neither from its own folder nor from one above that, up to the root.
fn missing_paths<'a>(doc: &'a str, file: &Path) -> Vec<&'a str> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let is_path = |name: &&str| {
        let is_file = name.contains('/') && name.ends_with(".rs") && !name.contains([' ', ':', '*']);
        is_file || ["tests/", "docs/"].iter().any(|folder| name.starts_with(folder))
    };
    let is_there = |name: &str| {
        let mut folders = file.ancestors().skip(1).take_while(|folder| folder.starts_with(root));
        folders.any(|folder| folder.join(name).exists())
    };
    quoted(doc).into_iter().filter(is_path).filter(|name| !is_there(name)).collect()
}

#[test]
fn every_source_says_where_to_see_it_and_names_only_files_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut told = String::new();
    for file in [root.join("src"), root.join("wire/src")].iter().flat_map(|folder| sources(folder)) {
        let source = std::fs::read_to_string(&file).expect("a source");
        let short = file.strip_prefix(root).unwrap_or(&file).display();
        // A crate whose documentation is its README.
        if source.starts_with("#![doc = include_str!") {
            continue;
        }
        let doc = module_doc(&source);
        if !says_where(&doc) {
            writeln!(told, "{short}: its `//!` has no example and names no place where it is used or tested")
                .expect("a string");
        }
        for path in missing_paths(&doc, &file) {
            writeln!(told, "{short}: its `//!` names `{path}`, which is not there").expect("a string");
        }
    }
    assert!(told.is_empty(), "{told}");
}

#[test]
fn a_source_that_says_nothing_and_a_missing_file_are_found() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/solid/planted.rs");
    assert!(!says_where(&module_doc("//! Struts.\n\n/// `tests/solid.rs` tests this item.\nstruct A;\n")));
    assert!(says_where("Struts.\n```\nlet a = 1;\n```\n") && says_where("Struts. `tests/solid.rs` tests them."));
    assert!(says_where("Struts. [`solid`](crate::solid) has an example.") && says_where("The [example](crate)."));
    let doc =
        "`tests/solid.rs`, `solid/union.rs`, `union.rs`, `convolution/cut.rs`, `tests/gone.rs` and `solid/gone.rs`";
    assert_eq!(missing_paths(doc, &file), ["tests/gone.rs", "solid/gone.rs"]);
    assert!(missing_paths("```\n`tests/gone.rs`\n```", &file).is_empty(), "an example is not prose");
}
