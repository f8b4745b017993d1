//! A file that appears complete or not at all: it is written without a name if the file system allows that, then linked and renamed.
//! `buildfile/store/writer.rs` and `layerctl slice` write with it.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Mode, OFlags};
use tempfile::NamedTempFile;

/// A file that is being written and will replace `path`.
#[derive(Debug)]
pub(crate) struct Output {
    path: PathBuf,
    directory: PathBuf,
    target: Target,
}

#[derive(Debug)]
enum Target {
    /// It has no name: the kernel frees it even if this process is killed.
    Unnamed(File),
    /// It has a temporary name, which is removed on drop: for file systems without `O_TMPFILE`.
    Named(NamedTempFile),
}

impl Output {
    /// Begins a file that will replace `path`.
    ///
    /// # Errors
    /// If `path` exists and is not a regular file, or its directory cannot be written to.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        if std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file()) {
            return Err(io::Error::other("it exists and is not a regular file; choose another name"));
        }
        let directory = directory_of(path).to_owned();
        if path.file_name().is_none() {
            return Err(io::Error::other("it is not the name of a file"));
        }
        if !directory.is_dir() {
            return Err(io::Error::other(format!("the directory {} does not exist", directory.display())));
        }
        let mut unnamed = OpenOptions::new();
        unnamed.read(true).write(true).mode(0o666).custom_flags(OFlags::TMPFILE.bits() as i32);
        let target = match unnamed.open(&directory) {
            Ok(file) => Target::Unnamed(file),
            Err(_) => {
                let mut builder = tempfile::Builder::new();
                let named = builder.prefix(".layerd-").suffix(".tmp").tempfile_in(&directory);
                Target::Named(named.map_err(|error| {
                    // The message of the error names the temporary file, which the user does not know.
                    let text = format!("the directory {} cannot be written to ({})", directory.display(), error.kind());
                    io::Error::new(error.kind(), text)
                })?)
            }
        };
        Ok(Self { path: path.into(), directory, target })
    }

    /// The open file.
    pub(crate) fn file(&self) -> &File {
        match &self.target {
            Target::Unnamed(file) => file,
            Target::Named(file) => file.as_file(),
        }
    }

    /// Syncs the file, gives it its name and syncs the directory.
    ///
    /// # Errors
    /// The file is removed, and an earlier file of this name is unchanged, unless only the final sync of the directory failed.
    pub(crate) fn persist(self) -> io::Result<()> {
        self.file().sync_all()?;
        let directory = File::open(&self.directory)?;
        self.publish()?;
        directory.sync_all()
    }

    /// Gives the file its name, without waiting for the disk.
    ///
    /// # Errors
    /// The file is removed, and an earlier file of this name is unchanged.
    pub(crate) fn publish(self) -> io::Result<()> {
        match self.target {
            Target::Unnamed(file) => link(&file, &self.directory, &self.path),
            Target::Named(file) => {
                let mode = Mode::from_raw_mode(0o644);
                rustix::fs::fchmod(file.as_file(), mode)?;
                file.persist(&self.path).map(|_| ()).map_err(|error| error.error)
            }
        }
    }
}

/// The directory of a file.
pub(crate) fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Names an unnamed file. `linkat` cannot replace a file, so the file first gets a temporary name and is then renamed.
fn link(file: &File, directory: &Path, path: &Path) -> io::Result<()> {
    let descriptor = format!("/proc/self/fd/{}", file.as_raw_fd());
    let passing = directory.join(format!(".layerd-{}-{}.tmp", std::process::id(), file.as_raw_fd()));
    let link = || rustix::fs::linkat(CWD, &descriptor, CWD, &passing, AtFlags::SYMLINK_FOLLOW);
    if link() == Err(rustix::io::Errno::EXIST) {
        // A process with the same id was killed between the two calls.
        std::fs::remove_file(&passing)?;
        link()?;
    }
    std::fs::rename(&passing, path).inspect_err(|_| {
        let _ = std::fs::remove_file(&passing);
    })
}
