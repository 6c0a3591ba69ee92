//! Connections: how many there may be and how long a client may keep one waiting.
//!
//! hyper speaks HTTP/1.1 on each. Its own header timeout also runs while a connection idles between two requests, so it
//! cannot tell a slow request from a quiet client; [`Activity`] can. [`UnreadBody`] tells
//! what a request leaves behind.

mod activity;
mod limits;
mod registry;
mod unread;

use std::convert::Infallible;
use std::future::poll_fn;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::Response;
use http_body_util::BodyExt;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_io_timeout::TimeoutStream;
use tokio_util::io::InspectReader;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use crate::server::problem::Problem;
use activity::Activity;
pub use limits::{ConnectionLimits, raise_file_limit};
use registry::{ConnectionSlot, Registry};
use unread::UnreadBody;

/// Pause after the operating system gave no socket, e.g. because this process may open no more files.
const ACCEPT_RETRY_PAUSE: Duration = Duration::from_millis(50);

/// Longest time for which a client that was answered before it had sent its request is read from.
const LINGER: Duration = Duration::from_secs(60);
/// Longest time for which it may send nothing meanwhile.
const LINGER_IDLE_TIMEOUT: Duration = Duration::from_secs(5);

/// Serves connections until `stop` is cancelled, then closes the waiting ones and lets requests end for at most `drain`.
/// Returns whether all ended in time.
pub(super) async fn serve(
    listener: TcpListener,
    routes: Router,
    limits: ConnectionLimits,
    stop: CancellationToken,
    drain: Duration,
) -> bool {
    let limits = limits.within_the_file_limit();
    let registry = Arc::new(Registry::new(limits));
    let connections = TaskTracker::new();
    loop {
        let accepted = tokio::select! {
            () = stop.cancelled() => break,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => match registry.admit(peer.ip()) {
                Some(slot) => {
                    connections.spawn(connection(stream, peer, routes.clone(), limits, slot, stop.clone()));
                }
                None => reject(&stream, peer),
            },
            Err(error) => handle_accept_error(&error, &registry).await,
        }
    }
    drop(listener);
    connections.close();
    tokio::time::timeout(drain, connections.wait()).await.is_ok()
}

/// Serves one connection until it ends, its client is too slow, room is needed or the server stops.
async fn connection(
    stream: TcpStream,
    peer: SocketAddr,
    routes: Router,
    limits: ConnectionLimits,
    slot: ConnectionSlot,
    stop: CancellationToken,
) {
    let activity = slot.activity.clone();
    let io = TokioIo::new(watched(stream, limits, activity.clone()));
    let is_cut = AtomicBool::new(false);
    let service = service_fn(|request| Box::pin(answer(routes.clone(), request, activity.clone(), &is_cut)));
    let mut serving = http1::Builder::new().serve_connection(io, service);
    let ended = tokio::select! {
        result = poll_fn(|context| serving.poll_without_shutdown(context)) => Some(result),
        () = slot.activity.overdue(&limits) => return tracing::debug!(%peer, "sent no request in time"),
        () = slot.close.cancelled() => return tracing::debug!(%peer, "closed to make room"),
        () = stop.cancelled() => None,
    };
    let result = match ended {
        Some(result) => result,
        None if slot.activity.waiting_since().is_some() => return,
        None => {
            Pin::new(&mut serving).graceful_shutdown();
            poll_fn(|context| serving.poll_without_shutdown(context)).await
        }
    };
    if let Err(error) = result {
        return tracing::debug!(%peer, %error, "the connection broke off");
    }
    let stream = serving.into_parts().io.into_inner();
    tokio::select! {
        () = close(stream, is_cut.into_inner()) => {}
        () = slot.close.cancelled() => tracing::debug!(%peer, "closed to make room"),
        () = stop.cancelled() => {}
    }
}

/// Ends a connection whose last answer is sent. A client that is still sending then (`is_cut`) is read from for a while: to a
/// client that sends to a closed socket, the operating system may refuse the answer that waits for it.
async fn close(mut stream: impl AsyncRead + AsyncWrite + Unpin, is_cut: bool) {
    if stream.shutdown().await.is_err() || !is_cut {
        return;
    }
    let flows = async {
        let mut piece = vec![0; 16 << 10];
        // Whichever way this ends, nobody is told more.
        while let Ok(Ok(1..)) = tokio::time::timeout(LINGER_IDLE_TIMEOUT, stream.read(&mut piece)).await {}
    };
    let _ = tokio::time::timeout(LINGER, flows).await;
}

/// A stream that tells of bytes that arrive and fails when nothing can be written for too long.
fn watched(
    stream: TcpStream,
    limits: ConnectionLimits,
    activity: Arc<Activity>,
) -> impl AsyncRead + AsyncWrite + Unpin {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(limits.write));
    let arrived = move |bytes: &[u8]| {
        if !bytes.is_empty() {
            activity.received();
        }
    };
    Box::pin(InspectReader::new(stream, arrived))
}

/// Answers a request; the connection counts as busy until the last byte of the answer was handed over. Sets `is_cut` where the
/// client has not sent all of it.
async fn answer(
    routes: Router,
    request: hyper::Request<Incoming>,
    activity: Arc<Activity>,
    is_cut: &AtomicBool,
) -> Result<Response, Infallible> {
    let busy = activity.begin();
    let (head, body) = request.into_parts();
    let (unread, body) = UnreadBody::lend(&head.headers, body);
    let mut response = routes.oneshot(hyper::Request::from_parts(head, body)).await?;
    if !unread.drain_body().await {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
        is_cut.store(true, Ordering::Relaxed);
    }
    Ok(response.map(|body| {
        Body::new(body.map_frame(move |frame| {
            let _until_dropped = &busy;
            frame
        }))
    }))
}

/// Tells a client that there is no room, as far as that can be done without waiting for it.
fn reject(stream: &TcpStream, peer: SocketAddr) {
    tracing::warn!(%peer, "no room for another connection");
    let problem = Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", "Too many connections are open");
    let body = serde_json::to_string(&*problem.retry_after(1)).unwrap_or_default();
    let length = body.len();
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
         content-length: {length}\r\nconnection: close\r\n\r\n{body}"
    );
    // A client that does not take it now finds the connection closed.
    let _ = stream.try_write(answer.as_bytes());
}

/// A waiting connection gives its socket up; the next try comes after a pause, so that this does not spin.
async fn handle_accept_error(error: &std::io::Error, registry: &Registry) {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    if matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset) {
        return;
    }
    tracing::error!(%error, "no socket for another connection");
    registry.close_longest_waiting();
    tokio::time::sleep(ACCEPT_RETRY_PAUSE).await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::get;

    #[tokio::test]
    async fn client_disconnect_cancels_its_request_handler() {
        let (begun, dropped, stop) = <(CancellationToken, CancellationToken, CancellationToken)>::default();
        let (begins, drops) = (begun.clone(), dropped.clone());
        let handler = move || async move {
            let _when_dropped = drops.drop_guard();
            begins.cancel();
            std::future::pending::<()>().await;
        };
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let routes = Router::new().route("/", get(handler));
        let limits = ConnectionLimits::default();
        let server = tokio::spawn(serve(listener, routes, limits, stop.clone(), Duration::from_secs(60)));
        let mut client = TcpStream::connect(address).await.unwrap();
        client.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
        begun.cancelled().await;
        assert!(!dropped.is_cancelled());
        drop(client);
        tokio::time::timeout(Duration::from_secs(60), dropped.cancelled()).await.unwrap();
        stop.cancel();
        assert!(server.await.unwrap());
    }
}
