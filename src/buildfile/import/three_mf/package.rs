//! The zip round a 3MF model: finds the model part and streams it, unpacked never further than a real lattice could be.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use zip::ZipArchive;

use super::xml::{Step, Xml};
use crate::buildfile::pack::PackError;

/// Unpacked bytes for each byte of the file: ten times what the most regular lattices reach; deflate itself ends at 1032.
const RATIO_LIMIT: u64 = 200;

/// Unpacked bytes that are always allowed, however well they were compressed: a part of half a million beams.
const FREE_BYTES: u64 = 64 << 20;

/// An open package.
pub(super) struct Package<'a> {
    path: &'a Path,
    archive: ZipArchive<BufReader<File>>,
    model: String,
    limit_bytes: u64,
}

impl<'a> Package<'a> {
    /// Opens a package and finds its model part by the relationships at its root.
    ///
    /// # Errors
    /// Where it is no zip or names no model.
    pub(super) fn open(path: &'a Path) -> Result<Self, PackError> {
        let read_error = |source| PackError::Read { path: path.into(), source };
        let file = File::open(path).map_err(read_error)?;
        let file_bytes = file.metadata().map_err(read_error)?.len();
        let archive = ZipArchive::new(BufReader::new(file)).map_err(|error| {
            PackError::input(path.display().to_string(), format!("it is not a 3MF package: {error}"))
        })?;
        let limit_bytes = FREE_BYTES.max(RATIO_LIMIT.saturating_mul(file_bytes));
        let mut package = Self { path, archive, model: String::new(), limit_bytes };
        package.model = package.find_model()?;
        Ok(package)
    }

    /// The file and the model part in it, for errors.
    pub(super) fn place(&self) -> String {
        format!("{}: {}", self.path.display(), self.model)
    }

    /// Unpacked length of the model part as the archive states it: good for a progress bar only.
    pub(super) fn stated_model_bytes(&mut self) -> u64 {
        self.archive.by_name(&self.model).map_or(1, |part| part.size().max(1))
    }

    /// The model part as elements.
    ///
    /// # Errors
    /// Where the archive does not hold it.
    pub(super) fn model(&mut self) -> Result<Xml<impl Read + use<'_, 'a>>, PackError> {
        let name = self.model.clone();
        self.part(&name)
    }

    fn find_model(&mut self) -> Result<String, PackError> {
        const RELATIONSHIPS: &str = "_rels/.rels";
        let place = format!("{}: {RELATIONSHIPS}", self.path.display());
        let mut xml = self.part(RELATIONSHIPS)?;
        while let Some(step) = xml.next().map_err(|problem| PackError::input(&place, problem))? {
            if let Step::Start(element) = step
                && element.name() == "Relationship"
                && element.get("Type").is_some_and(|kind| kind.ends_with("/3dmodel"))
                && let Some(target) = element.get("Target")
            {
                return Ok(target.trim_start_matches('/').to_owned());
            }
        }
        Err(PackError::input(place, "no relationship names a 3D model; is this a 3MF file?"))
    }

    fn part(&mut self, name: &str) -> Result<Xml<impl Read + use<'_, 'a>>, PackError> {
        let limit_bytes = self.limit_bytes;
        let path = self.path;
        let input = self.archive.by_name(name).map_err(|error| {
            PackError::input(path.display().to_string(), format!("the package's part `{name}` cannot be read: {error}"))
        })?;
        Ok(Xml::new(Bounded { input, left_bytes: limit_bytes }))
    }
}

/// A part that may only unpack to so many bytes.
struct Bounded<R> {
    input: R,
    left_bytes: u64,
}

impl<R: Read> Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        self.left_bytes = self.left_bytes.checked_sub(count as u64).ok_or_else(|| {
            io::Error::other(format!("it unpacks to more than {RATIO_LIMIT} times the file's length: a zip bomb"))
        })?;
        Ok(count)
    }
}
