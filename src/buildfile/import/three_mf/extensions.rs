//! Extensions that a package requires: which of them can be passed over without changing the shape.

use super::space::Space;
use super::xml::{Foreign, check_uri, quote};

/// Most extensions of all parts together that are required, and most unknown namespaces that are used: there are some twenty.
const COUNT_LIMIT: usize = 256;

/// What the parts of a package require, and what of it they use.
#[derive(Debug, Default)]
pub(super) struct Extensions {
    /// Prefix and namespace.
    required: Vec<(String, String)>,
    used: Vec<Foreign>,
}

impl Extensions {
    /// Adds an extension that a part requires by this prefix, which must be bound to a namespace.
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

    /// Adds the namespaces that a part uses and layerd does not know.
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

    /// Returns a note for each required extension that is passed over.
    ///
    /// # Errors
    /// A text that names an extension that is required, used, and could change the shape.
    pub(super) fn check(&self, has_keystore: bool) -> Result<Vec<String>, String> {
        let mut notes = Vec::new();
        for (prefix, uri) in &self.required {
            match Space::of(uri) {
                Space::Shapeless => notes.push(format!(
                    "it requires the extension `{prefix}` ({uri}), which cannot change the shape: it was passed over"
                )),
                Space::Other => notes.push(self.check_unknown(prefix, uri, has_keystore)?),
                _ => {}
            }
        }
        Ok(notes)
    }

    fn check_unknown(&self, prefix: &str, uri: &str, has_keystore: bool) -> Result<String, String> {
        // It is used by parts that cannot be read, so it would not be found in those that can.
        if has_keystore && uri.contains("/3dmanufacturing/securecontent/") {
            return Err(format!(
                "it requires the extension `{prefix}` ({uri}), and the package holds a keystore: its parts may be encrypted; \
                 save it without encryption"
            ));
        }
        if let Some(used) = self.used.iter().find(|used| used.uri == uri) {
            return Err(format!(
                "it requires the extension `{prefix}` ({uri}), which layerd does not know, and uses it (`{}`): the shape could \
                 be another than what would be printed; save the model without it",
                used.name
            ));
        }
        Ok(format!("it requires the extension `{prefix}` ({uri}), which layerd does not know, but uses nothing of it"))
    }
}

fn check_count(count: usize) -> Result<(), String> {
    if count > COUNT_LIMIT { Err(format!("more than {COUNT_LIMIT} namespaces in all parts")) } else { Ok(()) }
}
