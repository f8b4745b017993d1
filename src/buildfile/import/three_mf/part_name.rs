//! Names of parts in a package, as the Open Packaging Conventions compare them.

use std::borrow::Cow;

use percent_encoding::percent_decode_str;

/// The name, without a leading slash, of the part that `reference` names from the root of the package: backslashes are slashes,
/// percent-encoded bytes are decoded, and `.`, `..` and empty segments are resolved. A `..` at the root stays there: nothing
/// outside of the package can be named.
pub(super) fn resolve(reference: &str) -> String {
    // What is no text once decoded is taken as it stands.
    let decoded = percent_decode_str(reference).decode_utf8().unwrap_or(Cow::Borrowed(reference)).replace('\\', "/");
    let mut segments = Vec::new();
    for segment in decoded.split('/') {
        match segment {
            "" | "." => {}
            ".." => {
                segments.pop();
            }
            _ => segments.push(segment),
        }
    }
    segments.join("/")
}

/// A name to compare with: part names that differ only in the case of ASCII letters are one name.
pub(super) fn key(name: &str) -> String {
    name.to_ascii_lowercase()
}
