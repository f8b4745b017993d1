//! The device's end of a pseudo-terminal, which can be cut and come back.

use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

use layerd::device::sim::Pty;
use rustix::io::Errno;

/// How long a turn of the peer lasts where nothing comes: its clock is as fine as that.
const TURN: Duration = Duration::from_millis(2);

/// A line under a name of its own.
pub(super) struct Line {
    link: PathBuf,
    pty: Option<Pty>,
    back_at_us: u64,
    /// What the pseudo-terminal did not take yet.
    unwritten: Vec<u8>,
}

impl Line {
    pub(super) fn open(link: &Path) -> Self {
        let mut line = Self { link: link.into(), pty: None, back_at_us: 0, unwritten: Vec::new() };
        line.reopen(0);
        line
    }

    /// The line is gone until that time.
    pub(super) fn cut(&mut self, back_at_us: u64) {
        self.pty = None;
        self.back_at_us = back_at_us;
        self.unwritten.clear();
    }

    /// Brings a new line once it is time.
    pub(super) fn reopen(&mut self, now_us: u64) {
        if self.pty.is_none() && now_us >= self.back_at_us {
            self.pty = Some(Pty::open(&self.link).expect("a pseudo-terminal"));
        }
    }

    /// Lets another host open it, see [`Pty::release`].
    pub(super) fn release(&self) {
        if let Some(pty) = &self.pty {
            pty.release();
        }
    }

    pub(super) fn wants_frame(&self) -> bool {
        self.pty.is_some() && self.unwritten.is_empty()
    }

    pub(super) fn write(&mut self, frame: &[u8]) {
        self.unwritten.extend_from_slice(frame);
        let Some(pty) = self.pty.as_ref().filter(|_| !self.unwritten.is_empty()) else { return };
        match rustix::io::write(pty.as_fd(), &self.unwritten) {
            Ok(count) => drop(self.unwritten.drain(..count)),
            // The host does not read.
            Err(Errno::AGAIN) => {}
            Err(error) => panic!("the line cannot be written: {error}"),
        }
    }

    /// What came; waits a turn where nothing did.
    pub(super) fn read(&mut self) -> Vec<u8> {
        self.write(&[]);
        let mut buffer = [0; 4096];
        let count = match self.pty.as_ref().map_or(Err(Errno::AGAIN), |pty| rustix::io::read(pty.as_fd(), &mut buffer))
        {
            Ok(count) => count,
            Err(Errno::AGAIN) => {
                std::thread::sleep(TURN);
                0
            }
            Err(error) => panic!("the line cannot be read: {error}"),
        };
        buffer[..count].to_vec()
    }
}
