//! Webhooks in the API: creation, validation, lists, limits, and refused addresses.

use std::time::Duration;

use relume::server::{ServerConfig, WebhookPolicy};
use relume::testing;
use relume_api::webhooks::{DeliveryState, NewWebhook, WebhookChange, WebhookEvent};
use relume_client::{Client, ClientError};
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::delivery::start;
use super::receiver::{Receiver, for_all, newest};
use crate::service_support::trained;

async fn post(client: &Client, body: &Value) -> (u16, Value) {
    let answer = client.request(Method::POST, "/v1/webhooks").unwrap().json(body).send().await.unwrap();
    (answer.status().as_u16(), serde_json::from_str(&answer.text().await.unwrap()).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn private_webhook_addresses_are_refused_unless_allowed() {
    let strict = testing::spawn().await.unwrap();
    let body = |url: &str| json!({ "url": url, "events": ["job.failed"] });
    let inside = [
        "https://127.0.0.1/",
        "https://localhost:8080/x",
        "https://[::1]/",
        "https://[::ffff:10.0.0.1]/",
        "https://10.1.2.3/",
        "https://100.64.1.1/",
        "https://169.254.169.254/latest/meta-data/",
        "https://192.168.0.1/",
        "https://224.0.0.1/",
        "https://[fe80::1]/",
        "https://2130706433/",
    ];
    for url in inside {
        let (status, refused) = post(strict.client(), &body(url)).await;
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!("/url")), "{url}: {refused}");
    }
    let (status, refused) = post(strict.client(), &body("http://8.8.8.8/")).await;
    assert_eq!(status, 422, "without TLS: {refused}");
    let (status, made) = post(strict.client(), &body("https://8.8.8.8/")).await;
    assert_eq!(status, 201, "{made}");
    let change = |url: &str| WebhookChange { url: Some(url.to_owned()), ..WebhookChange::default() };
    let id = made["id"].as_str().unwrap().into();
    assert!(strict.client().change_webhook(&id, &change("https://127.0.0.1/")).await.is_err());
    assert_eq!(strict.client().webhook(&id).await.unwrap().url, "https://8.8.8.8/");

    let (allowing, _) = start(TempDir::new().unwrap(), Duration::from_secs(60)).await;
    for url in inside.into_iter().chain(["http://127.0.0.1/"]) {
        let (status, made) = post(allowing.client(), &body(url)).await;
        assert_eq!(status, 201, "the control: {url}: {made}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn webhook_addresses_are_checked_at_every_delivery() {
    let (allowing, clock) = start(TempDir::new().unwrap(), Duration::from_secs(60)).await;
    let mut receiver = Receiver::new().await;
    let id = allowing.client().create_webhook(&for_all(&receiver.url)).await.unwrap().webhook.id;
    trained(allowing.client()).await;
    receiver.next().await;
    newest(allowing.client(), &id, |d| d.state == DeliveryState::Delivered).await;
    let data = allowing.stop().await.unwrap();
    let policy = WebhookPolicy { allow_http: true, ..WebhookPolicy::default() };
    let change = |config: &mut ServerConfig| (config.webhooks, config.clock) = (policy, clock);
    let strict = testing::spawn_with(data, change).await.unwrap();
    let delivery = strict.client().deliveries(&id).await.unwrap().items.remove(0).id;
    strict.client().replay_delivery(&id, &delivery).await.unwrap();
    let log = newest(strict.client(), &id, |d| d.attempts.len() == 2).await;
    let error = log.attempts[1].error.as_deref().unwrap();
    assert!(error.contains("no public address") && log.attempts[1].status.is_none(), "{error}");
    assert!(receiver.is_silent());
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_webhooks_are_refused_and_their_number_is_limited() {
    let (server, _) = start(TempDir::new().unwrap(), Duration::from_secs(60)).await;
    let good = json!({ "url": "https://127.0.0.1/", "events": ["job.failed"], "name": "n" });
    for (field, value) in [
        ("url", json!("")),
        ("url", json!("example.org")),
        ("url", json!("ftp://127.0.0.1/")),
        ("url", json!("https://me@127.0.0.1/")),
        ("url", json!(format!("https://127.0.0.1/{}", "a".repeat(2048)))),
        ("events", json!([])),
        ("events", json!(["job.failed", "job.failed"])),
        ("events/0", json!(["job.begun"])),
        ("name", json!("n".repeat(129))),
        ("colour", json!(1)),
    ] {
        let mut body = good.clone();
        body[field.split('/').next().unwrap()] = value;
        let (status, refused) = post(server.client(), &body).await;
        let pointer = json!(format!("/{field}"));
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &pointer), "{refused}");
    }
    assert!(server.client().webhooks().await.unwrap().items.is_empty());
    for _ in 0..16 {
        assert_eq!(post(server.client(), &good).await.0, 201);
    }
    let (status, refused) = post(server.client(), &good).await;
    assert_eq!((status, &refused["type"]), (409, &json!("urn:relume:problem:quota-exceeded")), "{refused}");
    let id = server.client().webhooks().await.unwrap().items[0].id.clone();
    server.client().delete_webhook(&id).await.unwrap();
    let gone = server.client().webhook(&id).await;
    assert!(matches!(gone, Err(ClientError::Problem(p)) if p.status == 404));
    assert_eq!(post(server.client(), &good).await.0, 201, "there is room for one again");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_webhook_secret_is_shown_only_once() {
    let (server, _) = start(TempDir::new().unwrap(), Duration::from_secs(60)).await;
    let client = server.client();
    let mut receiver = Receiver::new().await;
    let made = client.create_webhook(&for_all(&receiver.url)).await.unwrap();
    let other = client.create_webhook(&for_all(&receiver.url)).await.unwrap();
    assert_ne!(made.secret, other.secret);
    trained(client).await;
    receiver.next().await;
    let secret = made.secret.strip_prefix("whsec_").unwrap();
    let id = &made.webhook.id;
    for path in
        ["/v1/webhooks".to_owned(), format!("/v1/webhooks/{id}"), format!("/v1/webhooks/{id}/deliveries")]
    {
        let answer = client.request(Method::GET, &path).unwrap().send().await.unwrap().text().await.unwrap();
        assert!(answer.contains("job.succeeded") && !answer.contains(secret), "{answer}");
    }
    let change = WebhookChange {
        name: Some("farm".to_owned()),
        events: Some(vec![WebhookEvent::JobFailed]),
        ..WebhookChange::default()
    };
    let changed = client.change_webhook(id, &change).await.unwrap();
    assert_eq!(
        (changed.name.as_deref(), changed.events.as_slice()),
        (Some("farm"), &[WebhookEvent::JobFailed][..])
    );
    assert_eq!(changed.url, receiver.url, "what is absent stays");
    assert!(!serde_json::to_string(&changed).unwrap().contains(secret));
    let wrong = NewWebhook { events: Vec::new(), ..for_all(&receiver.url) };
    assert!(client.create_webhook(&wrong).await.is_err());
}
