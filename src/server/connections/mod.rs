//! Connections: their number, and their timeouts.
//!
//! hyper handles HTTP/1.1 on each connection. Its header timeout also runs while a connection is idle between two requests, so it
//! cannot distinguish a slow request from an idle client; [`Activity`] can. [`UnreadBody`] handles the rest of a request's body.

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

/// Pause after the operating system refused a socket, e.g. because the process reached its limit of open files.
const ACCEPT_RETRY_PAUSE: Duration = Duration::from_millis(50);

/// Maximum time for which the server reads from a client that was answered before the end of its request.
const LINGER: Duration = Duration::from_secs(60);
/// Timeout without bytes during this time.
const LINGER_IDLE_TIMEOUT: Duration = Duration::from_secs(5);

/// Serves connections until `stop` is cancelled, then closes the waiting ones and lets requests end for at most `drain`. Returns
/// whether all ended in time.
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

/// Serves one connection until it ends, times out, is evicted or the server stops.
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
        () = slot.activity.overdue(&limits) => return tracing::debug!(%peer, "closed the connection: no request in time"),
        () = slot.close.cancelled() => return tracing::debug!(%peer, "closed the connection for a new one"),
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
        return tracing::debug!(%peer, %error, "the connection broke");
    }
    let stream = serving.into_parts().io.into_inner();
    tokio::select! {
        () = close(stream, is_cut.into_inner()) => {}
        () = slot.close.cancelled() => tracing::debug!(%peer, "closed the connection for a new one"),
        () = stop.cancelled() => {}
    }
}

/// Closes a connection after its last answer. If the client is still sending (`is_cut`), the server reads from it for a while,
/// because the operating system may discard an answer for a client that sends to a closed socket.
async fn close(mut stream: impl AsyncRead + AsyncWrite + Unpin, is_cut: bool) {
    if stream.shutdown().await.is_err() || !is_cut {
        return;
    }
    let flows = async {
        let mut piece = vec![0; 16 << 10];
        // The result does not matter, because the connection is closed in all cases.
        while let Ok(Ok(1..)) = tokio::time::timeout(LINGER_IDLE_TIMEOUT, stream.read(&mut piece)).await {}
    };
    let _ = tokio::time::timeout(LINGER, flows).await;
}

/// A stream that records received bytes and fails if a write takes too long.
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

/// Answers a request. The connection counts as busy until the last byte of the answer is sent. Sets `is_cut` if the client has
/// not sent the whole request.
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

/// Refuses a client because of the connection limit, without waiting for the client.
fn reject(stream: &TcpStream, peer: SocketAddr) {
    tracing::warn!(%peer, "refused a connection: all connections are in use");
    let problem = Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", "Too many connections are open");
    let body = serde_json::to_string(&*problem.retry_after(1)).unwrap_or_default();
    let length = body.len();
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
         content-length: {length}\r\nconnection: close\r\n\r\n{body}"
    );
    // A client that does not accept this answer immediately sees a closed connection.
    let _ = stream.try_write(answer.as_bytes());
}

/// Closes a waiting connection to free its socket. The next attempt follows a pause, to avoid a busy loop.
async fn handle_accept_error(error: &std::io::Error, registry: &Registry) {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    if matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset) {
        return;
    }
    tracing::error!(%error, "cannot accept a connection");
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
