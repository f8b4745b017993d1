//! What is on the simulated disk: files and directories, as they are and as they were flushed.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};

use layerd::system::{FileKind, Metadata};

use super::Harm;
use crate::rng::Rng;

/// Room on the disk, bytes: beside what the daemon wants to be left free, that of some parts.
pub(super) const CAPACITY_BYTES: u64 = 64 << 20;
/// Bytes that are lost or kept together.
const BLOCK_BYTES: usize = 512;
pub(super) const ROOT: u64 = 1;
/// Stands for an observer: faults of the disk do not affect it.
pub(super) const OUTSIDE: u32 = u32::MAX;

#[derive(Debug)]
pub(super) struct State {
    pub(super) nodes: BTreeMap<u64, Node>,
    pub(super) next_node: u64,
    pub(super) rng: Rng,
    /// The process that is alive.
    pub(super) process: u32,
    /// Calls that the process may still make before it is killed in the middle of its work.
    pub(super) calls_left: Option<u32>,
    /// Space that other programs take, bytes.
    pub(super) taken_bytes: u64,
    pub(super) used_bytes: u64,
    /// Writing calls that fail with an input/output error, of a million.
    pub(super) broken_per_million: u32,
    /// What cannot be read.
    pub(super) unreadable: Option<Unreadable>,
    /// Files that the living process has open.
    pub(super) open_files: usize,
    pub(super) harm: Harm,
}

/// Files and directories whose reading fails with an input/output error.
#[derive(Clone, Debug)]
pub(crate) struct Unreadable {
    /// Where they are.
    pub(crate) below: PathBuf,
    /// Their name; `None` for all.
    pub(crate) name: Option<&'static str>,
    /// Calls that fail, of a million.
    pub(crate) per_million: u32,
}

/// What a call does.
#[derive(Clone, Copy, Debug)]
pub(super) enum Access<'a> {
    /// It reads this file or directory, or what is known of it.
    Reads(&'a Path),
    /// It changes the disk.
    Writes,
    /// It does neither.
    Asks,
}

#[derive(Debug)]
pub(super) enum Node {
    File(FileNode),
    Directory(DirectoryNode),
}

#[derive(Debug, Default)]
pub(super) struct FileNode {
    pub(super) bytes: Vec<u8>,
    pub(super) flushed: Vec<u8>,
    /// Space is set aside up to here.
    pub(super) reserved_bytes: u64,
    pub(super) links: u64,
    /// How many open files lead to it; the node stays as long.
    pub(super) opened: usize,
    pub(super) locked_by: Option<u32>,
}

#[derive(Debug, Default)]
pub(super) struct DirectoryNode {
    pub(super) names: BTreeMap<String, u64>,
    pub(super) flushed: BTreeMap<String, u64>,
    /// Changes since the last flush: a name, and what it leads to then. A new name in the same directory comes before the old one goes.
    pub(super) changes: Vec<(String, Option<u64>)>,
    /// Places in `changes` that happen together with the one before: a rename is lost whole or not at all.
    pub(super) joined: Vec<usize>,
}

pub(super) fn names(path: &Path) -> impl Iterator<Item = String> + '_ {
    path.components().filter_map(|part| match part {
        Component::Normal(name) => Some(name.to_string_lossy().into_owned()),
        _ => None,
    })
}

pub(super) fn full() -> io::Error {
    io::Error::from_raw_os_error(28)
}

pub(super) fn broken() -> io::Error {
    io::Error::from_raw_os_error(5)
}

impl State {
    pub(super) fn add(&mut self, node: Node) -> u64 {
        let number = self.next_node;
        self.next_node += 1;
        self.nodes.insert(number, node);
        number
    }

    pub(super) fn end_process(&mut self) {
        self.process += 1;
        (self.calls_left, self.open_files) = (None, 0);
        for node in self.nodes.values_mut() {
            if let Node::File(file) = node {
                (file.opened, file.locked_by) = (0, None);
            }
        }
        self.free_unnamed();
    }

    /// Checks that `process` is alive and that the disk can do what the call asks, and counts the call.
    pub(super) fn enter(&mut self, process: u32, access: Access<'_>) -> io::Result<()> {
        if process == OUTSIDE {
            return Ok(());
        }
        if process != self.process || self.calls_left == Some(0) {
            return Err(broken());
        }
        if let Some(left) = &mut self.calls_left {
            *left -= 1;
            if *left == 0 {
                return Err(broken());
            }
        }
        match access {
            Access::Writes if self.rng.per_million(self.broken_per_million) => self.harm.failed += 1,
            Access::Reads(path) if self.cannot_read(path) => self.harm.unread += 1,
            _ => return Ok(()),
        }
        Err(broken())
    }

    fn cannot_read(&mut self, path: &Path) -> bool {
        let Some(Unreadable { below, name, per_million }) = &self.unreadable else { return false };
        let is_meant = path.starts_with(below) && name.is_none_or(|name| path.ends_with(name));
        is_meant && self.rng.per_million(*per_million)
    }

    pub(super) fn directory(&self, node: u64) -> Option<&DirectoryNode> {
        match self.nodes.get(&node) {
            Some(Node::Directory(directory)) => Some(directory),
            _ => None,
        }
    }

    pub(super) fn file(&mut self, node: u64) -> io::Result<&mut FileNode> {
        match self.nodes.get_mut(&node) {
            Some(Node::File(file)) => Ok(file),
            _ => Err(ErrorKind::IsADirectory.into()),
        }
    }

    pub(super) fn find(&self, path: &Path) -> io::Result<u64> {
        names(path).try_fold(ROOT, |node, name| {
            let directory = self.directory(node).ok_or(ErrorKind::NotADirectory)?;
            directory.names.get(&name).copied().ok_or_else(|| io::Error::from_raw_os_error(2))
        })
    }

    /// The directory of a path, and the name in it.
    pub(super) fn parent(&self, path: &Path) -> io::Result<(u64, String)> {
        let name = path.file_name().ok_or(ErrorKind::InvalidInput)?.to_string_lossy().into_owned();
        let parent = self.find(path.parent().unwrap_or(Path::new("/")))?;
        self.directory(parent).ok_or(ErrorKind::NotADirectory)?;
        Ok((parent, name))
    }

    pub(super) fn set_name(&mut self, directory: u64, name: String, to: Option<u64>) {
        let Some(Node::Directory(directory)) = self.nodes.get_mut(&directory) else { return };
        match to {
            Some(node) => directory.names.insert(name.clone(), node),
            None => directory.names.remove(&name),
        };
        directory.changes.push((name, to));
    }

    /// The last two changes of a directory happen together.
    pub(super) fn join_last_changes(&mut self, node: u64) {
        if let Some(Node::Directory(directory)) = self.nodes.get_mut(&node) {
            directory.joined.push(directory.changes.len() - 1);
        }
    }

    pub(super) fn flush_directory(&mut self, node: u64) {
        if let Some(Node::Directory(directory)) = self.nodes.get_mut(&node) {
            directory.flushed.clone_from(&directory.names);
            directory.changes.clear();
            directory.joined.clear();
        }
    }

    pub(super) fn free_bytes(&self) -> u64 {
        CAPACITY_BYTES.saturating_sub(self.used_bytes + self.taken_bytes)
    }

    pub(super) fn metadata(&self, node: u64) -> Metadata {
        let (kind, length_bytes, allocated_bytes, links) = match self.nodes.get(&node) {
            Some(Node::File(file)) => (FileKind::File, file.bytes.len() as u64, file.allocated_bytes(), file.links),
            _ => (FileKind::Directory, 0, 0, 1),
        };
        Metadata { kind, length_bytes, allocated_bytes, links, identity: (7, node) }
    }

    /// Frees files without a name, in memory and on the disk, that nobody has open.
    pub(super) fn free_unnamed(&mut self) {
        let mut named: BTreeMap<u64, u64> = BTreeMap::new();
        for node in self.nodes.values() {
            if let Node::Directory(directory) = node {
                directory.names.values().for_each(|node| *named.entry(*node).or_default() += 1);
                directory.flushed.values().for_each(|node| {
                    named.entry(*node).or_default();
                });
                directory.changes.iter().filter_map(|(_, node)| *node).for_each(|node| {
                    named.entry(node).or_default();
                });
            }
        }
        self.nodes.retain(|number, node| match node {
            Node::File(file) => {
                file.links = named.get(number).copied().unwrap_or(0);
                file.opened > 0 || named.contains_key(number)
            }
            Node::Directory(_) => *number == ROOT || named.contains_key(number),
        });
        self.count_used();
    }

    pub(super) fn count_used(&mut self) {
        let files = self.nodes.values().filter_map(|node| match node {
            Node::File(file) if file.links > 0 || file.opened > 0 => Some(file.allocated_bytes()),
            _ => None,
        });
        self.used_bytes = files.sum();
    }

    pub(super) fn lose_unflushed(&mut self) {
        for node in self.nodes.values_mut() {
            match node {
                Node::File(file) if file.bytes != file.flushed => {
                    self.harm.lost += 1;
                    file.tear(&mut self.rng);
                }
                Node::File(_) => {}
                Node::Directory(directory) if !directory.changes.is_empty() => {
                    let mut kept = self.rng.below(directory.changes.len() as u64 + 1) as usize;
                    if directory.joined.contains(&kept) {
                        kept += 1;
                    }
                    directory.joined.clear();
                    self.harm.lost_names += (directory.changes.len() - kept) as u64;
                    for (name, node) in directory.changes.drain(..).take(kept) {
                        match node {
                            Some(node) => directory.flushed.insert(name, node),
                            None => directory.flushed.remove(&name),
                        };
                    }
                    directory.names.clone_from(&directory.flushed);
                }
                Node::Directory(_) => {}
            }
        }
        self.free_unnamed();
    }
}

impl FileNode {
    pub(super) fn allocated_bytes(&self) -> u64 {
        self.reserved_bytes.max(self.bytes.len() as u64)
    }

    /// Keeps what was flushed, and a random beginning of what was written since.
    pub(super) fn tear(&mut self, rng: &mut Rng) {
        let common = self.bytes.iter().zip(&self.flushed).take_while(|(now, then)| now == then).count();
        let kept = common + rng.below((self.bytes.len() - common) as u64 + 1) as usize;
        if rng.below(4) == 0 || kept == common {
            // Nothing of it reached the disk.
            self.bytes.clone_from(&self.flushed);
        } else {
            self.bytes.truncate(kept);
            if rng.below(4) == 0 {
                // Its length did, the last block did not.
                let from = common.max(kept.saturating_sub(1) / BLOCK_BYTES * BLOCK_BYTES);
                self.bytes[from..].fill(0);
            }
        }
        self.flushed.clone_from(&self.bytes);
        self.reserved_bytes = self.reserved_bytes.min(self.bytes.len() as u64);
    }
}
