//! Names of parts in a package, compared as the Open Packaging Conventions (ECMA-376, part 2) require. `package` looks parts up with it.

use std::borrow::Cow;

use percent_encoding::percent_decode_str;

/// The name, without a leading slash, of the part that `reference` names relative to the root of the package. Backslashes count as
/// slashes, percent-encoded bytes are decoded, and `.`, `..` and empty segments are resolved. `..` at the root has no effect, so nothing
/// outside the package can be named.
pub(super) fn resolve(reference: &str) -> String {
    // If the decoded bytes are not valid text, the reference is used as it is.
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

/// The form in which names are compared: names that differ only in the case of ASCII letters are equal.
pub(super) fn key(name: &str) -> String {
    name.to_ascii_lowercase()
}
