//! One attempt of a delivery: sends the message and reads the status. Redirects are not followed.

use axum::body::Bytes;
use axum::http::{HeaderValue, Method, Request, StatusCode, header};
use http_body_util::{BodyExt, Full, Limited};

use crate::server::outbound::{self, OutboundTarget, Tls};
use crate::server::webhooks::policy::WebhookPolicy;

/// Maximum bytes that are read of an answer's body. They are discarded.
const MAX_RESPONSE_BYTES: usize = 64 << 10;

/// A message with its signature.
pub(super) struct Message {
    pub(super) id: String,
    /// Seconds since 1970 UTC.
    pub(super) seconds: i64,
    pub(super) signature: String,
    pub(super) body: String,
}

/// The result of an attempt: the status of the answer, if any, and the error, if any.
pub(super) struct DeliveryOutcome {
    pub(super) status: Option<u16>,
    pub(super) error: Option<String>,
}

/// Sends a message.
pub(super) async fn send(url: &str, message: Message, policy: &WebhookPolicy, tls: &Tls) -> DeliveryOutcome {
    let answered = tokio::time::timeout(policy.timeout, attempt(url, message, policy, tls)).await;
    let answered = answered.unwrap_or_else(|_| Err("the receiver did not answer in time".to_owned()));
    match answered {
        Ok(status) if status.is_success() => DeliveryOutcome { status: Some(status.as_u16()), error: None },
        Ok(status) => {
            let why = if status.is_redirection() { "; redirects are not followed" } else { "" };
            let error = Some(format!("the receiver answered {}{why}", status.as_u16()));
            DeliveryOutcome { status: Some(status.as_u16()), error }
        }
        Err(error) => DeliveryOutcome { status: None, error: Some(error) },
    }
}

async fn attempt(
    url: &str,
    message: Message,
    policy: &WebhookPolicy,
    tls: &Tls,
) -> Result<StatusCode, String> {
    let target = OutboundTarget::parse(url, policy.allow_http).map_err(|why| format!("the URL {why}"))?;
    let request = request(message).map_err(|error| error.to_string())?;
    let mut answer = outbound::ask(&target, policy.allow_private, tls, request).await?;
    // Only the status matters. The body is read so that the receiver can finish its answer.
    let _ = Limited::new(answer.response.body_mut(), MAX_RESPONSE_BYTES).collect().await;
    Ok(answer.response.status())
}

fn request(message: Message) -> Result<Request<Full<Bytes>>, axum::http::Error> {
    Request::builder()
        .method(Method::POST)
        .header(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))
        .header("webhook-id", message.id)
        .header("webhook-timestamp", message.seconds)
        .header("webhook-signature", message.signature)
        .body(Full::new(message.body.into()))
}
