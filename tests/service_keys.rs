//! API keys: creation, use, lists and revocation, over HTTP and on the command line.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;
use std::time::Duration;

use crate::service_support::open_store;
use relume::jobs::ManualClock;
use relume::server::{ApiKeys, ServerConfig};
use relume::store::{NewKeyRecord, StoreError, has_keys};
use relume::testing::{self, TestServer};
use relume_api::keys::Scope;
use relume_api::{KeyId, TenantId};
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

const OPERATOR: &str = "the-operators-own-key";

/// A server with the operator's key and a stopped clock.
async fn server() -> (TestServer, Arc<ManualClock>) {
    let clock = Arc::new(ManualClock::default());
    let hands = clock.clone();
    let change = move |config: &mut ServerConfig| {
        config.api_keys = ApiKeys::new([OPERATOR]);
        config.clock = hands;
    };
    (testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap(), clock)
}

/// Status and body of an answer.
async fn ask(
    server: &TestServer,
    key: &str,
    method: Method,
    path: &str,
    body: Option<&Value>,
) -> (u16, Value) {
    let request = server.client().request(method, path).unwrap();
    let request = if key.is_empty() { request } else { request.bearer_auth(key) };
    let request = match body {
        Some(body) => request.json(body),
        None => request,
    };
    let answer = request.send().await.unwrap();
    (answer.status().as_u16(), serde_json::from_str(&answer.text().await.unwrap()).unwrap_or_default())
}

async fn get(server: &TestServer, key: &str, path: &str) -> (u16, Value) {
    ask(server, key, Method::GET, path, None).await
}

/// Creates a key; returns its identifier and the key.
async fn made(server: &TestServer, by: &str, body: Value) -> (String, String) {
    let (status, made) = ask(server, by, Method::POST, "/v1/keys", Some(&body)).await;
    assert_eq!(status, 201, "{made}");
    (made["id"].as_str().unwrap().to_owned(), made["secret"].as_str().unwrap().to_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_is_valid_until_it_is_revoked_or_expires() {
    let (server, clock) = server().await;
    let (lasting, secret) = made(&server, OPERATOR, json!({ "name": "a", "scopes": ["read"] })).await;
    clock.advance(Duration::from_millis(1));
    let short = json!({ "name": "b", "scopes": ["read"], "expires_in": 60 });
    let (_, short) = made(&server, OPERATOR, short).await;
    let mut changed = secret.clone();
    changed.replace_range(30..31, if &secret[30..31] == "0" { "1" } else { "0" });
    for (key, status) in [(&*secret, 200), (&*short, 200), (&*changed, 401), ("", 401), ("rlm_x_y", 401)] {
        assert_eq!(get(&server, key, "/v1/jobs").await.0, status, "{key}");
    }
    clock.advance(Duration::from_millis(59_999));
    assert_eq!(get(&server, &short, "/v1/jobs").await.0, 200);
    clock.advance(Duration::from_millis(1));
    assert_eq!(get(&server, &short, "/v1/jobs").await.0, 401, "it has expired");
    assert_eq!(get(&server, &secret, "/v1/jobs").await.0, 200);

    let revoke = format!("/v1/keys/{lasting}/revoke");
    let (status, revoked) = ask(&server, OPERATOR, Method::POST, &revoke, None).await;
    assert_eq!((status, &revoked["revoked_at"]), (200, &json!("1970-01-01T00:01:00.001Z")));
    assert_eq!(get(&server, &secret, "/v1/jobs").await.0, 401, "it is revoked");
    clock.advance(Duration::from_secs(60));
    let again = ask(&server, OPERATOR, Method::POST, &revoke, None).await.1;
    assert_eq!(again["revoked_at"], revoked["revoked_at"], "asking again changes nothing");
    let listed = get(&server, OPERATOR, "/v1/keys?limit=1").await.1;
    assert_eq!((&listed["items"][0]["name"], listed["next"].is_string()), (&json!("b"), true), "{listed}");
    assert!(!get(&server, OPERATOR, "/v1/keys").await.1.to_string().contains(&secret[21..]));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_key_request_is_refused_with_a_pointer() {
    let (server, _) = server().await;
    let good = json!({ "name": "a", "scopes": ["read"] });
    for (field, value) in [
        ("name", json!("")),
        ("name", json!("n".repeat(129))),
        ("name", json!("a\nb")),
        ("tenant", json!("Studio A")),
        ("scopes", json!([])),
        ("scopes", json!(["read", "read"])),
        ("expires_in", json!(0)),
        ("expires_in", json!(1u64 << 60)),
        ("colour", json!(1)),
    ] {
        let mut body = good.clone();
        body[field] = value;
        let (status, refused) = ask(&server, OPERATOR, Method::POST, "/v1/keys", Some(&body)).await;
        assert_eq!(
            (status, &refused["errors"][0]["pointer"]),
            (422, &json!(format!("/{field}"))),
            "{refused}"
        );
    }
    assert_eq!(get(&server, OPERATOR, "/v1/keys").await.1["items"], json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn tenant_admins_manage_own_keys_and_the_operator_all_keys() {
    let (server, _) = server().await;
    let admin = |tenant: &str| json!({ "name": tenant, "tenant": tenant, "scopes": ["admin"] });
    let (a, admin_of_a) = made(&server, OPERATOR, admin("a")).await;
    let (b, admin_of_b) = made(&server, OPERATOR, admin("b")).await;
    let (own, _) = made(&server, &admin_of_a, json!({ "name": "x", "scopes": ["read"] })).await;
    let names = |list: &Value| -> Vec<String> {
        list["items"].as_array().unwrap().iter().map(|k| k["id"].as_str().unwrap().to_owned()).collect()
    };
    let sorted = |mut ids: Vec<String>| {
        ids.sort();
        ids
    };
    assert_eq!(
        sorted(names(&get(&server, &admin_of_a, "/v1/keys").await.1)),
        sorted(vec![a.clone(), own.clone()])
    );
    assert_eq!(names(&get(&server, &admin_of_b, "/v1/keys").await.1), std::slice::from_ref(&b));
    assert_eq!(sorted(names(&get(&server, OPERATOR, "/v1/keys").await.1)), sorted(vec![a, b, own.clone()]));
    assert_eq!(get(&server, &admin_of_b, &format!("/v1/keys/{own}")).await.0, 404);
    let revoke = format!("/v1/keys/{own}/revoke");
    assert_eq!(ask(&server, &admin_of_b, Method::POST, &revoke, None).await.0, 404);
    assert_eq!(get(&server, &admin_of_a, &format!("/v1/keys/{own}")).await.1["revoked_at"], json!(null));
    let (status, refused) = ask(&server, &admin_of_a, Method::POST, "/v1/keys", Some(&admin("b"))).await;
    assert_eq!((status, &refused["type"]), (403, &json!("urn:relume:problem:forbidden")));
    assert_eq!(get(&server, &admin_of_a, "/metrics").await.0, 403, "these are about all tenants");
    assert_eq!(ask(&server, OPERATOR, Method::POST, &revoke, None).await.0, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn keys_expire_and_are_revoked_with_the_key_that_created_them() {
    let (server, clock) = server().await;
    let admin = json!({ "name": "admin", "tenant": "a", "scopes": ["admin", "read"], "expires_in": 100 });
    let (parent, parents) = made(&server, OPERATOR, admin).await;
    let (child, childs) =
        made(&server, &parents, json!({ "name": "child", "scopes": ["admin", "read"] })).await;
    let longer = json!({ "name": "grandchild", "scopes": ["read"], "expires_in": 1000 });
    let (grandchild, grandchilds) = made(&server, &childs, longer).await;
    let (_, beside) =
        made(&server, OPERATOR, json!({ "name": "beside", "tenant": "a", "scopes": ["read"] })).await;
    let end = json!("1970-01-01T00:01:40Z");
    for id in [&child, &grandchild] {
        let shown = get(&server, OPERATOR, &format!("/v1/keys/{id}")).await.1;
        assert_eq!(shown["expires_at"], end, "not beyond the key that made it: {shown}");
    }
    assert_eq!(get(&server, OPERATOR, &format!("/v1/keys/{child}")).await.1["made_by"], json!(parent));
    assert_eq!(get(&server, OPERATOR, &format!("/v1/keys/{parent}")).await.1["made_by"], json!(null));
    assert_eq!(get(&server, &grandchilds, "/v1/jobs").await.0, 200, "the control");

    clock.advance(Duration::from_secs(1));
    let revoke = format!("/v1/keys/{parent}/revoke");
    let (status, revoked) = ask(&server, &parents, Method::POST, &revoke, None).await;
    let mut gone = [child.clone(), grandchild];
    gone.sort();
    assert_eq!((status, &revoked["took_along"]), (200, &json!(gone)), "{revoked}");
    for (key, expected) in [(&parents, 401), (&childs, 401), (&grandchilds, 401), (&beside, 200)] {
        assert_eq!(get(&server, key, "/v1/jobs").await.0, expected);
    }
    let shown = get(&server, OPERATOR, &format!("/v1/keys/{child}")).await.1;
    assert_eq!(shown["revoked_at"], json!("1970-01-01T00:00:01Z"));
    let listed = said(&relume(&["keys", "list"], server.data_dir()));
    assert_eq!(listed.matches("revoked").count(), 3, "{listed}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_key_cannot_create_keys() {
    let data = TempDir::new().unwrap();
    let store = open_store(data.path()).await;
    let key = |made_by: Option<KeyId>| NewKeyRecord {
        name: "a".into(),
        tenant: TenantId::of_operator(),
        scopes: vec![Scope::Admin],
        expires_ms: None,
        made_by,
    };
    let parent = store.create_key(&key(None), 0).await.unwrap().0.id;
    store.create_key(&key(Some(parent.clone())), 0).await.unwrap();
    store.revoke_key(None, &parent, 1).await.unwrap();
    let late = store.create_key(&key(Some(parent)), 2).await;
    assert!(matches!(late, Err(StoreError::KeyRevoked)), "{late:?}");
    store.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_scope_reads_only_metrics() {
    let (server, _) = server().await;
    let scraper = |tenant: &str| json!({ "name": "scraper", "tenant": tenant, "scopes": ["metrics"] });
    let (_, key) = made(&server, OPERATOR, scraper("default")).await;
    assert_eq!(get(&server, &key, "/metrics").await.0, 200);
    assert_eq!(get(&server, OPERATOR, "/metrics").await.0, 200, "administrators still may");
    for path in ["/v1/keys", "/v1/jobs", "/v1/usage"] {
        assert_eq!(get(&server, &key, path).await.0, 403, "{path}");
    }
    // Another tenant cannot use this scope, even in keys of earlier versions; its administrators cannot grant
    // it to themselves.
    let (_, of_a) = made(&server, OPERATOR, json!({ "name": "a", "tenant": "a", "scopes": ["admin"] })).await;
    let unnamed = json!({ "name": "scraper", "scopes": ["read", "metrics"] });
    for (key, body) in [(OPERATOR, scraper("a")), (&of_a, scraper("a")), (&of_a, unnamed)] {
        let (status, refused) = ask(&server, key, Method::POST, "/v1/keys", Some(&body)).await;
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!("/scopes")), "{refused}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn raising_priority_needs_a_scope_that_only_the_operator_grants() {
    let (server, _) = server().await;
    let key = |scopes: &[&str]| json!({ "name": "a", "tenant": "a", "scopes": scopes });
    let (_, submits) = made(&server, OPERATOR, key(&["submit", "read", "admin"])).await;
    let (_, hurries) = made(&server, OPERATOR, key(&["submit", "read", "priority"])).await;
    let post =
        async |key: &str, path: &str, body: Value| ask(&server, key, Method::POST, path, Some(&body)).await;
    let (status, refused) = post(&submits, "/v1/keys", key(&["priority"])).await;
    assert_eq!(status, 403, "a tenant does not raise itself above others: {refused}");

    let client = relume_client::Client::new(server.client().base().as_str(), Some(submits.clone())).unwrap();
    let capture = client.upload_capture_bytes(crate::service_support::capture_zip()).await.unwrap().id;
    let job = |priority: i64| json!({ "capture": capture, "priority": priority, "overrides": { "iterations": 100_000 } });
    let (status, refused) = post(&submits, "/v1/jobs", job(1)).await;
    assert_eq!(status, 403);
    assert!(refused["detail"].as_str().unwrap().contains("\"priority\""), "{refused}");
    let running = post(&submits, "/v1/jobs", job(0)).await;
    assert_eq!(running.0, 202);
    // The next job has a higher priority, so the worker must already be busy.
    let first = format!("/v1/jobs/{}", running.1["id"].as_str().unwrap());
    while get(&server, &submits, &first).await.1["state"] == json!("queued") {
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    let (status, raised) = post(&hurries, "/v1/jobs", job(1)).await;
    assert_eq!((status, &raised["priority"]), (202, &json!(1)));
    let path = format!("/v1/jobs/{}", raised["id"].as_str().unwrap());
    let change = |priority: i64| json!({ "priority": priority });
    for (key, priority, expected) in [(&submits, 2, 403), (&submits, -1, 200), (&hurries, 2, 200)] {
        let (status, told) = ask(&server, key, Method::PATCH, &path, Some(&change(priority))).await;
        assert_eq!(status, expected, "{told}");
    }
    // A retry of a job with a raised priority does not keep the raise.
    assert_eq!(post(&submits, &format!("{path}/cancel"), json!({})).await.0, 200);
    let (status, again) = post(&submits, &format!("{path}/retry"), json!({})).await;
    assert_eq!((status, &again["priority"]), (202, &json!(0)), "{again}");
    for job in [running.1, again] {
        post(&submits, &format!("/v1/jobs/{}/cancel", job["id"].as_str().unwrap()), json!({})).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn creating_the_first_key_closes_an_open_server_permanently() {
    let server = testing::spawn().await.unwrap();
    assert_eq!(get(&server, "", "/v1/jobs").await.0, 200);
    let body = json!({ "name": "a", "scopes": ["read", "admin"] });
    let (status, refused) = ask(&server, "", Method::POST, "/v1/keys", Some(&body)).await;
    assert_eq!(
        (status, &refused["type"]),
        (403, &json!("urn:relume:problem:forbidden")),
        "any caller could lock out all"
    );
    assert_eq!(get(&server, "", "/v1/jobs").await.0, 200, "it is open still");
    let create = ["keys", "create", "--name", "a", "--scopes", "read,admin"];
    let secret = said(&relume(&create, server.data_dir()));
    let id = secret[4..20].to_owned();
    assert_eq!(get(&server, "", "/v1/jobs").await.0, 401);
    assert_eq!(get(&server, &secret, "/v1/jobs").await.0, 200);
    assert_eq!(ask(&server, &secret, Method::POST, &format!("/v1/keys/{id}/revoke"), None).await.0, 200);
    let data = server.stop().await.unwrap();
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    for key in ["", &*secret] {
        assert_eq!(get(&server, key, "/v1/jobs").await.0, 401, "the last key gone opens nothing");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn last_use_of_a_key_is_stored_at_most_once_a_minute() {
    let (server, clock) = server().await;
    let (id, secret) = made(&server, OPERATOR, json!({ "name": "a", "scopes": ["read"] })).await;
    let path = format!("/v1/keys/{id}");
    let until_used_at = async |time: &str| {
        for _ in 0..3000 {
            if get(&server, OPERATOR, &path).await.1["last_used_at"] == json!(time) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        panic!("never used at {time}");
    };
    assert_eq!(get(&server, OPERATOR, &path).await.1["last_used_at"], json!(null));
    // A caller that knows only the identifier has not used the key. If this were recorded, it would hide the
    // real use a second later.
    let forged = format!("/v1/models/x/thumbnail?key={id}&expires=9999999999&signature=00");
    assert_eq!(get(&server, "", &forged).await.0, 403);
    clock.advance(Duration::from_secs(1));
    get(&server, &secret, "/v1/jobs").await;
    until_used_at("1970-01-01T00:00:01Z").await;
    clock.advance(Duration::from_secs(59));
    get(&server, &secret, "/v1/jobs").await;
    // One connection writes in order: if that use had been recorded, the next one could not be recorded.
    clock.advance(Duration::from_secs(1));
    get(&server, &secret, "/v1/jobs").await;
    until_used_at("1970-01-01T00:01:01Z").await;
}

fn relume(args: &[&str], data: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.args(args).arg("--data-dir").arg(data).output().unwrap()
}

fn said(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap().trim().to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn cli_creates_lists_and_revokes_keys_of_a_running_server() {
    let server = testing::spawn().await.unwrap();
    assert_eq!(get(&server, "", "/v1/jobs").await.0, 200, "it is up");
    let create = ["keys", "create", "--name", "render farm", "--tenant", "studio-a", "--scopes", "read"];
    let key = said(&relume(&create, server.data_dir()));
    assert_eq!(get(&server, &key, "/v1/jobs").await.0, 200);
    assert_eq!(get(&server, "", "/v1/jobs").await.0, 401, "the server is not open any more");
    let listed = said(&relume(&["keys", "list"], server.data_dir()));
    let id = &key[4..20];
    let line = listed.lines().find(|line| line.starts_with(id)).unwrap_or_else(|| panic!("{listed}"));
    for word in ["valid", "studio-a", "read", "render farm"] {
        assert!(line.contains(word), "{word} in {line}");
    }
    assert!(!listed.contains(&key[21..]), "a list has no secrets");
    said(&relume(&["keys", "revoke", id], server.data_dir()));
    assert_eq!(get(&server, &key, "/v1/jobs").await.0, 401);
    assert!(said(&relume(&["keys", "list"], server.data_dir())).contains("revoked"));
    let nobody = relume(&["keys", "revoke", "nobody"], server.data_dir());
    assert!(!nobody.status.success() && String::from_utf8_lossy(&nobody.stderr).contains("nobody"));

    let data = server.stop().await.unwrap();
    for file in ["relume.db", "relume.db-wal"] {
        let bytes = std::fs::read(data.path().join(file)).unwrap_or_default();
        let secret = &key.as_bytes()[21..];
        assert!(!bytes.windows(secret.len()).any(|w| w == secret), "{file} has the secret");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn with_a_stored_key_a_server_may_listen_beyond_loopback() {
    let data = TempDir::new().unwrap();
    assert!(!has_keys(data.path(), None).await.unwrap());
    said(&relume(&["keys", "create", "--name", "first"], data.path()));
    assert!(has_keys(data.path(), None).await.unwrap());
    let listener = tokio::net::TcpListener::bind("0.0.0.0:0").await.unwrap();
    relume::server::run(ServerConfig::new(data.path()), listener, async {}).await.unwrap();
    let wrong = relume(&["keys", "create", "--name", "x", "--tenant", "A B"], data.path());
    assert!(String::from_utf8_lossy(&wrong.stderr).contains("--tenant"), "{wrong:?}");
    let nothing = TempDir::new().unwrap();
    assert!(!relume(&["keys", "list"], nothing.path()).status.success());
    assert!(std::fs::read_dir(nothing.path()).unwrap().next().is_none(), "a look makes nothing");
}

#[tokio::test(flavor = "multi_thread")]
async fn api_keys_are_read_from_a_key_file() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("keys");
    std::fs::write(&file, "# for the farm\nfirst-key-of-the-file\n\n  second-key-of-the-file\n").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.env("RELUME_API_KEY_FILE", &file);
    let server = crate::server_process::Server::start_under(command, &folder.path().join("data"));
    let status = async |key: &str| {
        let request = server.client.request(Method::GET, "/v1/jobs").unwrap();
        request.bearer_auth(key).send().await.unwrap().status().as_u16()
    };
    for (key, expected) in
        [("first-key-of-the-file", 200), ("second-key-of-the-file", 200), ("# for the farm", 401)]
    {
        assert_eq!(status(key).await, expected, "{key}");
    }
    let refused = |text: &str, word: &str| {
        std::fs::write(&file, text).unwrap();
        let args = ["serve", "--listen", "127.0.0.1:0", "--api-key-file", file.to_str().unwrap()];
        let output = relume(&args, &folder.path().join("other"));
        let why = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && why.contains(word), "{why}");
    };
    refused("first-key-of-the-file\nshort\n", "line 2");
    refused("# nothing\n", "contains no key");
}
