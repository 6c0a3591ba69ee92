//! Connections: how many there may be and how long a client may keep one waiting.
//!
//! hyper speaks HTTP/1.1 on each. Its own header timeout also runs while a connection idles between two requests, so it
//! cannot tell a slow request from a quiet client; [`Activity`] can.

mod activity;
mod limits;
mod registry;

use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::http::StatusCode;
use axum::response::Response;
use http_body_util::BodyExt;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio_io_timeout::TimeoutStream;
use tokio_util::io::InspectReader;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use crate::api::Problem;
use activity::Activity;
pub use limits::{ConnectionLimits, raise_file_limit};
use registry::{Registry, Ticket};

/// Pause after the operating system gave no socket, e.g. because this process may open no more files.
const NO_SOCKET_PAUSE: Duration = Duration::from_millis(50);

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
                Some(ticket) => {
                    connections.spawn(connection(stream, peer, routes.clone(), limits, ticket, stop.clone()));
                }
                None => turn_away(&stream, peer),
            },
            Err(error) => after_no_socket(&error, &registry).await,
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
    ticket: Ticket,
    stop: CancellationToken,
) {
    let activity = ticket.activity.clone();
    let io = TokioIo::new(watched(stream, limits, activity.clone()));
    let service = service_fn(|request| answer(routes.clone(), request, activity.clone()));
    let mut serving = pin!(http1::Builder::new().serve_connection(io, service));
    let ended = tokio::select! {
        result = serving.as_mut() => Some(result),
        () = ticket.activity.overdue(&limits) => return tracing::debug!(%peer, "sent no request in time"),
        () = ticket.close.cancelled() => return tracing::debug!(%peer, "closed to make room"),
        () = stop.cancelled() => None,
    };
    let result = match ended {
        Some(result) => result,
        None if ticket.activity.waiting_since().is_some() => return,
        None => {
            serving.as_mut().graceful_shutdown();
            serving.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%peer, %error, "the connection broke off");
    }
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

/// Answers a request; the connection counts as busy until the last byte of the answer was handed over.
async fn answer(
    routes: Router,
    request: hyper::Request<Incoming>,
    activity: Arc<Activity>,
) -> Result<Response, Infallible> {
    let busy = activity.begin();
    let response = routes.oneshot(request.map(Body::new) as Request).await?;
    Ok(response.map(|body| {
        Body::new(body.map_frame(move |frame| {
            let _until_dropped = &busy;
            frame
        }))
    }))
}

/// Tells a client that there is no room, as far as that can be done without waiting for it.
fn turn_away(stream: &TcpStream, peer: SocketAddr) {
    tracing::warn!(%peer, "no room for another connection");
    let problem = Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", "Too many connections are open");
    let body = serde_json::to_string(&problem.retry_after(1)).unwrap_or_default();
    let length = body.len();
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
         content-length: {length}\r\nconnection: close\r\n\r\n{body}"
    );
    // A client that does not take it now finds the connection closed.
    let _ = stream.try_write(answer.as_bytes());
}

/// A waiting connection gives its socket up; the next try comes after a pause, so that this does not spin.
async fn after_no_socket(error: &std::io::Error, registry: &Registry) {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    if matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset) {
        return;
    }
    tracing::error!(%error, "no socket for another connection");
    registry.make_room();
    tokio::time::sleep(NO_SOCKET_PAUSE).await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::get;
    use tokio::io::AsyncWriteExt;

    #[tokio::test]
    async fn when_a_client_goes_what_was_done_for_it_is_dropped() {
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
