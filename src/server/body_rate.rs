//! The minimum rate of a request's body. A client that sends single bytes would otherwise occupy a slot of the uploads for as long as
//! it wants.

use std::error::Error;
use std::fmt;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::BoxError;
use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use hyper::body::{Frame, SizeHint};
use tokio::time::Instant;

/// Time for which the server waits for a client before the rate counts.
const GRACE: Duration = Duration::from_secs(60);

/// The body arrived more slowly than the minimum rate.
#[derive(Debug)]
pub(super) struct BodyTooSlow;

impl fmt::Display for BodyTooSlow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the body arrived more slowly than the minimum rate")
    }
}

impl Error for BodyTooSlow {}

/// Ends bodies that arrive with fewer bytes per second than the state. The rate counts after [`GRACE`], and only while the server
/// waits for the client.
pub(super) async fn limit(State(bytes_per_second): State<u64>, request: Request, next: Next) -> Response {
    next.run(request.map(|body| Body::new(RatedBody::new(body, bytes_per_second)))).await
}

/// A body with a minimum rate.
struct RatedBody {
    body: Body,
    bytes_per_second: u64,
    received: u64,
    /// Time for which the server has waited for the client.
    waited: Duration,
    /// Start of the present wait.
    waits_since: Option<Instant>,
}

impl RatedBody {
    fn new(body: Body, bytes_per_second: u64) -> Self {
        Self { body, bytes_per_second, received: 0, waited: Duration::ZERO, waits_since: None }
    }

    fn is_too_slow(&self) -> bool {
        let counted = self.waited.saturating_sub(GRACE);
        (self.received as f64) < self.bytes_per_second as f64 * counted.as_secs_f64()
    }
}

impl HttpBody for RatedBody {
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        if polled.is_pending() {
            self.waits_since.get_or_insert_with(Instant::now);
        }
        let frame = ready!(polled);
        if let Some(since) = self.waits_since.take() {
            self.waited += since.elapsed();
        }
        Poll::Ready(frame.map(|frame| {
            let frame = frame?;
            self.received += frame.data_ref().map_or(0, |data| data.len() as u64);
            if self.is_too_slow() { Err(BodyTooSlow.into()) } else { Ok(frame) }
        }))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use http_body_util::BodyExt;

    use crate::server::extract::is_too_slow;

    /// A body of `chunks` chunks of `bytes` bytes, one every ten seconds.
    fn body(chunks: usize, bytes: usize) -> Body {
        Body::from_stream(futures::stream::unfold(0, move |sent| async move {
            if sent == chunks {
                return None;
            }
            tokio::time::sleep(Duration::from_secs(10)).await;
            Some((Ok::<_, BoxError>(Bytes::from(vec![0; bytes])), sent + 1))
        }))
    }

    async fn received(body: Body) -> Result<usize, axum::Error> {
        let rated = Body::new(RatedBody::new(body, 1000));
        axum::body::to_bytes(rated, usize::MAX).await.map(|bytes| bytes.len())
    }

    #[tokio::test(start_paused = true)]
    async fn slow_bodies_end_after_the_grace() {
        // Single bytes, within the grace and beyond it.
        assert_eq!(received(body(6, 1)).await.unwrap(), 6);
        let error = received(body(7, 1)).await.unwrap_err();
        assert!(is_too_slow(&error), "{error}");
        // An hour at twice the rate, and at half of it.
        assert_eq!(received(body(360, 20_000)).await.unwrap(), 7_200_000);
        assert!(received(body(360, 5_000)).await.is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn time_in_which_the_server_does_not_read_is_not_counted() {
        let mut rated = RatedBody::new(Body::from(vec![0; 10]), 1000);
        tokio::time::sleep(Duration::from_secs(3600)).await;
        assert!(rated.frame().await.unwrap().is_ok());
    }
}
