//! The unread part of a request's body when its answer is ready.
//!
//! A connection can be reused only after the whole body is read. A short rest is read and discarded, so that the client can keep
//! its connection. With a longer rest the connection is closed and the answer says so; otherwise the client would send its next
//! request on it.

use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use hyper::body::{Frame, SizeHint};
use tokio::sync::oneshot;

/// Maximum number of bytes that are discarded.
const MAX_DRAINED_BYTES: usize = 64 << 10;
/// Maximum time for discarding.
const DRAIN_TIMEOUT: Duration = Duration::from_millis(100);

/// A body that is sent back to its owner when it is dropped.
struct LentBody<B> {
    body: Option<B>,
    is_begun: bool,
    is_over: bool,
    back: Option<oneshot::Sender<ReturnedBody<B>>>,
}

/// A body that its reader has dropped.
struct ReturnedBody<B> {
    body: B,
    is_begun: bool,
    is_over: bool,
}

/// A request's body while a handler has it.
pub(super) struct UnreadBody<B> {
    /// `None` if there is no body.
    back: Option<oneshot::Receiver<ReturnedBody<B>>>,
    /// Whether the client waits for `100 Continue`, which the first read of its body sends.
    waits: bool,
}

impl<B> UnreadBody<B>
where
    B: HttpBody<Data = Bytes> + Send + Unpin + 'static,
    B::Error: Into<axum::BoxError>,
{
    /// Lends the body of a request with these headers.
    pub(super) fn lend(headers: &HeaderMap, body: B) -> (Self, Body) {
        if body.is_end_stream() {
            return (Self { back: None, waits: false }, Body::empty());
        }
        let waits = headers.contains_key(header::EXPECT);
        let (sender, receiver) = oneshot::channel();
        let lent = LentBody { body: Some(body), is_begun: false, is_over: false, back: Some(sender) };
        (Self { back: Some(receiver), waits }, Body::new(lent))
    }

    /// Discards a short rest of the body. Returns whether no more of the body can arrive.
    pub(super) async fn drain_body(self) -> bool {
        match self.back.map(|mut back| back.try_recv()) {
            None => true,
            Some(Ok(rest)) if rest.is_over => true,
            Some(Ok(rest)) if rest.is_begun || !self.waits => take(rest.body).await,
            // The body was never requested from the client, or is still being read.
            Some(_) => false,
        }
    }
}

/// Discards a body within the limits. Returns whether its end was reached.
async fn take<B: HttpBody<Data = Bytes> + Unpin>(mut body: B) -> bool {
    let mut left = MAX_DRAINED_BYTES;
    let all = async {
        while let Some(frame) = body.frame().await {
            let Ok(frame) = frame else { return false };
            left = match left.checked_sub(frame.data_ref().map_or(0, Bytes::len)) {
                Some(left) => left,
                None => return false,
            };
        }
        true
    };
    tokio::time::timeout(DRAIN_TIMEOUT, all).await.unwrap_or(false)
}

impl<B: HttpBody<Data = Bytes> + Unpin> HttpBody for LentBody<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        self.is_begun = true;
        let Some(body) = &mut self.body else { return Poll::Ready(None) };
        let frame = ready!(Pin::new(body).poll_frame(context));
        self.is_over = !matches!(frame, Some(Ok(_)));
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.as_ref().is_none_or(HttpBody::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        self.body.as_ref().map_or_else(SizeHint::default, HttpBody::size_hint)
    }
}

impl<B> Drop for LentBody<B> {
    fn drop(&mut self) {
        if let (Some(back), Some(body)) = (self.back.take(), self.body.take()) {
            // If the request no longer exists, its body is not needed.
            let _ = back.send(ReturnedBody { body, is_begun: self.is_begun, is_over: self.is_over });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;
    use futures::StreamExt;

    /// Whether the end is reached for a body of `pieces` chunks of 1,000 bytes, of which `read` were read.
    async fn drained(pieces: usize, read: usize, headers: &HeaderMap) -> bool {
        let pieces = (0..pieces).map(|_| Ok::<_, std::io::Error>(Bytes::from(vec![0; 1000])));
        let (unread, lent) = UnreadBody::lend(headers, Body::from_stream(futures::stream::iter(pieces)));
        let mut lent = lent.into_data_stream();
        for _ in 0..read {
            lent.next().await;
        }
        drop(lent);
        unread.drain_body().await
    }

    #[tokio::test]
    async fn short_unread_bodies_are_drained_and_long_ones_are_not() {
        let none = HeaderMap::new();
        for (pieces, read) in [(0, 0), (3, 0), (3, 2), (3, 4), (60, 0), (2000, 1950), (2000, 2001)] {
            assert!(drained(pieces, read, &none).await, "{read} of {pieces} read");
        }
        for (pieces, read) in [(2000, 0), (2000, 1900)] {
            assert!(!drained(pieces, read, &none).await, "{read} of {pieces} read");
        }
    }

    #[tokio::test]
    async fn unread_body_with_expect_100_continue_is_not_drained() {
        let expect = HeaderMap::from_iter([(header::EXPECT, HeaderValue::from_static("100-continue"))]);
        assert!(!drained(3, 0, &expect).await);
        assert!(drained(3, 1, &expect).await, "the client is already sending");
    }

    #[tokio::test(start_paused = true)]
    async fn draining_does_not_wait_for_a_body_that_is_not_sent() {
        let never = Body::from_stream(futures::stream::pending::<Result<Bytes, std::io::Error>>());
        let (unread, lent) = UnreadBody::lend(&HeaderMap::new(), never);
        drop(lent);
        assert!(!unread.drain_body().await);
    }

    #[tokio::test]
    async fn a_body_still_held_by_a_reader_is_not_drained() {
        let (unread, lent) = UnreadBody::lend(&HeaderMap::new(), Body::from("all"));
        assert!(!unread.drain_body().await);
        drop(lent);
    }
}
