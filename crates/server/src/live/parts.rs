//! The live view as a stream of JPEGs in parts.

use super::Watching;
use axum::body::{Bytes, HttpBody};
use hyper::body::Frame;
use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::sync::mpsc::{self, Receiver};

/// A body that goes on.
pub(crate) struct Parts(Receiver<Bytes>);

/// The frames of one who watches. Who is slow is sent the newest.
pub(crate) fn parts(mut watching: Watching) -> Parts {
    let (send, parts) = mpsc::channel(1);
    tokio::spawn(async move {
        while watching.frames.changed().await.is_ok() {
            let newest = watching.frames.borrow_and_update().clone();
            let Some(newest) = newest else { continue };
            let head = format!(
                "--frame\r\ncontent-type: image/jpeg\r\ncontent-length: {}\r\n\r\n",
                newest.jpeg.len()
            );
            let part = [head.as_bytes(), &newest.jpeg, b"\r\n"].concat();
            if send.send(part.into()).await.is_err() {
                return;
            }
        }
    });
    Parts(parts)
}

impl HttpBody for Parts {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        self.0
            .poll_recv(cx)
            .map(|part| part.map(|part| Ok(Frame::data(part))))
    }
}
