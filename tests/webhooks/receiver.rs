//! A receiver of webhooks on loopback, and a verifier of signatures that shares no code with the server.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use relume_api::WebhookId;
use relume_api::webhooks::{DeliveryView, NewWebhook, WebhookEvent};
use relume_client::Client;
use serde_json::Value;
use sha2::{Digest, Sha256};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// A request that was received.
#[derive(Debug)]
pub struct Received {
    pub path: String,
    pub headers: HeaderMap,
    pub body: String,
}

impl Received {
    pub fn header(&self, name: &str) -> &str {
        self.headers[name].to_str().unwrap()
    }

    pub fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap()
    }

    pub fn job(&self) -> String {
        self.json()["data"]["job"]["id"].as_str().unwrap().to_owned()
    }
}

/// The next answer; 200 by default.
#[derive(Clone, Copy)]
pub enum Answer {
    Status(u16),
    /// A redirect to another path of the same receiver.
    Redirect,
    /// A body that never ends.
    Endless,
    Never,
}

#[derive(Clone)]
struct Shared {
    heard: UnboundedSender<Received>,
    answers: Arc<Mutex<VecDeque<Answer>>>,
}

/// A receiver.
pub struct Receiver {
    pub url: String,
    heard: UnboundedReceiver<Received>,
    answers: Arc<Mutex<VecDeque<Answer>>>,
}

impl Receiver {
    pub async fn new() -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/hook?to=me", listener.local_addr().unwrap());
        let (sender, heard) = unbounded_channel();
        let answers = Arc::<Mutex<VecDeque<Answer>>>::default();
        let app = Router::new().fallback(hear).with_state(Shared { heard: sender, answers: answers.clone() });
        tokio::spawn(async move { axum::serve(listener, app).await });
        Self { url, heard, answers }
    }

    /// Sets the next answers, in order.
    pub fn answer(&self, answers: &[Answer]) {
        self.answers.lock().unwrap().extend(answers);
    }

    /// The next request.
    pub async fn next(&mut self) -> Received {
        let next = tokio::time::timeout(Duration::from_secs(60), self.heard.recv()).await;
        next.expect("nothing comes").unwrap()
    }

    /// Whether no unread request was received.
    pub fn is_silent(&mut self) -> bool {
        self.heard.try_recv().is_err()
    }
}

async fn hear(State(shared): State<Shared>, uri: Uri, headers: HeaderMap, body: Bytes) -> Response {
    let answer = shared.answers.lock().unwrap().pop_front().unwrap_or(Answer::Status(200));
    let body = String::from_utf8(body.to_vec()).unwrap();
    shared.heard.send(Received { path: uri.to_string(), headers, body }).ok();
    match answer {
        Answer::Status(status) => (StatusCode::from_u16(status).unwrap(), "seen").into_response(),
        Answer::Redirect => (StatusCode::FOUND, [(header::LOCATION, "/elsewhere")]).into_response(),
        Answer::Endless => {
            let pieces =
                futures::stream::repeat(Ok::<_, std::convert::Infallible>(Bytes::from_static(&[b'x'; 4096])));
            axum::body::Body::from_stream(pieces).into_response()
        }
        Answer::Never => std::future::pending().await,
    }
}

/// A webhook for all final states of jobs.
pub fn for_all(url: &str) -> NewWebhook {
    let events = vec![
        WebhookEvent::JobSucceeded,
        WebhookEvent::JobRejected,
        WebhookEvent::JobFailed,
        WebhookEvent::JobCancelled,
    ];
    NewWebhook { url: url.to_owned(), events, name: None }
}

/// The newest delivery of a webhook, when `done` is true for it.
pub async fn newest(client: &Client, id: &WebhookId, done: impl Fn(&DeliveryView) -> bool) -> DeliveryView {
    for _ in 0..3000 {
        let deliveries = client.deliveries(id).await.unwrap().items;
        if let Some(found) = deliveries.into_iter().next().filter(&done) {
            return found;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("{:?}", client.deliveries(id).await);
}

/// Whether the signatures of a request include that of a secret: HMAC according to RFC 2104.
pub fn is_signed(secret: &str, received: &Received) -> bool {
    let key = STANDARD.decode(secret.strip_prefix("whsec_").unwrap()).unwrap();
    let padded = |with: u8| -> Vec<u8> {
        let mut block = key.clone();
        block.resize(64, 0);
        block.into_iter().map(|byte| byte ^ with).collect()
    };
    let (id, time) = (received.header("webhook-id"), received.header("webhook-timestamp"));
    let text = format!("{id}.{time}.{}", received.body);
    let inner = Sha256::digest([padded(0x36), text.into_bytes()].concat());
    let outer = Sha256::digest([padded(0x5c), inner.to_vec()].concat());
    let signature = format!("v1,{}", STANDARD.encode(outer));
    received.header("webhook-signature").split(' ').any(|one| one == signature)
}
