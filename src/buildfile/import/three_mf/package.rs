//! The zip round a 3MF model: finds its parts and streams them, unpacked never further than a real lattice could be.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::rc::Rc;

use zip::ZipArchive;
use zip::result::ZipError;

use super::part_name;
use super::space::Space;
use super::xml::{Xml, quote};
use crate::buildfile::error::PackError;

/// Unpacked bytes of all parts for each byte of the file: ten times what the most regular lattices reach; deflate itself ends
/// at 1032.
const RATIO_LIMIT: u64 = 200;

/// Unpacked bytes that are always allowed, however well they were compressed: a part of half a million beams.
const FREE_BYTES: u64 = 64 << 20;

/// Most entries of the zip: as many as one without 64-bit extensions can list.
const ENTRY_LIMIT: usize = u16::MAX as usize;

/// An open package.
pub(super) struct Package<'a> {
    path: &'a Path,
    archive: ZipArchive<BufReader<File>>,
    names: Rc<Names>,
    /// The part that holds the build.
    root: String,
    /// A keystore is there, so parts may be encrypted.
    pub(super) has_keystore: bool,
    limit_bytes: u64,
    /// Bytes that the parts may still unpack to in this pass.
    left_bytes: u64,
}

/// The parts of a package by their names.
pub(super) struct Names {
    /// Entries of the zip by part name in lower case; `None` where several have that name.
    entries: HashMap<String, Option<usize>>,
}

impl Names {
    fn read(archive: &ZipArchive<BufReader<File>>) -> Result<Self, String> {
        if archive.len() > ENTRY_LIMIT {
            return Err(format!("it holds {} entries; at most {ENTRY_LIMIT} are read", archive.len()));
        }
        let mut entries = HashMap::with_capacity(archive.len());
        for (entry, name) in archive.file_names().enumerate() {
            // An entry whose name is no text can be named by no reference.
            let Ok(name) = name else { continue };
            match entries.entry(part_name::key(&part_name::resolve(&name))) {
                Entry::Vacant(free) => {
                    free.insert(Some(entry));
                }
                Entry::Occupied(mut taken) => {
                    taken.insert(None);
                }
            }
        }
        Ok(Self { entries })
    }

    /// The zip's entry for a part name that [`part_name::resolve`] returned.
    ///
    /// # Errors
    /// A text that says that there is none, or more than one.
    pub(super) fn entry(&self, name: &str) -> Result<usize, String> {
        let quoted = quote(name);
        match self.entries.get(&part_name::key(name)) {
            None => Err(format!("the package has no part `{quoted}`")),
            Some(None) => Err(format!(
                "several entries of the package have the part name `{quoted}` (upper and lower case are one)"
            )),
            Some(Some(entry)) => Ok(*entry),
        }
    }
}

impl<'a> Package<'a> {
    /// Opens a package and finds its model part by the relationships at its root.
    ///
    /// # Errors
    /// Where it is no zip or names no model.
    pub(super) fn open(path: &'a Path) -> Result<Self, PackError> {
        let read_error = |source| PackError::Read { path: path.into(), source };
        let wrong = |problem: String| PackError::input(path.display().to_string(), problem);
        let file = File::open(path).map_err(read_error)?;
        let file_bytes = file.metadata().map_err(read_error)?.len();
        let archive = ZipArchive::new(BufReader::new(file)).map_err(|error| {
            wrong(match error {
                ZipError::InvalidArchive(_) => {
                    "it is no 3MF file: a 3MF file is a zip archive, and this is none, or one that was cut short".into()
                }
                error => format!("it is not a 3MF package: {error}"),
            })
        })?;
        let names = Rc::new(Names::read(&archive).map_err(wrong)?);
        let limit_bytes = FREE_BYTES.max(RATIO_LIMIT.saturating_mul(file_bytes));
        let mut package = Self {
            path,
            archive,
            names,
            root: String::new(),
            has_keystore: false,
            limit_bytes,
            left_bytes: limit_bytes,
        };
        package.read_relationships()?;
        Ok(package)
    }

    /// A part of the file, for errors.
    pub(super) fn place(&self, part: &str) -> String {
        format!("{}: {part}", self.path.display())
    }

    /// The name of the part that holds the build.
    pub(super) fn root(&self) -> &str {
        &self.root
    }

    /// What parts there are.
    pub(super) fn names(&self) -> Rc<Names> {
        Rc::clone(&self.names)
    }

    /// Unpacked length of a part as the archive states it: good for a progress bar only.
    pub(super) fn stated_bytes(&mut self, part: &str) -> u64 {
        let entry = self.names.entry(part).ok();
        entry.and_then(|entry| self.archive.by_index(entry).ok()).map_or(0, |part| part.size())
    }

    /// Begins another pass over the parts: what they may unpack to counts anew.
    pub(super) fn rewind(&mut self) {
        self.left_bytes = self.limit_bytes;
    }

    /// A part as elements.
    ///
    /// # Errors
    /// Where the archive does not hold it.
    pub(super) fn part(&mut self, name: &str) -> Result<Xml<impl Read + use<'_, 'a>>, PackError> {
        let wrong = |problem: String| PackError::input(self.path.display().to_string(), problem);
        let entry = self.names.entry(name).map_err(wrong)?;
        let opened = self.archive.by_index(entry);
        let input = opened.map_err(|error| wrong(format!("the package's part `{name}` cannot be read: {error}")))?;
        Ok(Xml::new(Bounded { input, left_bytes: &mut self.left_bytes }))
    }

    /// Finds the model and what else the package's own relationships tell.
    fn read_relationships(&mut self) -> Result<(), PackError> {
        const RELATIONSHIPS: &str = "_rels/.rels";
        let place = self.place(RELATIONSHIPS);
        let wrong = |problem: String| PackError::input(&place, problem);
        let (mut root, mut has_keystore) = (None, false);
        let mut xml = self.part(RELATIONSHIPS)?;
        while let Some(element) = xml.next().map_err(wrong)? {
            let is_relationship = element.space == Space::Relationships && element.name() == "Relationship";
            if !is_relationship || element.get("TargetMode") == Some("External") {
                continue;
            }
            let kind = element.get("Type").unwrap_or_default();
            has_keystore |= kind.ends_with("/keystore");
            if kind.ends_with("/3dmodel") && root.is_none() {
                root = element.get("Target").map(part_name::resolve);
            }
        }
        drop(xml);
        self.has_keystore = has_keystore;
        self.root = root.ok_or_else(|| wrong("no relationship names a 3D model; is this a 3MF file?".into()))?;
        Ok(())
    }
}

/// A part that may only unpack to so many bytes.
struct Bounded<'a, R> {
    input: R,
    left_bytes: &'a mut u64,
}

impl<R: Read> Read for Bounded<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        *self.left_bytes = self.left_bytes.checked_sub(count as u64).ok_or_else(|| {
            io::Error::other(format!("it unpacks to more than {RATIO_LIMIT} times the file's length: a zip bomb"))
        })?;
        Ok(count)
    }
}
