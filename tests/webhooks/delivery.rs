//! Deliveries to a receiver, and the handling of failed ones.

use std::sync::Arc;
use std::time::Duration;

use relume::jobs::{Clock, ManualClock};
use relume::server::{ServerConfig, WebhookPolicy};
use relume::testing::{self, TestServer};
use relume_api::webhooks::{DeliveryState, DeliveryView, NewWebhook, WebhookChange, WebhookEvent};
use relume_client::ClientError;
use serde_json::json;
use tempfile::TempDir;

use super::receiver::{Answer, Received, Receiver, for_all, is_signed, newest};
use crate::service_support::{capture_zip, ended, small_job, trained};

/// A server that sends to loopback, with a stopped clock.
pub async fn start(data: TempDir, timeout: Duration) -> (TestServer, Arc<ManualClock>) {
    let clock = Arc::new(ManualClock::default());
    clock.advance(Duration::from_secs(1_700_000_000));
    let hands = clock.clone();
    let change = move |config: &mut ServerConfig| {
        config.clock = hands;
        config.webhooks = WebhookPolicy { allow_http: true, allow_private: true, timeout };
    };
    (testing::spawn_with(data, change).await.unwrap(), clock)
}

/// Advances the clock to the next attempt.
fn wait_out(clock: &ManualClock, log: &DeliveryView) -> Duration {
    let next: jiff::Timestamp = log.next_attempt_at.as_ref().unwrap().parse().unwrap();
    let gap = Duration::from_millis(u64::try_from(next.as_millisecond() - clock.now_ms()).unwrap());
    clock.advance(gap);
    gap
}

const PATIENT: Duration = Duration::from_secs(60);

/// Cancels a job while it waits or runs.
async fn cancelled(server: &TestServer) -> String {
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 100_000, 50_000), None).await.unwrap();
    client.cancel_job(&job.id).await.unwrap();
    ended(client, &job.id).await.id.to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn job_end_events_are_delivered_signed_to_subscribed_webhooks() {
    let (server, clock) = start(TempDir::new().unwrap(), PATIENT).await;
    let client = server.client();
    let (mut one, mut other) = (Receiver::new().await, Receiver::new().await);
    let made = client.create_webhook(&for_all(&one.url)).await.unwrap();
    let failures = NewWebhook { events: vec![WebhookEvent::JobFailed], ..for_all(&other.url) };
    client.create_webhook(&failures).await.unwrap();
    let job = trained(client).await;

    let mut received = one.next().await;
    assert_eq!(received.path, "/hook?to=me");
    assert_eq!(received.header("content-type"), "application/json");
    assert_eq!(received.header("webhook-timestamp"), (clock.now_ms() / 1000).to_string());
    assert!(is_signed(&made.secret, &received));
    let message = received.json();
    assert_eq!(message["type"], "job.succeeded");
    assert_eq!(message["timestamp"], "2023-11-14T22:13:20Z");
    assert_eq!(
        message["data"]["job"],
        json!(client.job(&job.id).await.unwrap()),
        "the job as the API shows it"
    );
    received.body += " ";
    assert!(!is_signed(&made.secret, &received), "the control");

    let logged = newest(client, &made.webhook.id, |d| d.state == DeliveryState::Delivered).await;
    assert_eq!((logged.id.as_str(), &logged.job), (received.header("webhook-id"), &job.id));
    assert_eq!((logged.attempts.len(), logged.attempts[0].status), (1, Some(200)));
    assert!(one.is_silent() && other.is_silent(), "nothing else is sent");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rotated_secret_still_signs_for_one_day() {
    let (server, clock) = start(TempDir::new().unwrap(), PATIENT).await;
    let client = server.client();
    let mut receiver = Receiver::new().await;
    let made = client.create_webhook(&for_all(&receiver.url)).await.unwrap();
    let rotated = client.rotate_webhook_secret(&made.webhook.id).await.unwrap();
    assert_eq!(rotated.webhook, made.webhook);
    assert_ne!(rotated.secret, made.secret);
    let signed_by =
        |received: &Received| [&made, &rotated].map(|webhook| is_signed(&webhook.secret, received));
    cancelled(&server).await;
    assert_eq!(signed_by(&receiver.next().await), [true, true]);
    clock.advance(Duration::from_secs(24 * 3600));
    cancelled(&server).await;
    assert_eq!(signed_by(&receiver.next().await), [false, true]);
    let third = client.rotate_webhook_secret(&made.webhook.id).await.unwrap();
    let last = client.rotate_webhook_secret(&made.webhook.id).await.unwrap();
    cancelled(&server).await;
    let received = receiver.next().await;
    assert_eq!([&third, &last].map(|webhook| is_signed(&webhook.secret, &received)), [true, true]);
    assert_eq!(signed_by(&received), [false, false], "of secrets that were replaced the last alone signs");
}

#[tokio::test(flavor = "multi_thread")]
async fn failed_deliveries_are_retried_with_growing_delays() {
    let (server, clock) = start(TempDir::new().unwrap(), PATIENT).await;
    let client = server.client();
    let mut receiver = Receiver::new().await;
    receiver.answer(&[Answer::Status(500), Answer::Status(503)]);
    let made = client.create_webhook(&for_all(&receiver.url)).await.unwrap();
    cancelled(&server).await;
    let first = receiver.next().await;
    let after =
        async |attempts: usize| newest(client, &made.webhook.id, |d| d.attempts.len() == attempts).await;
    let mut waited = Vec::new();
    for attempts in [1, 2] {
        let log = after(attempts).await;
        assert_eq!(log.state, DeliveryState::Pending);
        assert!(
            log.attempts[attempts - 1].error.as_ref().unwrap().contains("the receiver answered 50"),
            "{log:?}"
        );
        assert!(client.webhook(&made.webhook.id).await.unwrap().failing_since.is_some());
        assert!(receiver.is_silent(), "not before its time");
        waited.push(wait_out(&clock, &log).as_secs());
        let again = receiver.next().await;
        assert_eq!(again.header("webhook-id"), first.header("webhook-id"));
        assert_eq!(again.body, first.body);
        assert!(is_signed(&made.secret, &again));
        assert_ne!(again.header("webhook-timestamp"), first.header("webhook-timestamp"));
    }
    assert!((5..=6).contains(&waited[0]) && (300..=360).contains(&waited[1]), "{waited:?}");
    assert_eq!(after(3).await.state, DeliveryState::Delivered);
    let webhook = client.webhook(&made.webhook.id).await.unwrap();
    assert_eq!((webhook.enabled, webhook.failing_since), (true, None));
}

#[tokio::test(flavor = "multi_thread")]
async fn redirects_are_not_followed_and_a_replay_resends_the_message() {
    let (server, _) = start(TempDir::new().unwrap(), PATIENT).await;
    let client = server.client();
    let mut receiver = Receiver::new().await;
    receiver.answer(&[Answer::Redirect]);
    let made = client.create_webhook(&for_all(&receiver.url)).await.unwrap();
    cancelled(&server).await;
    let first = receiver.next().await;
    let log = newest(client, &made.webhook.id, |d| d.attempts.len() == 1).await;
    assert_eq!((log.state, log.attempts[0].status), (DeliveryState::Pending, Some(302)));
    assert!(log.attempts[0].error.as_ref().unwrap().contains("not followed"), "{log:?}");

    let replayed = client.replay_delivery(&made.webhook.id, &log.id).await.unwrap();
    assert_eq!(replayed.state, DeliveryState::Pending);
    let again = receiver.next().await;
    assert_eq!(again.path, "/hook?to=me", "nobody asked for the other place in between");
    assert_eq!((again.header("webhook-id"), &again.body), (first.header("webhook-id"), &first.body));
    newest(client, &made.webhook.id, |d| d.state == DeliveryState::Delivered).await;
    // A delivered message can also be replayed.
    client.replay_delivery(&made.webhook.id, &log.id).await.unwrap();
    assert_eq!(receiver.next().await.body, first.body);
    let nobody = client.replay_delivery(&made.webhook.id, &"msg_0".into()).await;
    assert!(matches!(nobody, Err(ClientError::Problem(p)) if p.status == 404));
}

#[tokio::test(flavor = "multi_thread")]
async fn slow_receivers_do_not_block_and_endless_responses_are_cut() {
    let (server, _) = start(TempDir::new().unwrap(), Duration::from_secs(1)).await;
    let client = server.client();
    let (mut slow, mut endless) = (Receiver::new().await, Receiver::new().await);
    slow.answer(&[Answer::Never]);
    endless.answer(&[Answer::Endless]);
    let slow_one = client.create_webhook(&for_all(&slow.url)).await.unwrap().webhook.id;
    let endless_one = client.create_webhook(&for_all(&endless.url)).await.unwrap().webhook.id;
    cancelled(&server).await;
    tokio::join!(slow.next(), endless.next());
    let log = newest(client, &slow_one, |d| d.attempts.len() == 1).await;
    assert_eq!(log.attempts[0].error.as_deref(), Some("the receiver did not answer in time"));
    let log = newest(client, &endless_one, |d| d.attempts.len() == 1).await;
    assert_eq!(
        (log.state, log.attempts[0].status),
        (DeliveryState::Delivered, Some(200)),
        "its status counts"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_webhook_that_fails_for_days_is_disabled_with_a_reason() {
    let (server, clock) = start(TempDir::new().unwrap(), PATIENT).await;
    let client = server.client();
    let mut receiver = Receiver::new().await;
    receiver.answer(&[Answer::Status(500); 10]);
    let id = client.create_webhook(&for_all(&receiver.url)).await.unwrap().webhook.id;
    let job = cancelled(&server).await;
    for attempt in 1..=10 {
        assert!(client.webhook(&id).await.unwrap().enabled, "before attempt {attempt}");
        assert_eq!(receiver.next().await.job(), job);
        let log = newest(client, &id, |d| d.attempts.len() == attempt).await;
        if attempt < 10 {
            wait_out(&clock, &log);
        }
    }
    let webhook = client.webhook(&id).await.unwrap();
    assert!(!webhook.enabled && webhook.switched_off_at.is_some(), "{webhook:?}");
    let why = webhook.switched_off_because.unwrap();
    assert!(why.contains("2023-11-14T22:13:20Z") && why.contains("the receiver answered 500"), "{why}");
    let given_up = newest(client, &id, |d| d.state == DeliveryState::Failed).await;

    // No more messages are queued, and none can be replayed.
    cancelled(&server).await;
    assert_eq!(client.deliveries(&id).await.unwrap().items.len(), 1);
    let refused = client.replay_delivery(&id, &given_up.id).await;
    assert!(matches!(&refused, Err(ClientError::Problem(p)) if p.status == 409), "{refused:?}");
    assert!(receiver.is_silent());

    let on = WebhookChange { enabled: Some(true), ..WebhookChange::default() };
    let webhook = client.change_webhook(&id, &on).await.unwrap();
    assert_eq!((webhook.enabled, webhook.switched_off_because, webhook.failing_since), (true, None, None));
    client.replay_delivery(&id, &given_up.id).await.unwrap();
    assert_eq!(receiver.next().await.job(), job);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_webhook_answering_410_is_disabled_and_gets_no_messages() {
    let (server, _) = start(TempDir::new().unwrap(), PATIENT).await;
    let client = server.client();
    let (mut gone, mut off, mut on) = (Receiver::new().await, Receiver::new().await, Receiver::new().await);
    gone.answer(&[Answer::Status(410)]);
    let gone_one = client.create_webhook(&for_all(&gone.url)).await.unwrap().webhook.id;
    let off_one = client.create_webhook(&for_all(&off.url)).await.unwrap().webhook.id;
    client.create_webhook(&for_all(&on.url)).await.unwrap();
    let enabled = |enabled| WebhookChange { enabled: Some(enabled), ..WebhookChange::default() };
    assert!(!client.change_webhook(&off_one, &enabled(false)).await.unwrap().enabled);
    cancelled(&server).await;
    tokio::join!(gone.next(), on.next());
    let log = newest(client, &gone_one, |d| d.attempts.len() == 1).await;
    assert_eq!(log.state, DeliveryState::Failed);
    let why = client.webhook(&gone_one).await.unwrap().switched_off_because.unwrap();
    assert!(why.contains("410"), "{why}");
    assert!(client.deliveries(&off_one).await.unwrap().items.is_empty());
    client.change_webhook(&off_one, &enabled(true)).await.unwrap();
    let job = cancelled(&server).await;
    assert_eq!(off.next().await.job(), job, "the control");
}
