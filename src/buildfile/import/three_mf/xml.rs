//! A stream of XML elements under limits: depth, attributes, and bytes between one element and the next.

use std::cell::Cell;
use std::io::{self, BufReader, Read};
use std::ops::Range;
use std::rc::Rc;

use quick_xml::events::{BytesStart, Event};
use quick_xml::name::{Namespace, ResolveResult};
use quick_xml::{NsReader, XmlVersion};

/// Deepest nesting; a 3MF model needs eight.
const DEPTH_LIMIT: usize = 64;

/// Most attributes of one element; no 3MF element has twenty.
const ATTRIBUTE_LIMIT: usize = 128;

/// Most bytes in which an element, a comment or a text must end: the parser holds them whole.
const EVENT_LIMIT_BYTES: u64 = 1 << 20;

const BUFFER_BYTES: usize = 64 << 10;

/// The namespaces 3MF lattices are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Space {
    Core,
    Lattice,
    Balls,
    Production,
    Displacement,
    Other,
}

impl Space {
    pub(super) fn of(uri: &str) -> Self {
        match uri {
            "http://schemas.microsoft.com/3dmanufacturing/core/2015/02" => Self::Core,
            "http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" => Self::Lattice,
            "http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07" => Self::Balls,
            "http://schemas.microsoft.com/3dmanufacturing/production/2015/06" => Self::Production,
            _ if uri.contains("/3dmanufacturing/displacement/") => Self::Displacement,
            _ => Self::Other,
        }
    }
}

/// One start tag. The value is reused from tag to tag.
#[derive(Debug)]
pub(super) struct Element {
    pub(super) space: Space,
    text: String,
    name: Range<usize>,
    attributes: Vec<[Range<usize>; 2]>,
}

impl Element {
    fn new() -> Self {
        Self { space: Space::Other, text: String::new(), name: 0..0, attributes: Vec::new() }
    }

    /// The name without its prefix.
    pub(super) fn name(&self) -> &str {
        &self.text[self.name.clone()]
    }

    /// An attribute by its name without prefix.
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        let local = |key: &Range<usize>| self.text[key.clone()].rsplit(':').next() == Some(name);
        self.attributes.iter().find(|[key, _]| local(key)).map(|[_, value]| &self.text[value.clone()])
    }

    /// Prefixes this element binds, with their namespaces.
    pub(super) fn bindings(&self) -> impl Iterator<Item = (&str, &str)> {
        self.attributes.iter().filter_map(|[key, value]| {
            self.text[key.clone()].strip_prefix("xmlns:").map(|prefix| (prefix, &self.text[value.clone()]))
        })
    }

    fn read(&mut self, start: &BytesStart<'_>) -> Result<(), String> {
        self.text.clear();
        self.attributes.clear();
        let local = start.local_name();
        self.name = append(&mut self.text, local.as_ref());
        for attribute in start.attributes().with_checks(false) {
            let attribute = attribute.map_err(|error| error.to_string())?;
            if self.attributes.len() == ATTRIBUTE_LIMIT {
                return Err(format!("an element `{}` with more than {ATTRIBUTE_LIMIT} attributes", self.name()));
            }
            let value = attribute.normalized_value(XmlVersion::Explicit1_0).map_err(|error| error.to_string())?;
            let key = append(&mut self.text, attribute.key.0);
            let value = append(&mut self.text, &value);
            self.attributes.push([key, value]);
        }
        Ok(())
    }
}

fn append(text: &mut String, part: &str) -> Range<usize> {
    let start = text.len();
    text.push_str(part);
    start..text.len()
}

/// What comes next.
pub(super) enum Step<'a> {
    /// An element begins; an empty one ends at once.
    Start(&'a Element),
    /// The innermost open element ends.
    End,
}

/// Reads elements one by one.
pub(super) struct Xml<R: Read> {
    reader: NsReader<BufReader<Guard<R>>>,
    since_event: Rc<Cell<u64>>,
    buffer: Vec<u8>,
    element: Element,
    depth: usize,
    ends_at_once: bool,
}

impl<R: Read> Xml<R> {
    pub(super) fn new(input: R) -> Self {
        let since_event = Rc::new(Cell::new(0));
        let guard = Guard { input, since_event: Rc::clone(&since_event) };
        let reader = NsReader::from_reader(BufReader::with_capacity(BUFFER_BYTES, guard));
        Self { reader, since_event, buffer: Vec::new(), element: Element::new(), depth: 0, ends_at_once: false }
    }

    /// Unpacked bytes read so far.
    pub(super) fn position_bytes(&self) -> u64 {
        self.reader.buffer_position()
    }

    /// The next step, or `None` at the end of a whole document.
    ///
    /// # Errors
    /// A text that says what is no XML or beyond a limit.
    pub(super) fn next(&mut self) -> Result<Option<Step<'_>>, String> {
        if std::mem::take(&mut self.ends_at_once) {
            self.depth -= 1;
            return Ok(Some(Step::End));
        }
        loop {
            self.buffer.clear();
            self.since_event.set(0);
            let event = self.reader.read_resolved_event_into(&mut self.buffer).map_err(|error| error.to_string())?;
            let (resolved, event) = event;
            let space = match resolved {
                ResolveResult::Bound(Namespace(uri)) => Space::of(uri),
                _ => Space::Other,
            };
            match event {
                Event::Start(ref start) | Event::Empty(ref start) => {
                    if self.depth == DEPTH_LIMIT {
                        return Err(format!("elements nested more than {DEPTH_LIMIT} deep"));
                    }
                    self.depth += 1;
                    self.ends_at_once = matches!(event, Event::Empty(_));
                    self.element.space = space;
                    self.element.read(start)?;
                    return Ok(Some(Step::Start(&self.element)));
                }
                Event::End(_) => {
                    self.depth = self.depth.checked_sub(1).ok_or("an end tag without a start tag")?;
                    return Ok(Some(Step::End));
                }
                Event::DocType(_) => return Err("a document type declaration, which 3MF forbids".into()),
                Event::Eof if self.depth > 0 => {
                    return Err("the document ends inside an element; it is cut short".into());
                }
                Event::Eof => return Ok(None),
                _ => {}
            }
        }
    }
}

/// Counts bytes since the last event and stops a parser that would buffer without end.
struct Guard<R> {
    input: R,
    since_event: Rc<Cell<u64>>,
}

impl<R: Read> Read for Guard<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.since_event.get() > EVENT_LIMIT_BYTES {
            return Err(io::Error::other(format!("an element or text longer than {EVENT_LIMIT_BYTES} bytes")));
        }
        let count = self.input.read(buffer)?;
        self.since_event.set(self.since_event.get() + count as u64);
        Ok(count)
    }
}
