//! Tenants: every operation of the API description, requested by another tenant.

mod operations;

use std::collections::BTreeSet;

use relume::server::{ApiKeys, ServerConfig};
use relume::store::{Filter, Page, Store};
use relume::testing::{self, TestServer};
use relume_api::exports::{NewExport, SplatsExport, SplatsKind};
use relume_api::keys::Scope::{self, Admin, Metrics, Work};
use relume_api::{CaptureId, JobId, ModelId, TenantId, UploadId};
use relume_client::Client;
use reqwest::{Method, RequestBuilder, header};
use serde_json::{Value, json};
use sqlx::migrate::Migrator;
use tempfile::TempDir;

use crate::service_support::{ALL_OF_A_TENANT, capture_zip, ended, files_under, small_job, trained};
use crate::webhooks::for_all;
use operations::About::{Body, Counts, Everybody, List, One, Server};
use operations::Kind::{self, Capture, Delivery, Environment, Export, Job, Key, Model, Upload, Webhook};
use operations::operations;

const OPERATOR: &str = "the-operators-own-key";

/// A tenant with one resource of each kind.
struct Tenant {
    client: Client,
    capture: CaptureId,
    environment: String,
    export: String,
    job: JobId,
    model: ModelId,
    key: String,
    webhook: String,
    delivery: String,
    upload: UploadId,
}

impl Tenant {
    async fn new(server: &TestServer, name: &str) -> Self {
        let client = bearer(server, name, &ALL_OF_A_TENANT).await.0;
        // No server listens there.
        let webhook = client.create_webhook(&for_all("http://127.0.0.1:1/")).await.unwrap().webhook.id;
        let job = trained(&client).await;
        let delivery = client.deliveries(&webhook).await.unwrap().items.remove(0).id;
        let delivery = format!("{webhook}/deliveries/{delivery}");
        let map = relume_capture::formats::exr_image::encode_rgb(4, 2, &[[1.0f32; 3]; 8]).unwrap();
        let environment = client.upload_environment(map).await.unwrap().id.to_string();
        let key = bearer(server, name, &[Scope::Read]).await.1;
        let upload = client.begin_upload(9).await.unwrap();
        let (webhook, model) = (webhook.to_string(), job.model.unwrap());
        let (capture, job) = (job.capture, job.id);
        let ply = NewExport::Splats(SplatsExport::of(SplatsKind::Ply));
        let export = client.create_export(&model, &ply, None).await.unwrap().id;
        let export = client.wait_for_export(&export, |_| {}).await.unwrap().id.to_string();
        Self { client, capture, environment, export, job, model, key, webhook, delivery, upload }
    }

    fn id(&self, kind: Kind) -> &str {
        match kind {
            Capture => self.capture.as_str(),
            Environment => &self.environment,
            Export => &self.export,
            Job => self.job.as_str(),
            Model => self.model.as_str(),
            Key => &self.key,
            Webhook => &self.webhook,
            Delivery => &self.delivery,
            Upload => self.upload.as_str(),
        }
    }
}

async fn server() -> TestServer {
    let change = |config: &mut ServerConfig| {
        config.api_keys = ApiKeys::new([OPERATOR]);
        (config.webhooks.allow_http, config.webhooks.allow_private) = (true, true);
    };
    testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap()
}

/// A client with a new key, and the key's identifier.
async fn bearer(server: &TestServer, tenant: &str, scopes: &[Scope]) -> (Client, String) {
    let request = server.client().request(Method::POST, "/v1/keys").unwrap().bearer_auth(OPERATOR);
    let key = json!({ "name": "test", "tenant": tenant, "scopes": scopes });
    let made: Value = read(request.json(&key)).await.2;
    let client = Client::new(server.client().base().as_str(), made["secret"].as_str().map(str::to_owned));
    (client.unwrap(), made["id"].as_str().unwrap().to_owned())
}

/// An identifier that never existed.
fn never(kind: Kind) -> &'static str {
    match kind {
        Key => "0123456789abcdef",
        Delivery => "01890000-0000-7000-8000-000000000000/deliveries/msg_0",
        _ => "01890000-0000-7000-8000-000000000000",
    }
}

/// Requests an operation on the resource `id`.
fn ask(client: &Client, method: &str, path: &str, id: &str) -> RequestBuilder {
    let filled = path
        .replace("{id}/deliveries/{delivery}", id)
        .replace("{id}", id)
        .replace("photographs/{name}", "photographs/train%2Fr_0.png")
        .replace("{material}", "0")
        .replace("{name}", "model.safetensors");
    let method = Method::from_bytes(method.to_uppercase().as_bytes()).unwrap();
    let mut request = client.request(method.clone(), &filled).unwrap();
    if path.starts_with("/v1/uploads") {
        let piece = [("content-type", "application/offset+octet-stream"), ("upload-offset", "0")];
        for (name, value) in
            [("tus-resumable", "1.0.0"), ("x-http-method-override", "PATCH")].into_iter().chain(piece)
        {
            request = request.header(name, value);
        }
    }
    let look = json!({ "look_at": { "eye": [3, 0, 1], "target": [0, 0, 0], "fov_y_deg": 40 } });
    match (method.as_str(), path) {
        ("PATCH", "/v1/jobs/{id}") => request.json(&json!({ "priority": -1 })),
        ("PATCH", _) => request.json(&json!({ "name": "changed" })),
        ("PUT", "/v1/models/{id}/calibration") => {
            let patch = json!({ "photo": "train/r_0.png", "x": 14, "y": 14, "width": 4, "height": 4 });
            request.json(&json!({ "patch": patch, "reflectance": 0.18 }))
        }
        ("POST", "/v1/models/{id}/next-photographs") => request.json(&json!({ "count": 1 })),
        ("POST", "/v1/models/{id}/exports") => request.json(&json!({ "kind": "gltf" })),
        ("POST", "/v1/models/{id}/render") => {
            request.json(&json!({ "camera": look, "width": 8, "height": 8 }))
        }
        _ => request,
    }
}

/// Status, text and, if it is JSON, the value of an answer.
async fn read(request: RequestBuilder) -> (u16, String, Value) {
    let answer = request.send().await.unwrap();
    let status = answer.status().as_u16();
    let bytes = answer.bytes().await.unwrap();
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let json = serde_json::from_str(&text).unwrap_or_default();
    (status, text, json)
}

/// An answer without the parts that always differ: the request's identifier and the requested one.
async fn refusal(request: RequestBuilder, id: &str) -> (u16, Value) {
    let (status, text, _) = read(request).await;
    let mut body: Value = serde_json::from_str(&text.replace(id, "ID")).unwrap_or_default();
    // An answer to HEAD has no body.
    assert!(text.is_empty() || body["request_id"].is_string(), "{text}");
    body["request_id"] = json!("");
    (status, body)
}

#[tokio::test(flavor = "multi_thread")]
async fn no_operation_reveals_resources_of_another_tenant() {
    let server = server().await;
    let (a, b) = tokio::join!(Tenant::new(&server, "a"), bearer(&server, "b", &ALL_OF_A_TENANT));
    let mut asked = 0;
    for (method, path, about, _) in operations() {
        match about {
            One(kind) => {
                let (theirs, nobodys) = (a.id(*kind), never(*kind));
                let found = refusal(ask(&b.0, method, path, theirs), theirs).await;
                let expected = refusal(ask(&b.0, method, path, nobodys), nobodys).await;
                assert_eq!(found, expected, "{method} {path}");
                assert_eq!(found.0, 404, "{method} {path}");
                if *method == "delete" {
                    continue;
                }
                let own = read(ask(&a.client, method, path, theirs)).await;
                assert!(own.0 != 404 && own.0 < 500, "{method} {path} of one's own: {own:?}");
            }
            List(kind) => {
                let listed = read(ask(&b.0, method, path, "")).await;
                assert_eq!(listed.0, 200, "{method} {path}");
                assert!(!listed.1.contains(a.id(*kind)), "{method} {path}: {listed:?}");
                let own = read(ask(&a.client, method, path, "")).await.1;
                assert!(own.contains(a.id(*kind)), "{method} {path} of one's own: {own}");
                // An item of another tenant's list is not a valid cursor.
                let place = |id: &str| b.0.request(Method::GET, &format!("{path}?before={id}")).unwrap();
                let (theirs, nobodys) = (a.id(*kind), never(*kind));
                let found = refusal(place(theirs), theirs).await;
                assert_eq!(found, refusal(place(nobodys), nobodys).await, "{path}");
                assert_eq!(found.0, 422, "{path}");
            }
            Server => {
                assert_eq!(read(ask(&b.0, method, path, "any")).await.0, 403, "{method} {path}");
            }
            Counts => {
                let count = async |client: &Client| {
                    let found = read(ask(client, method, path, "")).await.2;
                    ["captures", "environments", "models"].map(|kind| found[kind]["count"].as_u64().unwrap())
                };
                assert_eq!((count(&b.0).await, count(&a.client).await), ([0; 3], [1; 3]), "{path}");
            }
            Everybody | Body => continue,
        }
        asked += 1;
    }
    assert!(asked >= 20);
    assert_eq!(a.client.job(&a.job).await.unwrap().priority, 0, "nothing of it was changed");
    for (path, kind) in [
        ("exports", Export),
        ("models", Model),
        ("jobs", Job),
        ("captures", Capture),
        ("environments", Environment),
        ("uploads", Upload),
    ] {
        let path = format!("/v1/{path}/{{id}}");
        assert_eq!(read(ask(&a.client, "delete", &path, a.id(kind))).await.0, 204, "{path} of one's own");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn ids_in_requests_are_resolved_within_the_callers_tenant() {
    let server = server().await;
    let (a, b) = tokio::join!(Tenant::new(&server, "a"), Tenant::new(&server, "b"));
    let job = |capture: &str, light: Option<&str>| {
        let light = light.map_or(json!({}), |id| json!({ "light": { "environment": id } }));
        let body = json!({ "capture": capture, "overrides": light });
        b.client.request(Method::POST, "/v1/jobs").unwrap().json(&body)
    };
    let look = json!({ "look_at": { "eye": [3, 0, 1], "target": [0, 0, 0], "fov_y_deg": 40 } });
    let render = |id: &str| {
        let body = json!({ "camera": look, "width": 8, "height": 8, "environment": { "id": id } });
        b.client.request(Method::POST, &format!("/v1/models/{}/render", b.model)).unwrap().json(&body)
    };
    let thumbnail = |id: &str| {
        let path = format!("/v1/models/{}/thumbnail?size=16&env={id}", b.model);
        b.client.request(Method::GET, &path).unwrap()
    };
    let own_capture = b.capture.as_str();
    let sign = |path: String| {
        b.client.request(Method::POST, "/v1/signed-urls").unwrap().json(&json!({ "path": path }))
    };
    let viewer_light = |id: &str| {
        let path = format!("/v1/models/{}/light?environment={id}", b.model);
        b.client.request(Method::GET, &path).unwrap()
    };
    type Ask<'a> = &'a dyn Fn(&str) -> RequestBuilder;
    let cases: [(&str, Kind, Ask); 5] = [
        ("capture of a job", Capture, &|id| job(id, None)),
        ("light of a job", Environment, &|id| job(own_capture, Some(id))),
        ("environment of a render", Environment, &render),
        ("environment of a thumbnail", Environment, &thumbnail),
        ("environment of a light", Environment, &viewer_light),
    ];
    for (what, kind, request) in cases {
        let found = refusal(request(a.id(kind)), a.id(kind)).await;
        assert_eq!(found, refusal(request(never(kind)), never(kind)).await, "{what}");
        assert_eq!(found.0, 422, "{what}");
        let own = read(request(b.id(kind))).await;
        assert!(own.0 < 300, "{what} of one's own: {own:?}");
    }
    for (kind, rest) in [(Model, "thumbnail"), (Model, "files/model.ply"), (Job, "events")] {
        let family = if kind == Model { "models" } else { "jobs" };
        let path = |id: &str| format!("/v1/{family}/{id}/{rest}");
        let found = refusal(sign(path(a.id(kind))), a.id(kind)).await;
        assert_eq!(found, refusal(sign(path(never(kind))), never(kind)).await, "{rest}");
        assert_eq!(found.0, 404, "{rest}");
        assert_eq!(read(sign(path(b.id(kind)))).await.0, 200, "{rest} of one's own");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn equal_content_of_two_tenants_is_stored_once() {
    let server = server().await;
    let (a, b) =
        (bearer(&server, "a", &ALL_OF_A_TENANT).await.0, bearer(&server, "b", &ALL_OF_A_TENANT).await.0);
    let first = a.upload_capture_bytes(capture_zip()).await.unwrap();
    let upload = b.request(Method::POST, "/v1/captures").unwrap();
    let upload = upload.header(header::CONTENT_TYPE, "application/zip").body(capture_zip());
    let (status, _, second) = read(upload).await;
    assert_eq!(status, 201, "that another tenant has it does not show");
    assert_eq!(second["sha256"], first.sha256);
    assert_ne!(second["id"], first.id.as_str());
    let stored = files_under(server.data_dir());
    assert_eq!(stored.iter().filter(|(name, _)| name.contains(&first.sha256)).count(), 1, "{stored:?}");

    // Two tenants can use the same idempotency key.
    let second = CaptureId::from(second["id"].as_str().unwrap());
    let mut jobs = BTreeSet::new();
    for (client, capture) in [(&a, &first.id), (&b, &second)] {
        let job = client.create_job(&small_job(capture, 3, 5), Some("nightly")).await.unwrap();
        assert_eq!(client.jobs().await.unwrap().items.len(), 1);
        jobs.insert(job.id.clone());
        ended(client, &job.id).await;
    }
    assert_eq!(jobs.len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_operation_refuses_a_key_without_its_scope() {
    let server = server().await;
    let mut few = Vec::new();
    for scope in Scope::ALL {
        // Administrators of the operator's tenant can also read metrics and work.
        let does_more = |other: &Scope| [Metrics, Work].contains(&scope) && *other == Admin;
        let others: Vec<Scope> =
            Scope::ALL.into_iter().filter(|other| *other != scope && !does_more(other)).collect();
        let with = bearer(&server, "default", &[scope]).await.0;
        few.push((scope, with, bearer(&server, "default", &others).await.0));
    }
    for (method, path, about, scope) in operations() {
        let (_, with, without) = few.iter().find(|(s, _, _)| s == scope).unwrap();
        let id = match about {
            One(kind) => never(*kind),
            Server | Everybody => "any",
            _ => "",
        };
        let refused = read(ask(without, method, path, id)).await;
        let admitted = read(ask(with, method, path, id)).await;
        assert!(![401, 403].contains(&admitted.0), "{method} {path}: {admitted:?}");
        if *about == Everybody {
            assert!([200, 204].contains(&refused.0), "{method} {path}");
            continue;
        }
        assert_eq!(refused.0, 403, "{method} {path}");
        if *method == "head" {
            continue;
        }
        assert_eq!(refused.2["type"], "urn:relume:problem:forbidden", "{path}");
        let named = format!("\"{scope}\"");
        assert!(refused.2["detail"].as_str().unwrap().contains(&named), "{method} {path}: {refused:?}");
    }
}

/// A database of the version before tenants, with a job and its model.
async fn former_database(data: &TempDir) {
    let former = TempDir::new().unwrap();
    let migrations = concat!(env!("CARGO_MANIFEST_DIR"), "/migrations/sqlite");
    for name in ["0001_service.sql", "0002_checkpoint_hash.sql"] {
        std::fs::copy(format!("{migrations}/{name}"), former.path().join(name)).unwrap();
    }
    let url = format!("sqlite:{}?mode=rwc", data.path().join("relume.db").display());
    let pool = sqlx::SqlitePool::connect(&url).await.unwrap();
    Migrator::new(former.path()).await.unwrap().run(&pool).await.unwrap();
    let report = serde_json::to_string(&relume_spec::CaptureReport::default()).unwrap();
    let insert = "INSERT INTO captures VALUES ('c', 'cc', 1, 'captures/cc', ?1, 5)";
    sqlx::query(insert).bind(report).execute(&pool).await.unwrap();
    for statement in [
        "INSERT INTO environments VALUES ('e', 'ee', NULL, 1, 'environments/ee', 4, 2, '[]', 6)",
        "INSERT INTO jobs (id, capture_id, preset, overrides, device, priority, state, created_ms, total, model_id)
         VALUES ('j', 'c', 'draft', '{}', 'auto', 0, 'succeeded', 7, 10, 'm')",
        "INSERT INTO events (job_id, at_ms, kind, data) VALUES ('j', 7, 'state', '{}')",
        "INSERT INTO models VALUES ('m', 'j', 'c', 1, '{}', 8)",
        "INSERT INTO model_files VALUES ('m', 'model.ply', 'x/y', 1, 'ff', 'attempts/j/1/model.ply')",
        "INSERT INTO idempotency VALUES ('k', 'f', 'r', 9)",
    ] {
        sqlx::query(statement).execute(&pool).await.unwrap();
    }
    pool.close().await;
}

#[tokio::test]
async fn data_from_before_tenants_belongs_to_the_default_tenant() {
    let data = TempDir::new().unwrap();
    former_database(&data).await;
    let store = Store::open(data.path()).await.unwrap();
    for (tenant, expected) in [(TenantId::of_operator(), true), (TenantId::from("a"), false)] {
        let page = Page { limit: 9, before: None };
        assert_eq!(store.capture(&tenant, &"c".into()).await.unwrap().is_some(), expected);
        assert_eq!(store.capture_of_content(&tenant, "cc").await.unwrap().is_some(), expected);
        assert_eq!(store.environment(&tenant, &"e".into()).await.unwrap().is_some(), expected);
        assert_eq!(store.job(&tenant, &"j".into()).await.unwrap().is_some(), expected);
        assert_eq!(store.events_after(&tenant, &"j".into(), 0).await.unwrap().len(), usize::from(expected));
        assert_eq!(
            store.models(&tenant, &Filter::default(), &page).await.unwrap().len(),
            usize::from(expected)
        );
        let file = store.model_file(&tenant, &"m".into(), "model.ply").await.unwrap();
        assert_eq!(file.is_some(), expected);
    }
    store.close().await;
    let url = format!("sqlite:{}", data.path().join("relume.db").display());
    let pool = sqlx::SqlitePool::connect(&url).await.unwrap();
    let dangling = sqlx::query("PRAGMA foreign_key_check").fetch_all(&pool).await.unwrap();
    assert!(dangling.is_empty());
    // Foreign keys are still enforced.
    let capture = sqlx::query("DELETE FROM captures").execute(&pool).await.unwrap_err();
    assert!(capture.to_string().contains("FOREIGN KEY"), "{capture}");
    let keys: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM idempotency WHERE tenant = 'default'")
        .fetch_one(&pool)
        .await
        .unwrap();
    assert_eq!(keys, 1);
    pool.close().await;
}
