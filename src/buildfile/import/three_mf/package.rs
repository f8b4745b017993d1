//! The zip archive around a 3MF model: finds its parts and streams them, with a limit on their unpacked length.
//! `tests/pack_3mf.rs` tests it.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::rc::Rc;

use zip::ZipArchive;
use zip::result::ZipError;

use super::part_name;
use super::space::Space;
use super::xml::{Xml, quote};
use crate::buildfile::error::PackError;
use crate::text::size_text;

/// Largest ratio of the unpacked length of all parts to the length of the file: ten times that of the most regular lattices. Deflate
/// itself reaches 1032.
const MAX_RATIO: u64 = 200;

/// Unpacked length that is allowed at any ratio, bytes: a part of half a million beams.
const FREE_BYTES: u64 = 64 << 20;

/// Most entries of the zip archive: as many as an archive without 64-bit extensions can have.
const MAX_ENTRIES: usize = u16::MAX as usize;

/// Most bytes from the record that ends an archive to the end of the file: the record, and the longest comment.
const MAX_END_BYTES: u64 = 22 + u16::MAX as u64;

/// Whether a file has the record that ends an archive. The library would look for it in all of a file, however long.
fn ends_as_archive(file: &File, file_bytes: u64) -> io::Result<bool> {
    const END_MAGIC: [u8; 4] = *b"PK\x05\x06";
    let end_bytes = file_bytes.min(MAX_END_BYTES);
    let mut end = vec![0; end_bytes as usize];
    file.read_exact_at(&mut end, file_bytes - end_bytes)?;
    Ok(end.windows(END_MAGIC.len()).any(|bytes| bytes == END_MAGIC))
}

/// An open package.
pub(super) struct Package<'a> {
    path: &'a Path,
    archive: ZipArchive<BufReader<File>>,
    names: Rc<Names>,
    /// Name of the part with the build.
    root: String,
    /// Whether there is a keystore, so that parts may be encrypted.
    pub(super) has_keystore: bool,
    limit_bytes: u64,
    /// Bytes that may still be unpacked in this pass.
    left_bytes: u64,
}

/// The parts of a package, by name.
pub(super) struct Names {
    /// Entries of the archive, by part name in lower case; `None` if several entries have that name.
    entries: HashMap<String, Option<usize>>,
}

impl Names {
    fn read(archive: &ZipArchive<BufReader<File>>) -> Result<Self, String> {
        if archive.len() > MAX_ENTRIES {
            return Err(format!("it holds {} entries; at most {MAX_ENTRIES} are read", archive.len()));
        }
        let mut entries = HashMap::with_capacity(archive.len());
        for (entry, name) in archive.file_names().enumerate() {
            // No reference can name an entry whose name is not valid text.
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

    /// The entry of a part, whose name is a result of [`part_name::resolve`].
    ///
    /// # Errors
    /// A text that says that there is no such part, or more than one.
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
    /// Opens a package and finds its model through the relationships of the package.
    ///
    /// # Errors
    /// If it is not a zip archive or has no model.
    pub(super) fn open(path: &'a Path) -> Result<Self, PackError> {
        let read_error = |source| PackError::Read { path: path.into(), source };
        let wrong = |problem: String| PackError::input(path.display().to_string(), problem);
        let file = File::open(path).map_err(read_error)?;
        let file_bytes = file.metadata().map_err(read_error)?.len();
        let no_archive =
            || "it is not a 3MF file: a 3MF file is a zip archive, and this is not one, or it is truncated".to_owned();
        if !ends_as_archive(&file, file_bytes).map_err(read_error)? {
            return Err(wrong(no_archive()));
        }
        let archive = ZipArchive::new(BufReader::new(file)).map_err(|error| {
            wrong(match error {
                ZipError::InvalidArchive(_) => no_archive(),
                error => format!("it is not a 3MF package: {error}"),
            })
        })?;
        let names = Rc::new(Names::read(&archive).map_err(wrong)?);
        let limit_bytes = FREE_BYTES.max(MAX_RATIO.saturating_mul(file_bytes));
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

    /// File and part, for errors.
    pub(super) fn place(&self, part: &str) -> String {
        format!("{}: {part}", self.path.display())
    }

    /// Name of the part with the build.
    pub(super) fn root(&self) -> &str {
        &self.root
    }

    /// All parts.
    pub(super) fn names(&self) -> Rc<Names> {
        Rc::clone(&self.names)
    }

    /// Unpacked length of a part as the archive states it. Not checked, so only for progress.
    pub(super) fn stated_bytes(&mut self, part: &str) -> u64 {
        let entry = self.names.entry(part).ok();
        entry.and_then(|entry| self.archive.by_index(entry).ok()).map_or(0, |part| part.size())
    }

    /// Begins another pass over the parts, with a new limit on the unpacked length.
    pub(super) fn rewind(&mut self) {
        self.left_bytes = self.limit_bytes;
    }

    /// The XML elements of a part.
    ///
    /// # Errors
    /// If the archive does not have the part.
    pub(super) fn part(&mut self, name: &str) -> Result<Xml<impl Read + use<'_, 'a>>, PackError> {
        let wrong = |problem: String| PackError::input(self.path.display().to_string(), problem);
        let entry = self.names.entry(name).map_err(wrong)?;
        let opened = self.archive.by_index(entry);
        let input = opened.map_err(|error| wrong(format!("the package's part `{name}` cannot be read: {error}")))?;
        Ok(Xml::new(Bounded { input, left_bytes: &mut self.left_bytes }))
    }

    /// All bytes of a part that is no XML.
    ///
    /// # Errors
    /// If the archive does not have the part, or it unpacks to more than `most_bytes`.
    pub(super) fn bytes(&mut self, name: &str, most_bytes: u64) -> Result<Vec<u8>, PackError> {
        let wrong = |problem: String| PackError::input(self.path.display().to_string(), problem);
        let entry = self.names.entry(name).map_err(wrong)?;
        let opened = self.archive.by_index(entry);
        let input = opened.map_err(|error| wrong(format!("the package's part `{name}` cannot be read: {error}")))?;
        let mut bytes = Vec::new();
        let mut bounded = Bounded { input, left_bytes: &mut self.left_bytes }.take(most_bytes.saturating_add(1));
        let read = bounded.read_to_end(&mut bytes);
        read.map_err(|error| wrong(format!("the package's part `{name}` cannot be read: {error}")))?;
        if bytes.len() as u64 > most_bytes {
            let allowed = size_text(most_bytes);
            return Err(wrong(format!(
                "the package's part `{name}` takes more than the {allowed} that --memory allows; give more"
            )));
        }
        Ok(bytes)
    }

    /// Reads the relationships of the package: model and keystore.
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

/// A reader with a limit on its length.
struct Bounded<'a, R> {
    input: R,
    left_bytes: &'a mut u64,
}

impl<R: Read> Read for Bounded<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        *self.left_bytes = self.left_bytes.checked_sub(count as u64).ok_or_else(|| {
            io::Error::other(format!("it unpacks to more than {MAX_RATIO} times the file's length: a zip bomb"))
        })?;
        Ok(count)
    }
}
