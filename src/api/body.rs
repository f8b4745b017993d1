//! An HTTP body whose parts come through a channel: events for a subscriber, a build file for the daemon.
//! `daemon/http` and `cli/client` send with it.

use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};

use hyper::body::{Body, Bytes, Frame};
use tokio::sync::mpsc;

/// A body that ends when every sender is dropped.
#[derive(Debug)]
pub(crate) struct ChannelBody {
    parts: mpsc::Receiver<Bytes>,
}

impl ChannelBody {
    /// The sender of the parts and the body. At most two parts wait, so that the sender goes at the reader's pace.
    pub(crate) fn new() -> (mpsc::Sender<Bytes>, Self) {
        let (sender, parts) = mpsc::channel(2);
        (sender, Self { parts })
    }
}

impl Body for ChannelBody {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        self.parts.poll_recv(context).map(|part| part.map(|bytes| Ok(Frame::data(bytes))))
    }
}
