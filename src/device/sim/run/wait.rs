//! What the loop of a simulated device waits for: the line, or a timer. Part of [`run`](fn@super::run).

use std::io;
use std::os::fd::AsFd;
use std::time::Duration;

use tokio::io::unix::AsyncFd;

use crate::device::sim::pty::Pty;

/// What the loop waits for.
pub(super) struct Wait<'a> {
    pub(super) pty: Option<&'a AsyncFd<Pty>>,
    pub(super) readable: usize,
    pub(super) writable: &'a [u8],
    pub(super) sleep_us: u64,
}

pub(super) enum Woken {
    Timer,
    Read(io::Result<usize>),
    Written(io::Result<usize>),
}

impl Wait<'_> {
    pub(super) async fn wait(self, buffer: &mut [u8]) -> Woken {
        let sleep = tokio::time::sleep(Duration::from_micros(self.sleep_us));
        let Some(pty) = self.pty else {
            sleep.await;
            return Woken::Timer;
        };
        tokio::select! {
            read = async { loop {
                let mut guard = match pty.readable().await { Ok(guard) => guard, Err(error) => break Err(error) };
                let read = |pty: &AsyncFd<Pty>| {
                    Ok(rustix::io::read(pty.get_ref().as_fd(), &mut buffer[..self.readable])?)
                };
                if let Ok(done) = guard.try_io(read) { break done }
            }}, if self.readable > 0 => Woken::Read(read),
            written = async { loop {
                let mut guard = match pty.writable().await { Ok(guard) => guard, Err(error) => break Err(error) };
                let write = |pty: &AsyncFd<Pty>| Ok(rustix::io::write(pty.get_ref().as_fd(), self.writable)?);
                if let Ok(done) = guard.try_io(write) { break done }
            }}, if !self.writable.is_empty() => Woken::Written(written),
            () = sleep => Woken::Timer,
        }
    }
}
