//! A simulated disk: what was not flushed is lost when the power fails, writes are torn, space runs out, writing or reading fails.
//!
//! A killed process loses nothing that it wrote: the system's memory outlives it. A power cut keeps of each file what was flushed and a
//! random beginning of what was written since, perhaps with zeros in place of its last block; and of each directory what was flushed
//! and the first of the changes since. This is harsher than file systems with a journal are.

mod state;

use std::collections::BTreeMap;
use std::fs::TryLockError;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use layerd::system::{Disk, DiskFile, How, Metadata};

use crate::rng::Rng;
pub(crate) use state::Unreadable;
use state::{Access, CAPACITY_BYTES, DirectoryNode, FileNode, Node, OUTSIDE, ROOT, State, full, names};

/// What the disk did to those who used it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Harm {
    /// Calls that failed because the disk was full.
    pub(crate) full: u64,
    /// Writing calls that failed with an input/output error.
    pub(crate) failed: u64,
    /// Reading calls that did.
    pub(crate) unread: u64,
    /// Files whose unflushed end was lost, whole or in part, in a power cut.
    pub(crate) lost: u64,
    /// Names whose change was lost in a power cut.
    pub(crate) lost_names: u64,
}

/// A disk that processes share. Clones are the same disk.
#[derive(Clone, Debug)]
pub(crate) struct SimDisk(Arc<Mutex<State>>);

/// The disk as one process sees it. Once the process has died, nothing that it still does has an effect.
#[derive(Clone, Debug)]
pub(crate) struct Mount {
    disk: SimDisk,
    process: u32,
}

impl SimDisk {
    pub(crate) fn new(seed: u64) -> Self {
        let nodes = BTreeMap::from([(ROOT, Node::Directory(DirectoryNode::default()))]);
        Self(Arc::new(Mutex::new(State {
            nodes,
            next_node: ROOT + 1,
            rng: Rng::new(seed),
            process: 0,
            calls_left: None,
            taken_bytes: 0,
            used_bytes: 0,
            broken_per_million: 0,
            unreadable: None,
            open_files: 0,
            harm: Harm::default(),
        })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The disk for a new process; the one before is dead.
    pub(crate) fn mount(&self) -> Mount {
        let mut state = self.state();
        state.end_process();
        Mount { disk: self.clone(), process: state.process }
    }

    /// The disk for an observer.
    pub(crate) fn inspect(&self) -> Mount {
        Mount { disk: self.clone(), process: OUTSIDE }
    }

    /// Kills the process: its locks are free, and nothing that it still does has an effect.
    pub(crate) fn kill(&self) {
        self.state().end_process();
    }

    /// Has the process killed in the middle of its work, after so many calls.
    pub(crate) fn kill_after(&self, calls: u32) {
        self.state().calls_left = Some(calls);
    }

    /// Whether [`Self::kill_after`] has struck.
    pub(crate) fn has_killed(&self) -> bool {
        self.state().calls_left == Some(0)
    }

    /// The power fails: what was not flushed is lost, but for the random part of it that had reached the disk.
    pub(crate) fn power_cut(&self) {
        let mut state = self.state();
        state.end_process();
        state.lose_unflushed();
    }

    /// Other programs leave so much room; `None` if they leave all.
    pub(crate) fn leave_free(&self, bytes: Option<u64>) {
        let mut state = self.state();
        let free_bytes = CAPACITY_BYTES - state.used_bytes;
        state.taken_bytes = bytes.map_or(0, |bytes| free_bytes.saturating_sub(bytes));
    }

    /// From now on so many of a million writing calls fail.
    pub(crate) fn set_broken(&self, per_million: u32) {
        self.state().broken_per_million = per_million;
    }

    /// From now on reading fails; `None` if it works again.
    pub(crate) fn set_unreadable(&self, unreadable: Option<Unreadable>) {
        self.state().unreadable = unreadable;
    }

    /// Moves a directory aside, and makes an empty one in its place.
    pub(crate) fn replace_directory(&self, path: &Path) {
        let mut state = self.state();
        let Ok((parent, name)) = state.parent(path) else { return };
        let new = state.add(Node::Directory(DirectoryNode::default()));
        let Some(old) = state.directory(parent).and_then(|parent| parent.names.get(&name).copied()) else { return };
        state.set_name(parent, format!("{name}.old-{new}"), Some(old));
        state.set_name(parent, name, Some(new));
        state.flush_directory(parent);
    }

    pub(crate) fn harm(&self) -> Harm {
        self.state().harm
    }

    /// Files that the living process has open.
    pub(crate) fn open_files(&self) -> usize {
        self.state().open_files
    }

    /// Writes a file and flushes it with its directories: for what is there before the simulation begins.
    pub(crate) fn prepare(&self, path: &Path, bytes: &[u8]) {
        let mut state = self.state();
        let (mut directory, mut at) = (ROOT, PathBuf::from("/"));
        let name = path.file_name().expect("a file's name").to_string_lossy().into_owned();
        for part in names(path.parent().expect("a directory")) {
            at.push(&part);
            directory = match state.find(&at) {
                Ok(found) => found,
                Err(_) => {
                    let made = state.add(Node::Directory(DirectoryNode::default()));
                    state.set_name(directory, part, Some(made));
                    state.flush_directory(directory);
                    made
                }
            };
        }
        let file = FileNode { bytes: bytes.to_vec(), flushed: bytes.to_vec(), links: 1, ..FileNode::default() };
        state.used_bytes += bytes.len() as u64;
        let made = state.add(Node::File(file));
        state.set_name(directory, name, Some(made));
        state.flush_directory(directory);
    }
}

impl Mount {
    fn enter(&self, access: Access<'_>) -> io::Result<MutexGuard<'_, State>> {
        let mut state = self.disk.state();
        state.enter(self.process, access)?;
        Ok(state)
    }
}

impl Disk for Mount {
    fn open(&self, path: &Path, how: How) -> io::Result<Box<dyn DiskFile>> {
        let reads = matches!(how, How::Read | How::ReadWrite);
        let mut state = self.enter(if reads { Access::Reads(path) } else { Access::Writes })?;
        let node = match state.find(path) {
            Ok(_) if matches!(how, How::CreateNew | How::CreatePrivate) => return Err(ErrorKind::AlreadyExists.into()),
            Ok(node) => node,
            Err(error) if reads || error.kind() != ErrorKind::NotFound => return Err(error),
            Err(_) => {
                let (parent, name) = state.parent(path)?;
                if state.free_bytes() == 0 {
                    state.harm.full += 1;
                    return Err(full());
                }
                let made = state.add(Node::File(FileNode { links: 1, ..FileNode::default() }));
                state.set_name(parent, name, Some(made));
                made
            }
        };
        let opened = Box::new(SimFile { mount: self.clone(), node, path: path.into() });
        if self.process == OUTSIDE {
            return Ok(opened);
        }
        if let Ok(file) = state.file(node) {
            file.opened += 1;
            if how == How::Truncate {
                (file.bytes, file.reserved_bytes) = (Vec::new(), 0);
                state.count_used();
            }
            state.open_files += 1;
        }
        Ok(opened)
    }

    fn metadata(&self, path: &Path, _follow: bool) -> io::Result<Metadata> {
        let state = self.enter(Access::Reads(path))?;
        Ok(state.metadata(state.find(path)?))
    }

    fn create_directory(&self, path: &Path) -> io::Result<()> {
        let mut state = self.enter(Access::Writes)?;
        if state.find(path).is_ok() {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let (parent, name) = state.parent(path)?;
        let made = state.add(Node::Directory(DirectoryNode::default()));
        state.set_name(parent, name, Some(made));
        Ok(())
    }

    fn list(&self, path: &Path) -> io::Result<Vec<PathBuf>> {
        let state = self.enter(Access::Reads(path))?;
        let directory = state.directory(state.find(path)?).ok_or(ErrorKind::NotADirectory)?;
        Ok(directory.names.keys().map(|name| path.join(name)).collect())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.enter(Access::Writes)?;
        let node = state.find(from)?;
        let ((old, old_name), (new, new_name)) = (state.parent(from)?, state.parent(to)?);
        if let Some(there) = state.find(to).ok().and_then(|there| state.directory(there))
            && !there.names.is_empty()
        {
            return Err(ErrorKind::DirectoryNotEmpty.into());
        }
        state.set_name(new, new_name, Some(node));
        state.set_name(old, old_name, None);
        if old == new {
            state.join_last_changes(old);
        }
        state.free_unnamed();
        Ok(())
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.enter(Access::Writes)?;
        let node = state.find(from)?;
        if state.find(to).is_ok() {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let (parent, name) = state.parent(to)?;
        state.file(node)?.links += 1;
        state.set_name(parent, name, Some(node));
        Ok(())
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        let mut state = self.enter(Access::Writes)?;
        let node = state.find(path)?;
        state.file(node)?;
        let (parent, name) = state.parent(path)?;
        state.set_name(parent, name, None);
        state.free_unnamed();
        Ok(())
    }

    fn remove_directory(&self, path: &Path) -> io::Result<()> {
        let mut state = self.enter(Access::Writes)?;
        let node = state.find(path)?;
        if !state.directory(node).ok_or(ErrorKind::NotADirectory)?.names.is_empty() {
            return Err(ErrorKind::DirectoryNotEmpty.into());
        }
        let (parent, name) = state.parent(path)?;
        state.set_name(parent, name, None);
        Ok(())
    }

    fn sync_directory(&self, path: &Path) -> io::Result<()> {
        let mut state = self.enter(Access::Writes)?;
        let node = state.find(path)?;
        state.flush_directory(node);
        Ok(())
    }

    fn free_bytes(&self, directory: &Path) -> io::Result<u64> {
        let state = self.enter(Access::Asks)?;
        state.find(directory)?;
        Ok(state.free_bytes())
    }
}

/// An open file of one process.
#[derive(Debug)]
struct SimFile {
    mount: Mount,
    node: u64,
    /// As it was opened.
    path: PathBuf,
}

impl DiskFile for SimFile {
    fn read_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<usize> {
        let mut state = self.mount.enter(Access::Reads(&self.path))?;
        let rest = state.file(self.node)?.bytes.get(offset as usize..).unwrap_or_default();
        let count = rest.len().min(bytes.len());
        bytes[..count].copy_from_slice(&rest[..count]);
        Ok(count)
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize> {
        let mut state = self.mount.enter(Access::Writes)?;
        let free_bytes = state.free_bytes();
        let file = state.file(self.node)?;
        let (end, before) = (offset + bytes.len() as u64, file.allocated_bytes());
        let room_bytes = before + free_bytes;
        if offset >= room_bytes {
            state.harm.full += 1;
            return Err(full());
        }
        // On a disk that is nearly full the first bytes still find room.
        let count = end.min(room_bytes) - offset;
        let (from, to) = (offset as usize, (offset + count) as usize);
        if file.bytes.len() < to {
            file.bytes.resize(to, 0);
        }
        file.bytes[from..to].copy_from_slice(&bytes[..count as usize]);
        let grown = file.allocated_bytes() - before;
        state.used_bytes += grown;
        Ok(count as usize)
    }

    fn set_len(&self, bytes: u64) -> io::Result<()> {
        let mut state = self.mount.enter(Access::Writes)?;
        let file = state.file(self.node)?;
        file.bytes.resize(bytes as usize, 0);
        file.reserved_bytes = bytes;
        state.count_used();
        Ok(())
    }

    fn sync(&self, _metadata: bool) -> io::Result<()> {
        let mut state = self.mount.enter(Access::Writes)?;
        let file = state.file(self.node)?;
        file.flushed.clone_from(&file.bytes);
        Ok(())
    }

    fn reserve(&self, offset: u64, bytes: u64) -> io::Result<()> {
        let mut state = self.mount.enter(Access::Writes)?;
        let free_bytes = state.free_bytes();
        let file = state.file(self.node)?;
        let grown = (offset + bytes).saturating_sub(file.allocated_bytes());
        if grown > free_bytes {
            state.harm.full += 1;
            return Err(full());
        }
        file.reserved_bytes = file.reserved_bytes.max(offset + bytes);
        state.used_bytes += grown;
        Ok(())
    }

    fn metadata(&self) -> io::Result<Metadata> {
        let state = self.mount.enter(Access::Reads(&self.path))?;
        Ok(state.metadata(self.node))
    }

    fn try_lock(&self) -> Result<(), TryLockError> {
        let mut state = self.mount.enter(Access::Asks).map_err(TryLockError::Error)?;
        let process = state.process;
        let file = state.file(self.node).map_err(TryLockError::Error)?;
        match file.locked_by {
            Some(_) => Err(TryLockError::WouldBlock),
            None => {
                file.locked_by = Some(process);
                Ok(())
            }
        }
    }
}

impl Drop for SimFile {
    fn drop(&mut self) {
        let mut state = self.mount.disk.state();
        if state.process != self.mount.process {
            return;
        }
        if let Ok(file) = state.file(self.node) {
            file.opened -= 1;
            if file.opened == 0 {
                file.locked_by = None;
            }
            let is_unnamed = file.opened == 0 && file.links == 0;
            state.open_files -= 1;
            if is_unnamed {
                state.free_unnamed();
            }
        }
    }
}
