//! One attempt to deliver: look up, check, connect, send, read the status. Nothing is followed.

use axum::body::Bytes;
use axum::http::{HeaderValue, Request, StatusCode, header};
use http_body_util::{BodyExt, Full, Limited};
use hyper::client::conn::http1::handshake;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_util::task::AbortOnDropHandle;

use crate::server::webhooks::target::{Target, WebhookPolicy};
use crate::server::webhooks::tls::Tls;

/// Most that is read of an answer's body. Nothing of it is kept.
const MOST_OF_ANSWER: usize = 64 << 10;
const USER_AGENT: &str = concat!("relume/", env!("CARGO_PKG_VERSION"));

/// A message that is signed.
pub(super) struct Message {
    pub(super) id: String,
    /// Seconds since 1970 UTC.
    pub(super) seconds: i64,
    pub(super) signature: String,
    pub(super) body: String,
}

/// What came of an attempt: the status of the answer if there was one, and what is wrong with it.
pub(super) struct Outcome {
    pub(super) status: Option<u16>,
    pub(super) error: Option<String>,
}

/// Sends a message.
pub(super) async fn send(url: &str, message: Message, policy: &WebhookPolicy, tls: &Tls) -> Outcome {
    let answered = tokio::time::timeout(policy.timeout, attempt(url, message, policy, tls)).await;
    let answered = answered.unwrap_or_else(|_| Err("it did not answer in time".to_owned()));
    match answered {
        Ok(status) if status.is_success() => Outcome { status: Some(status.as_u16()), error: None },
        Ok(status) => {
            let why = if status.is_redirection() { "; redirects are not followed" } else { "" };
            let error = Some(format!("it answered {}{why}", status.as_u16()));
            Outcome { status: Some(status.as_u16()), error }
        }
        Err(error) => Outcome { status: None, error: Some(error) },
    }
}

async fn attempt(
    url: &str,
    message: Message,
    policy: &WebhookPolicy,
    tls: &Tls,
) -> Result<StatusCode, String> {
    let target = Target::parse(url, policy).map_err(|why| format!("the URL {why}"))?;
    // Looked up once: what was checked is what is connected to.
    let addresses = target.addresses(policy).await?;
    let connected = TcpStream::connect(addresses.as_slice()).await;
    let stream = connected.map_err(|error| format!("no connection: {error}"))?;
    let request = request(&target, message).map_err(|error| error.to_string())?;
    if target.is_https {
        exchange(tls.over(stream, &target.host).await?, request).await
    } else {
        exchange(stream, request).await
    }
}

fn request(target: &Target, message: Message) -> Result<Request<Full<Bytes>>, axum::http::Error> {
    Request::post(&target.path)
        .header(header::HOST, &target.authority)
        .header(header::USER_AGENT, USER_AGENT)
        .header(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))
        .header(header::CONNECTION, HeaderValue::from_static("close"))
        .header("webhook-id", message.id)
        .header("webhook-timestamp", message.seconds)
        .header("webhook-signature", message.signature)
        .body(Full::new(message.body.into()))
}

/// Sends a request and reads the answer, its body up to a bound.
async fn exchange<S>(stream: S, request: Request<Full<Bytes>>) -> Result<StatusCode, String>
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let failed = |error: hyper::Error| format!("no answer: {error}");
    let (mut sender, connection) = handshake(TokioIo::new(stream)).await.map_err(failed)?;
    let _connection = AbortOnDropHandle::new(tokio::spawn(connection));
    let (head, body) = sender.send_request(request).await.map_err(failed)?.into_parts();
    // The status counts, whatever follows: the body is only taken so that the receiver is not cut off.
    let _ = Limited::new(body, MOST_OF_ANSWER).collect().await;
    Ok(head.status)
}
