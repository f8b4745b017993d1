//! A body whose parts come through a channel: events to a subscriber, a build file to the daemon.

use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};

use hyper::body::{Body, Bytes, Frame};
use tokio::sync::mpsc;

/// Ends when every sender is dropped.
#[derive(Debug)]
pub(crate) struct ChannelBody {
    parts: mpsc::Receiver<Bytes>,
}

impl ChannelBody {
    /// The body and where its parts go. Two parts wait at most: the reader's pace is the writer's.
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
