//! Extensions that a package requires: which of them can be ignored without changing the shape. `structure` collects and checks them.

use super::space::Space;
use super::xml::{Foreign, check_uri, quote};

/// Most extensions that all parts of a package require, and most unknown namespaces that they use. Some twenty extensions exist.
const MAX_COUNT: usize = 256;

/// The extensions that the parts of a package require, and the unknown namespaces that they use.
#[derive(Debug, Default)]
pub(super) struct Extensions {
    /// Prefix and namespace of each.
    required: Vec<(String, String)>,
    used: Vec<Foreign>,
}

impl Extensions {
    /// Adds an extension that a part of the package requires by this prefix. `uri` is the namespace that the prefix is bound to.
    ///
    /// # Errors
    /// A text that says what is wrong with it.
    pub(super) fn require(&mut self, prefix: &str, uri: Option<&str>) -> Result<(), String> {
        let uri =
            uri.ok_or_else(|| format!("it requires the extension `{}`, but binds no namespace to it", quote(prefix)))?;
        check_uri(uri)?;
        if self.required.iter().all(|(_, known)| known != uri) {
            self.required.push((quote(prefix), uri.to_owned()));
        }
        check_count(self.required.len())
    }

    /// Adds the unknown namespaces that a part of the package uses.
    ///
    /// # Errors
    /// A text that says that there are too many.
    pub(super) fn found(&mut self, foreign: Vec<Foreign>) -> Result<(), String> {
        for one in foreign {
            if self.used.iter().all(|known| known.uri != one.uri) {
                self.used.push(one);
            }
        }
        check_count(self.used.len())
    }

    /// Returns a note for each required extension that is ignored.
    ///
    /// # Errors
    /// A text that names a required extension that is used and could change the shape.
    pub(super) fn check(&self, has_keystore: bool) -> Result<Vec<String>, String> {
        let mut notes = Vec::new();
        for (prefix, uri) in &self.required {
            match Space::of(uri) {
                Space::Shapeless => notes.push(format!(
                    "it requires the extension `{prefix}` ({uri}), which cannot change the shape: it was ignored"
                )),
                Space::Other => notes.push(self.check_unknown(prefix, uri, has_keystore)?),
                _ => {}
            }
        }
        Ok(notes)
    }

    fn check_unknown(&self, prefix: &str, uri: &str, has_keystore: bool) -> Result<String, String> {
        // Encrypted parts use it, and they cannot be read, so its use would not be found.
        if has_keystore && uri.contains("/3dmanufacturing/securecontent/") {
            return Err(format!(
                "it requires the extension `{prefix}` ({uri}), and the package holds a keystore: its parts may be encrypted; \
                 save it without encryption"
            ));
        }
        if let Some(used) = self.used.iter().find(|used| used.uri == uri) {
            return Err(format!(
                "it requires the extension `{prefix}` ({uri}), which layerd does not know, and uses it (`{}`), which could \
                 change the shape; save the model without it",
                used.name
            ));
        }
        Ok(format!("it requires the extension `{prefix}` ({uri}), which layerd does not know, but does not use it"))
    }
}

fn check_count(count: usize) -> Result<(), String> {
    if count > MAX_COUNT { Err(format!("more than {MAX_COUNT} namespaces in all parts")) } else { Ok(()) }
}
