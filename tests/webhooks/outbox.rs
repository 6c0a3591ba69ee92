//! The end of a job and its messages are written in one transaction.

use std::time::Duration;

use relume::store::{DeliveryAttempt, Page, Store, WebhookRecord};
use relume_api::jobs::JobState;
use relume_api::webhooks::WebhookEvent;
use relume_api::{JobId, ResourceKind, ResourceName, TenantId, WebhookId};

use crate::service_promises::{Bench, publish};

fn webhook(id: &str, tenant: &str, events: &[WebhookEvent]) -> WebhookRecord {
    WebhookRecord {
        id: id.into(),
        tenant: tenant.into(),
        url: "https://example.org/".into(),
        events: events.to_vec(),
        name: None,
        secret: vec![7; 32],
        former_secret: None,
        former_until_ms: None,
        made_by: None,
        created_ms: 0,
        enabled: true,
        failing_since_ms: None,
        switched_off_ms: None,
        switched_off_because: None,
    }
}

/// The messages to a webhook: events, jobs and the states of the jobs in them; oldest first.
async fn entered(store: &Store, tenant: &str, id: &str) -> Vec<(WebhookEvent, JobId, String)> {
    let page = Page { limit: 100, before: None };
    let found = store.deliveries(&TenantId::from(tenant), &WebhookId::from(id), &page).await.unwrap();
    let one = |d: relume::store::DeliveryRecord| {
        let message: serde_json::Value = serde_json::from_str(&d.payload).unwrap();
        (d.event, d.job_id, message["data"]["job"]["state"].as_str().unwrap().to_owned())
    };
    found.into_iter().rev().map(one).collect()
}

const ALL: [WebhookEvent; 4] = [
    WebhookEvent::JobSucceeded,
    WebhookEvent::JobRejected,
    WebhookEvent::JobFailed,
    WebhookEvent::JobCancelled,
];

#[tokio::test]
async fn each_terminal_job_state_enqueues_exactly_one_message() {
    let bench = Bench::new().await;
    let store = bench.jobs.store();
    store.create_webhook(&webhook("all", "default", &ALL)).await.unwrap();
    store.create_webhook(&webhook("others", "b", &ALL)).await.unwrap();
    let tenant = TenantId::of_operator();
    let mut expected = Vec::new();
    let mut expect = |event: WebhookEvent, id: &JobId, state: JobState| {
        expected.push((event, id.clone(), state.name().to_owned()));
    };

    let id = bench.submit(0).await;
    let lease = bench.claim().await;
    lease.release(relume::store::Release::Shutdown).await.unwrap();
    assert!(entered(store, "default", "all").await.is_empty(), "it goes on");
    let lease = bench.claim().await;
    publish(&lease, "model").await;
    expect(WebhookEvent::JobSucceeded, &id, JobState::Succeeded);
    publish(&lease, "again").await;

    let id = bench.submit_asking("novel_view.psnr", ">=99").await;
    publish(&bench.claim().await, "rejected").await;
    expect(WebhookEvent::JobRejected, &id, JobState::Rejected);

    let id = bench.submit(0).await;
    bench.claim().await.fail("training_failed", "why").await.unwrap();
    expect(WebhookEvent::JobFailed, &id, JobState::Failed);

    let id = bench.submit(0).await;
    bench.jobs.cancel(&tenant, &id).await.unwrap();
    bench.jobs.cancel(&tenant, &id).await.unwrap();
    expect(WebhookEvent::JobCancelled, &id, JobState::Cancelled);

    let id = bench.submit(0).await;
    let lease = bench.claim().await;
    bench.jobs.cancel(&tenant, &id).await.unwrap();
    lease.confirm_cancel().await.unwrap();
    expect(WebhookEvent::JobCancelled, &id, JobState::Cancelled);

    // A job that fails after three crashes, and one that is cancelled after its worker died.
    let id = bench.submit(0).await;
    for _ in 0..3 {
        bench.claim().await;
        bench.clock.advance(Duration::from_secs(3600));
        bench.jobs.reclaim_expired().await.unwrap();
    }
    expect(WebhookEvent::JobFailed, &id, JobState::Failed);
    let id = bench.submit(0).await;
    bench.claim().await;
    bench.jobs.cancel(&tenant, &id).await.unwrap();
    bench.jobs.reclaim_all().await.unwrap();
    expect(WebhookEvent::JobCancelled, &id, JobState::Cancelled);

    // A job that is deleted while it waits.
    let id = bench.submit(0).await;
    bench.jobs.delete(&tenant, &ResourceName::new(ResourceKind::Job, id.as_str()), false).await.unwrap();
    expect(WebhookEvent::JobCancelled, &id, JobState::Cancelled);

    assert_eq!(entered(store, "default", "all").await, expected);
    assert!(entered(store, "b", "others").await.is_empty(), "another tenant hears nothing of it");
}

#[tokio::test]
async fn messages_are_deleted_after_a_month_and_with_their_webhook() {
    let bench = Bench::new().await;
    let store = bench.jobs.store();
    store.create_webhook(&webhook("a", "default", &ALL)).await.unwrap();
    let tenant = TenantId::of_operator();
    for _ in 0..2 {
        let id = bench.submit(0).await;
        bench.jobs.cancel(&tenant, &id).await.unwrap();
        bench.clock.advance(Duration::from_secs(20 * 24 * 3600));
    }
    store.delete_old_deliveries(bench.jobs.now_ms()).await.unwrap();
    assert_eq!(entered(store, "default", "a").await.len(), 1, "the first is 40 days old, the second 20");
    // The result of an attempt is ignored if the webhook was deleted.
    let due = store.due_deliveries(bench.jobs.now_ms()).await.unwrap().remove(0);
    assert!(!store.delete_webhook(&"b".into(), &"a".into()).await.unwrap(), "not by another tenant");
    assert_eq!(entered(store, "default", "a").await.len(), 1);
    assert!(store.delete_webhook(&tenant, &"a".into()).await.unwrap());
    let attempt = DeliveryAttempt { at_ms: 0, status: Some(200), error: None };
    store.record_attempt(&due, attempt, None).await.unwrap();
    assert!(store.due_deliveries(i64::MAX).await.unwrap().is_empty());
}
