//! `docs/reliability.md` names only tests and invariants that there are, and every invariant.

use std::path::{Path, PathBuf};

use crate::truth::INVARIANTS;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).into()
}

/// What stands between each pair of marks.
fn between<'a>(text: &'a str, mark: &str) -> Vec<&'a str> {
    text.split(mark).skip(1).step_by(2).collect()
}

/// The sources of a test target.
fn sources(target: &str) -> String {
    let file = root().join("tests").join(format!("{target}.rs"));
    let directory = root().join("tests").join(target);
    let listed = std::fs::read_dir(directory).into_iter().flatten();
    let files = listed.map(|entry| entry.expect("listed").path()).chain([file]);
    files.filter_map(|path| std::fs::read_to_string(path).ok()).collect()
}

#[test]
fn the_document_names_tests_that_there_are() {
    let text = std::fs::read_to_string(root().join("docs/reliability.md")).expect("the document");
    let lines = || text.lines().filter(|line| line.starts_with('|'));
    let tests: Vec<_> = lines().flat_map(|line| between(line, "`")).filter_map(|name| name.split_once("::")).collect();
    assert!(tests.len() > 30, "{tests:?}");
    for (target, name) in tests {
        assert!(sources(target).contains(&format!("fn {name}(")), "there is no test {target}::{name}");
    }
    let mut named: Vec<_> = lines().flat_map(|line| between(line, "*")).collect();
    named.sort_unstable();
    named.dedup();
    let mut invariants = INVARIANTS.to_vec();
    invariants.sort_unstable();
    assert_eq!(named, invariants);
}
