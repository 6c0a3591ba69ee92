//! Metadata of resources: names, identifiers of other systems, labels; and lists and retention by metadata.

use std::sync::Arc;
use std::time::Duration;

use relume::jobs::ManualClock;
use relume::server::RetentionPace;
use relume::store::{CaptureRecord, EnvironmentRecord, Retention, StoreError};
use relume::testing;
use relume_api::TenantId;
use relume_api::jobs::{JobChange, NewJob};
use relume_api::metadata::{MetadataChange, ResourceMetadata};
use relume_client::Client;
use relume_spec::CaptureReport;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::{CaptureZip, capture_zip, ended, open_store, small_job};

async fn ask(client: &Client, method: Method, path: &str, body: Option<Value>) -> (u16, Value) {
    let request = client.request(method, path).unwrap();
    let request = match body {
        Some(body) => request.json(&body),
        None => request,
    };
    let answer = request.send().await.unwrap();
    (answer.status().as_u16(), serde_json::from_str(&answer.text().await.unwrap()).unwrap_or_default())
}

async fn get(client: &Client, path: &str) -> Value {
    let (status, answer) = ask(client, Method::GET, path, None).await;
    assert_eq!(status, 200, "{path}: {answer}");
    answer
}

/// Uploads a file to a path with a query.
async fn upload(client: &Client, path: &str, file: Vec<u8>) -> (u16, Value) {
    let request = client.request(Method::POST, path).unwrap();
    let request = request.header("content-type", "application/octet-stream").body(file);
    let answer = request.send().await.unwrap();
    (answer.status().as_u16(), serde_json::from_str(&answer.text().await.unwrap()).unwrap())
}

fn map() -> Vec<u8> {
    relume_capture::formats::exr_image::encode_rgb(4, 2, &[[1.0f32; 3]; 8]).unwrap()
}

/// The metadata of a resource.
fn metadata(of: &Value) -> Value {
    json!([of["name"], of["external_id"], of["labels"]])
}

fn change(body: Value) -> MetadataChange {
    serde_json::from_value(body).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn resources_get_metadata_at_creation_and_models_from_their_job() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let query = "name=Lion%20head&external_id=asset-7&labels=show:alpha,shot:sc-010";
    let called = json!(["Lion head", "asset-7", { "show": "alpha", "shot": "sc-010" }]);
    let (status, capture) = upload(client, &format!("/v1/captures?{query}"), capture_zip()).await;
    assert_eq!((status, metadata(&capture)), (201, called.clone()));
    let (status, light) = upload(client, &format!("/v1/environments?{query}"), map()).await;
    assert_eq!((status, metadata(&light)), (201, called.clone()));
    let id = capture["id"].as_str().unwrap();
    let job = NewJob {
        name: Some("Lion head".into()),
        external_id: Some("asset-7".into()),
        labels: [("show", "alpha"), ("shot", "sc-010")].map(|(k, v)| (k.into(), v.into())).into(),
        ..small_job(&id.into(), 5, 5)
    };
    let job = client.create_job(&job, None).await.unwrap();
    // The metadata change while the job waits or trains; the model gets the metadata of the job at its end.
    let raised = serde_json::from_value::<JobChange>(json!({ "labels": { "shot": null, "take": "2" } }));
    client.change_job(&job.id, &raised.unwrap()).await.unwrap();
    let job = ended(client, &job.id).await;
    let model = job.model.clone().unwrap();
    let of_job = get(client, &format!("/v1/jobs/{}", job.id)).await;
    let of_model = get(client, &format!("/v1/models/{model}")).await;
    assert_eq!(of_job["labels"]["show"], "alpha");
    assert_eq!(of_job["labels"]["take"], "2");
    assert_eq!(of_model["name"], "Lion head");
    assert_eq!(of_model["external_id"], "asset-7");
    assert_eq!(of_model["labels"]["show"], "alpha");
    // A repeated upload of the same content sets the metadata that it states.
    let (status, again) = upload(client, "/v1/captures?labels=take:2", capture_zip()).await;
    assert_eq!((status, &again["id"]), (200, &capture["id"]));
    let labels = json!({ "show": "alpha", "shot": "sc-010", "take": "2" });
    assert_eq!(metadata(&again), json!(["Lion head", "asset-7", labels]));
    let (_, again) = upload(client, "/v1/captures", capture_zip()).await;
    assert_eq!(again["labels"], labels);
}

#[tokio::test]
async fn resources_and_their_metadata_are_stored_in_one_transaction() {
    let folder = TempDir::new().unwrap();
    let store = open_store(folder.path()).await;
    let tenant = TenantId::of_operator();
    let called = |count: usize, prefix: &str| ResourceMetadata {
        name: Some(prefix.to_owned()),
        external_id: Some(format!("asset-{prefix}")),
        labels: (0..count).map(|n| (format!("{prefix}{n}"), "x".to_owned())).collect(),
    };
    let capture = |id: &str, metadata: ResourceMetadata| CaptureRecord {
        id: id.into(),
        sha256: "00".into(),
        bytes: 1,
        artifact: "captures/00".into(),
        metadata,
        report: CaptureReport::default(),
        made_of: None,
        created_ms: 0,
    };
    let map = |id: &str, metadata: ResourceMetadata| EnvironmentRecord {
        id: id.into(),
        sha256: "00".into(),
        metadata,
        bytes: 1,
        artifact: "environments/00".into(),
        width: 4,
        height: 2,
        warnings: Vec::new(),
        created_ms: 0,
    };
    store.insert_capture(&tenant, &capture("c", called(10, "a")), None).await.unwrap();
    store.insert_environment(&tenant, &map("e", called(10, "a"))).await.unwrap();
    let stored = async || {
        let capture = store.capture(&tenant, &"c".into()).await.unwrap().unwrap();
        let map = store.environment(&tenant, &"e".into()).await.unwrap().unwrap();
        [capture.metadata, map.metadata]
    };
    assert_eq!(stored().await, [called(10, "a"), called(10, "a")]);
    // A concurrent second upload of the same content changes the metadata of the first; if they are invalid,
    // nothing changes.
    let refused = store.insert_capture(&tenant, &capture("d", called(7, "b")), None).await;
    assert!(matches!(refused, Err(StoreError::InvalidMetadata { field: "labels", .. })), "{refused:?}");
    let refused = store.insert_environment(&tenant, &map("f", called(7, "b"))).await;
    assert!(matches!(refused, Err(StoreError::InvalidMetadata { field: "labels", .. })), "{refused:?}");
    assert_eq!(stored().await, [called(10, "a"), called(10, "a")]);
    let second = store.insert_capture(&tenant, &capture("d", called(6, "b")), None).await.unwrap();
    assert_eq!((second.id.as_str(), second.metadata.name.as_deref()), ("c", Some("b")));
    let second = store.insert_environment(&tenant, &map("f", called(6, "b"))).await.unwrap();
    assert_eq!((second.id.as_str(), second.metadata.labels.len()), ("e", 16));
    let [capture, map] = stored().await;
    assert_eq!((capture.labels.len(), capture), (16, map));
    store.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_can_be_filtered_by_metadata() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let (_, first) = upload(client, "/v1/captures?name=a&labels=show:x,shot:1", capture_zip()).await;
    let zip = CaptureZip::new(9, 32).zip();
    let (_, second) = upload(client, "/v1/captures?external_id=e&labels=show:x,shot:2", zip).await;
    let found = async |path: &str| -> Vec<Value> {
        let list = get(client, path).await;
        list["items"].as_array().unwrap().iter().map(|item| item["id"].clone()).collect()
    };
    let (first, second) = (first["id"].clone(), second["id"].clone());
    for (query, expected) in [
        ("", vec![&second, &first]),
        ("?label=show:x", vec![&second, &first]),
        ("?label=shot:1", vec![&first]),
        ("?label=show:x,shot:2", vec![&second]),
        ("?label=shot:1,shot2:2", vec![]),
        ("?label=shot:3", vec![]),
        ("?name=a", vec![&first]),
        ("?external_id=e", vec![&second]),
        ("?external_id=e&name=a", vec![]),
    ] {
        let found = found(&format!("/v1/captures{query}")).await;
        assert_eq!(found.iter().collect::<Vec<_>>(), expected, "{query}");
    }
    // A filtered page continues after items that do not match.
    let page = get(client, "/v1/captures?label=show:x&limit=1").await;
    assert_eq!(page["items"][0]["id"], second);
    let before = page["next"].as_str().unwrap();
    let next = get(client, &format!("/v1/captures?label=show:x&limit=1&before={before}")).await;
    assert_eq!((&next["items"][0]["id"], &next["next"]), (&first, &json!(null)));

    let mut job = small_job(&first.as_str().unwrap().into(), 3, 5);
    job.external_id = Some("farm-1".into());
    let with = client.create_job(&job, None).await.unwrap();
    let without = client.create_job(&small_job(&job.capture, 3, 5), None).await.unwrap();
    ended(client, &with.id).await;
    let with_model = ended(client, &without.id).await.model.unwrap();
    assert_eq!(found("/v1/jobs?external_id=farm-1").await, [json!(with.id)]);
    assert_eq!(found("/v1/jobs?external_id=farm-1&state=failed").await, [json!(null); 0]);
    assert_eq!(found("/v1/models?external_id=farm-1").await.len(), 1);
    client.change_model(&with_model, &change(json!({ "name": "best" }))).await.unwrap();
    assert_eq!(found("/v1/models?name=best").await, [json!(with_model)]);
    upload(client, "/v1/environments?labels=sky:clear", map()).await;
    assert_eq!(found("/v1/environments?label=sky:clear").await.len(), 1);
    assert_eq!(found("/v1/environments?label=sky:grey").await.len(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_metadata_is_refused_with_the_field_and_not_stored() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let long = "n".repeat(201);
    for (query, pointer) in [
        ("name=".to_owned(), "query/name"),
        (format!("name={long}"), "query/name"),
        (format!("external_id={long}"), "query/external_id"),
        ("labels=a".to_owned(), "query/labels"),
        ("labels=a%20b:c".to_owned(), "query/labels"),
        ("labels=a:1,a:2".to_owned(), "query/labels"),
        ("name=a%0Ab".to_owned(), "query/name"),
        ("external_id=%1B%5B2J".to_owned(), "query/external_id"),
        ("label=a:1".to_owned(), "query/label"),
    ] {
        for path in ["/v1/captures", "/v1/environments"] {
            let (status, refused) = upload(client, &format!("{path}?{query}"), b"no".to_vec()).await;
            assert_eq!(
                (status, &refused["errors"][0]["pointer"]),
                (422, &json!(pointer)),
                "{query}: {refused}"
            );
        }
    }
    let (_, capture) = upload(client, "/v1/captures?labels=a:1", capture_zip()).await;
    let path = format!("/v1/captures/{}", capture["id"].as_str().unwrap());
    let many: serde_json::Map<String, Value> = (0..16).map(|n| (format!("k{n}"), json!("v"))).collect();
    for (body, pointer) in [
        (json!({ "name": "" }), "/name"),
        (json!({ "external_id": long }), "/external_id"),
        (json!({ "name": "two\nlines" }), "/name"),
        (json!({ "name": "x", "external_id": "\u{1}" }), "/external_id"),
        (json!({ "name": "x", "labels": { "a b": "c" } }), "/labels"),
        (json!({ "name": "x", "labels": many }), "/labels"),
        (json!({ "colour": 1 }), "/colour"),
    ] {
        let (status, refused) = ask(client, Method::PATCH, &path, Some(body)).await;
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!(pointer)), "{refused}");
    }
    assert_eq!(metadata(&get(client, &path).await), json!([null, null, { "a": "1" }]));
    let job = json!({ "capture": capture["id"], "labels": { "a": "" } });
    let (status, refused) = ask(client, Method::POST, "/v1/jobs", Some(job)).await;
    assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!("/labels")), "{refused}");
    for (body, pointer) in [
        (json!({ "capture": capture["id"], "name": "\u{7}" }), "/name"),
        (json!({ "capture": capture["id"], "external_id": "a\tb" }), "/external_id"),
    ] {
        let (status, refused) = ask(client, Method::POST, "/v1/jobs", Some(body)).await;
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!(pointer)), "{refused}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_metadata_filters_are_refused() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let many: Vec<String> = (0..17).map(|n| format!("k{n}:v")).collect();
    let long = "a".repeat(64);
    for label in ["", "=x", "a", ":", "a:", ":b", "a:b,", "a%20b:c", "a:%C3%A4", "a:b%0A", "a:b:c", "a:1,a:2"]
        .map(str::to_owned)
        .into_iter()
        .chain([many.join(","), format!("{long}:b"), format!("a:{long}")])
    {
        for list in ["captures", "environments", "jobs", "models"] {
            let path = format!("/v1/{list}?label={label}");
            let (status, refused) = ask(client, Method::GET, &path, None).await;
            assert_eq!(
                (status, &refused["errors"][0]["pointer"]),
                (422, &json!("query/label")),
                "{path}: {refused}"
            );
        }
    }
    for (query, pointer) in [
        ("name=".to_owned(), "query/name"),
        (format!("name={}", "n".repeat(201)), "query/name"),
        ("external_id=a%0Ab".to_owned(), "query/external_id"),
    ] {
        let (status, refused) = ask(client, Method::GET, &format!("/v1/captures?{query}"), None).await;
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!(pointer)), "{refused}");
    }
    assert_eq!(get(client, "/v1/captures?label=show/shot:sc-010_v2.1").await["items"], json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_finished_job_can_change_its_name_but_not_its_priority() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 3, 5), None).await.unwrap();
    ended(client, &job.id).await;
    let path = format!("/v1/jobs/{}", job.id);
    let body = json!({ "priority": 1, "name": "late" });
    let (status, refused) = ask(client, Method::PATCH, &path, Some(body)).await;
    assert_eq!((status, &refused["type"]), (409, &json!("urn:relume:problem:job-not-queued")));
    assert_eq!(get(client, &path).await["name"], json!(null), "nothing of it was changed");
    let (status, changed) = ask(client, Method::PATCH, &path, Some(json!({ "name": "late" }))).await;
    assert_eq!((status, &changed["name"]), (200, &json!("late")));
    let (status, changed) = ask(client, Method::PATCH, &path, Some(json!({ "name": null }))).await;
    assert_eq!((status, &changed["name"]), (200, &json!(null)));
}

#[tokio::test(flavor = "multi_thread")]
async fn resources_with_the_keep_label_are_not_deleted_by_age() {
    let clock = Arc::new(ManualClock::default());
    let day = Duration::from_secs(24 * 3600);
    let with = |keep: Option<Duration>| {
        let clock = clock.clone();
        move |config: &mut relume::server::ServerConfig| {
            config.retention = Retention { jobs: keep, captures: keep, models: keep, exports: None };
            config.retention_pace = RetentionPace::UNLIMITED;
            config.clock = clock;
        }
    };
    let server = testing::spawn_with(TempDir::new().unwrap(), with(None)).await.unwrap();
    let client = server.client();
    let kept = client.upload_capture_bytes(capture_zip()).await.unwrap();
    client.change_capture(&kept.id, &change(json!({ "labels": { "keep": "true" } }))).await.unwrap();
    let other = client.upload_capture_bytes(CaptureZip::new(9, 32).zip()).await.unwrap();
    client.change_capture(&other.id, &change(json!({ "labels": { "keep": "false" } }))).await.unwrap();
    let mut job = small_job(&kept.id, 3, 5);
    let goes = client.create_job(&job, None).await.unwrap();
    job.labels = [("keep".to_owned(), "true".to_owned())].into();
    let stays = client.create_job(&job, None).await.unwrap();
    let goes_model = ended(client, &goes.id).await.model.unwrap();
    let stays_model = ended(client, &stays.id).await.model.unwrap();
    clock.advance(20 * day);
    let data = server.stop().await.unwrap();
    let server = testing::spawn_with(data, with(Some(10 * day))).await.unwrap();
    // The stop makes sure that the first garbage collection has ended.
    let data = server.stop().await.unwrap();
    let server = testing::spawn_with(data, with(None)).await.unwrap();
    let client = server.client();
    assert!(client.capture(&kept.id).await.is_ok() && client.capture(&other.id).await.is_err());
    assert!(client.job(&stays.id).await.is_ok() && client.job(&goes.id).await.is_err());
    assert!(client.model(&stays_model).await.is_ok() && client.model(&goes_model).await.is_err());
}
