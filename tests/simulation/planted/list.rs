//! Each planted bug fits the sources: its line is there, once. `planted.rs` shows that each is found.

mod bugs;

use std::collections::BTreeSet;
use std::path::Path;

use bugs::BUGS;

#[test]
fn every_planted_bug_changes_one_place_of_the_sources() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut names = BTreeSet::new();
    for bug in BUGS {
        assert!(names.insert(bug.name), "two bugs are called {:?}", bug.name);
        let text = std::fs::read_to_string(root.join(bug.file)).expect(bug.file);
        let count = text.matches(bug.was).count();
        assert_eq!(count, 1, "{:?}: {} has its code {count} times: {}", bug.name, bug.file, bug.was);
        assert!(!bug.becomes.contains(bug.was), "{:?} changes nothing", bug.name);
    }
}
