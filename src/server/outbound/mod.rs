//! Outbound connections that a caller requests. Only checked addresses are connected to.

mod target;
mod tls;

use std::error::Error;

use axum::body::{Body, Bytes};
use axum::http::{HeaderValue, Request, Response, header};
use hyper::body::Incoming;
use hyper::client::conn::http1::handshake;
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio_util::either::Either;
use tokio_util::task::AbortOnDropHandle;

pub(super) use target::OutboundTarget;
pub(super) use tls::Tls;

const USER_AGENT: &str = concat!("relume/", env!("CARGO_PKG_VERSION"));

/// An answer with the connection of its body.
pub(super) struct Answer {
    pub(super) response: Response<Incoming>,
    _connection: AbortOnDropHandle<Result<(), hyper::Error>>,
}

/// Sends a request to `target` over a new connection. The URI of the request is the path of the target. Redirects are not
/// followed.
///
/// # Errors
/// The reason why there is no answer.
pub(super) async fn ask<B>(
    target: &OutboundTarget,
    allow_private: bool,
    tls: &Tls,
    mut request: Request<B>,
) -> Result<Answer, String>
where
    B: axum::body::HttpBody<Data = Bytes> + Send + 'static,
    B::Error: Into<Box<dyn Error + Send + Sync>>,
{
    // The name is resolved once, so that the connected address is the checked one.
    let addresses = target.addresses(allow_private).await?;
    let connected = TcpStream::connect(addresses.as_slice()).await;
    let stream = connected.map_err(|error| format!("the connection failed: {error}"))?;
    let stream = match target.is_https {
        true => Either::Left(tls.over(stream, &target.host).await?),
        false => Either::Right(stream),
    };
    *request.uri_mut() = target.path.parse().map_err(|_| "the URL has no path".to_owned())?;
    let host = HeaderValue::from_str(&target.authority).map_err(|_| "the URL names no host".to_owned())?;
    for (name, value) in [
        (header::HOST, host),
        (header::USER_AGENT, HeaderValue::from_static(USER_AGENT)),
        (header::CONNECTION, HeaderValue::from_static("close")),
    ] {
        request.headers_mut().insert(name, value);
    }
    let failed = |error: hyper::Error| format!("the request failed: {error}");
    let (mut sender, connection) = handshake(TokioIo::new(stream)).await.map_err(failed)?;
    let _connection = AbortOnDropHandle::new(tokio::spawn(connection));
    let response = sender.send_request(request.map(Body::new)).await.map_err(failed)?;
    Ok(Answer { response, _connection })
}
