//! A stream of XML elements, with limits on depth, number of attributes and length of a tag. `package` opens it for each part.

use std::io::Read;
use std::ops::Range;

use quick_xml::events::{BytesStart, Event};
use quick_xml::name::{Namespace, NamespaceResolver, ResolveResult};
use quick_xml::{NsReader, XmlVersion};

use super::space::Space;
use super::tags::Tags;

/// Deepest nesting of elements. A 3MF model needs eight.
const MAX_DEPTH: usize = 64;

/// Most attributes of one element. No 3MF element has twenty.
const MAX_ATTRIBUTES: usize = 128;

/// Most unknown namespaces in one document. Slicing programs write two or three.
const MAX_FOREIGN: usize = 64;

/// Longest name of an unknown namespace, bytes, because each is kept in memory. Published names have some 70.
pub(super) const MAX_URI_BYTES: usize = 1024;

/// Longest name from the file that is kept or repeated, characters: enough to recognise it.
const MAX_QUOTE_CHARS: usize = 80;

/// One start tag. The buffers are reused from tag to tag.
#[derive(Debug)]
pub(super) struct Element {
    pub(super) space: Space,
    text: String,
    name: Range<usize>,
    attributes: Vec<Attribute>,
}

/// One attribute. Without a prefix it belongs to the namespace of its element. In an unknown namespace it keeps its prefix.
#[derive(Debug)]
struct Attribute {
    space: Space,
    name: Range<usize>,
    value: Range<usize>,
}

/// An unknown namespace, and the first element or attribute that uses it.
#[derive(Debug)]
pub(super) struct Foreign {
    pub(super) uri: String,
    pub(super) name: String,
}

impl Element {
    fn new() -> Self {
        Self { space: Space::Other, text: String::new(), name: 0..0, attributes: Vec::new() }
    }

    /// The name, without prefix.
    pub(super) fn name(&self) -> &str {
        &self.text[self.name.clone()]
    }

    /// An attribute without prefix, or in the namespace of the element.
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        self.get_of(self.space, name)
    }

    /// An attribute in the namespace of an extension.
    pub(super) fn get_of(&self, space: Space, name: &str) -> Option<&str> {
        let found = self.attributes.iter().find(|one| one.space == space && &self.text[one.name.clone()] == name);
        found.map(|one| &self.text[one.value.clone()])
    }

    /// The namespace that this element binds to a prefix.
    pub(super) fn binding(&self, prefix: &str) -> Option<&str> {
        let bound = |one: &&Attribute| {
            one.space == Space::Other && self.text[one.name.clone()].strip_prefix("xmlns:") == Some(prefix)
        };
        self.attributes.iter().find(bound).map(|one| &self.text[one.value.clone()])
    }

    fn read(
        &mut self,
        space: Space,
        start: &BytesStart<'_>,
        resolver: &NamespaceResolver,
        foreign: &mut Vec<Foreign>,
    ) -> Result<(), String> {
        self.space = space;
        self.text.clear();
        self.attributes.clear();
        self.name = append(&mut self.text, start.local_name().as_ref());
        for attribute in start.attributes().with_checks(false) {
            let attribute = attribute.map_err(|error| error.to_string())?;
            if self.attributes.len() == MAX_ATTRIBUTES {
                return Err(format!("an element `{}` with more than {MAX_ATTRIBUTES} attributes", self.name()));
            }
            let key = attribute.key.into_inner();
            let (space, name) = match key.split_once(':') {
                None if key != "xmlns" => (self.space, key),
                None | Some(("xmlns", _)) => (Space::Other, key),
                Some((_, local)) => match resolve(&resolver.resolve_attribute(attribute.key).0, local, foreign)? {
                    Space::Other => (Space::Other, key),
                    known => (known, local),
                },
            };
            let value = attribute.normalized_value(XmlVersion::Explicit1_0).map_err(|error| error.to_string())?;
            let twice = |one: &Attribute| one.space == space && &self.text[one.name.clone()] == name;
            if self.attributes.iter().any(twice) {
                return Err(format!("`{}` has the attribute {} twice", self.name(), quote(name)));
            }
            let name = append(&mut self.text, name);
            let value = append(&mut self.text, &value);
            self.attributes.push(Attribute { space, name, value });
        }
        Ok(())
    }
}

/// Resolves a namespace. An unknown one is added to `foreign` with `name`, which uses it.
fn resolve(resolved: &ResolveResult<'_>, name: &str, foreign: &mut Vec<Foreign>) -> Result<Space, String> {
    let uri = match resolved {
        ResolveResult::Bound(Namespace(uri)) => *uri,
        ResolveResult::Unbound => return Ok(Space::Other),
        ResolveResult::Unknown(prefix) => {
            return Err(format!("the prefix of `{}:{}` is bound to no namespace", quote(prefix), quote(name)));
        }
    };
    let space = Space::of(uri);
    if space == Space::Other && !foreign.iter().any(|known| known.uri == uri) {
        check_uri(uri)?;
        if foreign.len() == MAX_FOREIGN {
            return Err(format!("more than {MAX_FOREIGN} namespaces"));
        }
        foreign.push(Foreign { uri: uri.to_owned(), name: quote(name) });
    }
    Ok(space)
}

/// Checks the length of a namespace.
///
/// # Errors
/// A text that says that it is too long.
pub(super) fn check_uri(uri: &str) -> Result<(), String> {
    if uri.len() > MAX_URI_BYTES {
        return Err(format!("the name of a namespace is longer than {MAX_URI_BYTES} bytes: `{}`", quote(uri)));
    }
    Ok(())
}

/// The beginning of a text from the file, short enough for a message.
pub(super) fn quote(text: &str) -> String {
    text.chars().take(MAX_QUOTE_CHARS).collect()
}

fn append(text: &mut String, part: &str) -> Range<usize> {
    let start = text.len();
    text.push_str(part);
    start..text.len()
}

/// Reads elements one after another.
pub(super) struct Xml<R: Read> {
    reader: NsReader<Tags<R>>,
    buffer: Vec<u8>,
    element: Element,
    foreign: Vec<Foreign>,
    depth: usize,
    /// Depth of the parent of the element that is being skipped; `None` if none is.
    skipped: Option<usize>,
}

impl<R: Read> Xml<R> {
    pub(super) fn new(input: R) -> Self {
        Self {
            reader: NsReader::from_reader(Tags::new(input)),
            buffer: Vec::new(),
            element: Element::new(),
            foreign: Vec::new(),
            depth: 0,
            skipped: None,
        }
    }

    /// Number of unpacked bytes read so far.
    pub(super) fn position_bytes(&self) -> u64 {
        self.reader.get_ref().position_bytes()
    }

    /// The unknown namespaces found so far.
    pub(super) fn into_foreign(self) -> Vec<Foreign> {
        self.foreign
    }

    /// The next element; `None` at the end of a complete document. Below the root, elements of unknown extensions and of extensions that
    /// cannot change the shape are skipped with everything inside them.
    ///
    /// # Errors
    /// A text that says what is not XML or exceeds a limit.
    pub(super) fn next(&mut self) -> Result<Option<&Element>, String> {
        loop {
            self.buffer.clear();
            let (resolved, event) =
                self.reader.read_resolved_event_into(&mut self.buffer).map_err(|error| match error {
                    // The text of `package` or `tags`.
                    quick_xml::Error::Io(error) => error.to_string(),
                    other => other.to_string(),
                })?;
            match event {
                Event::Start(ref start) | Event::Empty(ref start) => {
                    if self.depth == MAX_DEPTH {
                        return Err(format!("elements nested more than {MAX_DEPTH} deep"));
                    }
                    let is_empty = matches!(event, Event::Empty(_));
                    let outside = self.depth;
                    self.depth += usize::from(!is_empty);
                    if self.skipped.is_some() {
                        continue;
                    }
                    let space = resolve(&resolved, start.local_name().as_ref(), &mut self.foreign)?;
                    if outside > 0 && matches!(space, Space::Other | Space::Shapeless) {
                        self.skipped = (!is_empty).then_some(outside);
                        continue;
                    }
                    self.element.read(space, start, self.reader.resolver(), &mut self.foreign)?;
                    return Ok(Some(&self.element));
                }
                Event::End(_) => {
                    self.depth = self.depth.checked_sub(1).ok_or("an end tag without a start tag")?;
                    self.skipped = self.skipped.filter(|&outside| outside < self.depth);
                }
                Event::Eof if self.depth > 0 => {
                    return Err("the document ends inside an element; it is truncated".into());
                }
                Event::Eof => return Ok(None),
                _ => {}
            }
        }
    }
}
