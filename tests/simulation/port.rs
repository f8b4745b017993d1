//! The port of the simulated line, as the daemon opens it.

use std::io;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use layerd::link::transport::{OpenError, SerialLine};
use layerd::link::{LinkSettings, Ports};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::host::{HostClock, Shared};
use crate::line::Line;

/// The port of the simulated line.
#[derive(Debug)]
pub(crate) struct SimPorts {
    shared: Arc<Shared>,
    clock: HostClock,
}

impl SimPorts {
    pub(crate) fn new(shared: &Arc<Shared>, clock: HostClock) -> Self {
        Self { shared: Arc::clone(shared), clock }
    }
}

impl Ports for SimPorts {
    fn open(&self, settings: &LinkSettings) -> Result<SerialLine, OpenError> {
        let now_us = self.clock.now_us();
        let mut line = self.shared.line();
        if !line.is_up(now_us) {
            return Err(OpenError::Missing(settings.path.clone()));
        }
        line.host_opens(now_us);
        let stream = || Port { shared: Arc::clone(&self.shared), clock: self.clock, opening: line.unpluggings() };
        Ok(SerialLine::new(stream(), stream()))
    }

    fn at(&self, _path: &Path) -> Option<u64> {
        self.shared.line().is_up(self.clock.now_us()).then_some(1)
    }
}

/// An open port; the same type reads and writes.
struct Port {
    shared: Arc<Shared>,
    clock: HostClock,
    /// How often the line had been unplugged when it was opened.
    opening: u64,
}

impl Port {
    fn check(&self, line: &Line, now_us: u64) -> io::Result<()> {
        // EIO, as of a converter that was pulled out.
        if line.is_up(now_us) && line.unpluggings() == self.opening {
            Ok(())
        } else {
            Err(io::Error::from_raw_os_error(5))
        }
    }
}

impl AsyncRead for Port {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let now_us = self.clock.now_us();
        let mut line = self.shared.line();
        if let Err(error) = self.check(&line, now_us) {
            return Poll::Ready(Err(error));
        }
        if !line.host_may_read(now_us) {
            self.shared.wait_to_read(context.waker());
            return Poll::Pending;
        }
        buffer.put_slice(&line.host_reads(buffer.remaining(), now_us));
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Port {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let now_us = self.clock.now_us();
        let mut line = self.shared.line();
        if let Err(error) = self.check(&line, now_us) {
            return Poll::Ready(Err(error));
        }
        match line.host_writes(bytes, now_us) {
            0 => {
                self.shared.wait_to_write(context.waker());
                Poll::Pending
            }
            count => {
                self.shared.attention.notify_one();
                Poll::Ready(Ok(count))
            }
        }
    }

    fn poll_flush(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
