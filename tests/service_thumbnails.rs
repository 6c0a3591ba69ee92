//! Cached thumbnails: within the size limit, never served to other tenants, never served when damaged.

use std::path::{Path, PathBuf};
use std::time::Duration;

use relume::server::ApiKeys;
use relume::store;
use relume::testing::{self, TestServer};
use relume_api::ModelId;
use relume_api::keys::Scope;
use relume_client::Client;
use reqwest::{Method, StatusCode, header};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::{ALL_OF_A_TENANT, files_under, trained};

/// Size on disk of the smallest file.
const BLOCK: u64 = 4096;

/// An answered thumbnail.
#[derive(Debug, PartialEq)]
struct Answer {
    was_rendered: bool,
    bytes: Vec<u8>,
    /// The headers for tag, type and caching.
    headers: Vec<String>,
}

async fn get(client: &Client, model: &ModelId, query: &str) -> Answer {
    let path = format!("/v1/models/{model}/thumbnail?size=16{query}");
    let answer = client.request(Method::GET, &path).unwrap().send().await.unwrap();
    assert_eq!(answer.status(), StatusCode::OK, "{query}");
    let headers = answer.headers().clone();
    let named = [header::ETAG, header::CONTENT_TYPE, header::CACHE_CONTROL];
    Answer {
        // A rendered answer states its rendering time.
        was_rendered: headers.contains_key("server-timing"),
        bytes: answer.bytes().await.unwrap().to_vec(),
        headers: named.iter().map(|name| headers[name].to_str().unwrap().to_owned()).collect(),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn equal_concurrent_thumbnail_requests_render_once() {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let rendered = |answers: &[Answer]| answers.iter().filter(|answer| answer.was_rendered).count();
    let asked = (0..8).map(|_| get(server.client(), &model, "&azimuth=1"));
    let equal = futures::future::join_all(asked).await;
    assert_eq!(rendered(&equal), 1);
    assert!(equal.iter().all(|answer| answer.bytes == equal[0].bytes));
    let without = server_with(0).await;
    let model = trained(without.client()).await.model.unwrap();
    let asked = (0..8).map(|_| get(without.client(), &model, "&azimuth=1"));
    assert_eq!(rendered(&futures::future::join_all(asked).await), 8, "the control: nothing is kept there");
}

/// The cached files, by path.
fn cached(data: &Path) -> Vec<PathBuf> {
    let folder = data.join("cache/thumbnails");
    files_under(&folder).into_iter().map(|(name, _)| folder.join(name)).collect()
}

async fn server_with(bytes: u64) -> TestServer {
    testing::spawn_with(TempDir::new().unwrap(), |c| c.thumbnail_cache = bytes).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cached_thumbnail_survives_a_restart() {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let usage = server.client().usage().await.unwrap();
    let queries = ["", "&azimuth=9", "&format=jpeg", "&env=studio"];
    let mut first = Vec::new();
    for query in queries {
        first.push(get(server.client(), &model, query).await);
    }
    assert!(first.iter().all(|answer| answer.was_rendered));
    let again = async |server: &TestServer| {
        for (query, first) in queries.iter().zip(&first) {
            let second = get(server.client(), &model, query).await;
            assert!(!second.was_rendered, "{query}");
            assert_eq!((&second.bytes, &second.headers), (&first.bytes, &first.headers), "{query}");
        }
        assert!(get(server.client(), &model, "&azimuth=10&tier=high").await.was_rendered, "the control");
    };
    again(&server).await;
    let known = format!("/v1/models/{model}/thumbnail?size=16");
    let known = server.client().request(Method::GET, &known).unwrap();
    let known = known.header(header::IF_NONE_MATCH, &first[0].headers[0]).send().await.unwrap();
    assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
    let metrics = server.client().request(Method::GET, "/metrics").unwrap().send().await.unwrap();
    let metrics = metrics.text().await.unwrap();
    for outcome in ["hit", "miss"] {
        assert!(
            metrics.contains(&format!("relume_thumbnail_cache_total{{outcome=\"{outcome}\"}}")),
            "{metrics}"
        );
    }

    let after = server.client().usage().await.unwrap();
    assert_eq!((after.models, after.unreferenced_bytes), (usage.models, 0), "no tenant's bytes");
    let data = server.stop().await.unwrap();
    let looked = store::inspect(data.path()).await.unwrap();
    assert!(looked.faults.is_empty() && looked.orphans.is_empty(), "{looked:?}");
    let out = TempDir::new().unwrap();
    store::backup(data.path(), None, out.path(), 0).await.unwrap();
    assert!(cached(data.path()).len() > 3 && cached(out.path()).is_empty(), "a backup leaves it out");
    // One cached file is removed.
    let digest = first[3].headers[0].trim_matches('"');
    let kept = cached(data.path());
    let gone = kept.iter().find(|file| file.to_str().unwrap().ends_with(digest));
    std::fs::remove_file(gone.unwrap()).unwrap();

    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    let mut rendered = Vec::new();
    for (query, first) in queries.iter().zip(&first) {
        let answer = get(server.client(), &model, query).await;
        rendered.push(answer.was_rendered);
        assert_eq!(answer.bytes, first.bytes, "{query}");
    }
    assert_eq!(rendered, [false, false, false, true], "only what was taken away is rendered anew");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_cached_thumbnail_is_rendered_again() {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let first = get(server.client(), &model, "").await;
    let files = cached(server.data_dir());
    let [file] = &files[..] else { panic!("{files:?}") };
    let sound = std::fs::read(file).unwrap();
    for at in [0, sound.len() / 2, sound.len() - 1] {
        let mut bytes = sound.clone();
        bytes[at] ^= 1;
        std::fs::write(file, bytes).unwrap();
        assert_eq!(get(server.client(), &model, "").await, first, "byte {at}");
        let control = get(server.client(), &model, "").await;
        assert_eq!((control.was_rendered, &control.bytes), (false, &first.bytes), "the control");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn cached_thumbnails_are_per_tenant_and_deleted_with_the_model() {
    const OPERATOR: &str = "the-operators-own-key";
    let change = |config: &mut relume::server::ServerConfig| config.api_keys = ApiKeys::new([OPERATOR]);
    let server = testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap();
    let bearer = async |tenant: &str, scopes: &[Scope]| {
        let request = server.client().request(Method::POST, "/v1/keys").unwrap().bearer_auth(OPERATOR);
        let key = json!({ "name": "test", "tenant": tenant, "scopes": scopes });
        let made: Value = request.json(&key).send().await.unwrap().json().await.unwrap();
        let secret = made["secret"].as_str().map(str::to_owned);
        Client::new(server.client().base().as_str(), secret).unwrap()
    };
    let (one, other) = (bearer("one", &ALL_OF_A_TENANT).await, bearer("other", &ALL_OF_A_TENANT).await);
    let model = trained(&one).await.model.unwrap();
    assert!(get(&one, &model, "").await.was_rendered);
    let status = async |client: &Client| {
        let path = format!("/v1/models/{model}/thumbnail?size=16");
        client.request(Method::GET, &path).unwrap().send().await.unwrap().status().as_u16()
    };
    assert_eq!((status(&one).await, status(&other).await), (200, 404));
    assert_eq!(status(server.client()).await, 401);
    // The same content, trained to the same bytes by another tenant.
    let theirs = trained(&other).await.model.unwrap();
    assert!(get(&other, &theirs, "").await.was_rendered, "nobody learns what others looked at");
    assert_eq!(cached(server.data_dir()).len(), 2);

    one.delete_model(&model).await.unwrap();
    assert_eq!(status(&one).await, 404);
    let mut waited = 0;
    while cached(server.data_dir()).len() > 1 {
        waited += 1;
        assert!(waited < 1500, "the thumbnails of a deleted model stay");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(!get(&other, &theirs, "").await.was_rendered, "those of another model stay");

    // The state after a kill between the removal of the model and that of its thumbnails.
    let data = server.stop().await.unwrap();
    let left = cached(data.path());
    let name = left[0].file_name().unwrap().to_str().unwrap().replace(theirs.as_str(), model.as_str());
    std::fs::copy(&left[0], left[0].with_file_name(name)).unwrap();
    let server = testing::spawn_with(data, change).await.unwrap();
    while cached(server.data_dir()) != left {
        waited += 1;
        assert!(waited < 3000, "the thumbnails of a swept model stay");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn thumbnail_cache_stays_within_its_limit_and_evicts_the_oldest() {
    let server = server_with(3 * BLOCK).await;
    let model = trained(server.client()).await.model.unwrap();
    for azimuth in 0..5 {
        assert!(get(server.client(), &model, &format!("&azimuth={azimuth}")).await.was_rendered);
        let blocks: u64 =
            files_under(&server.data_dir().join("cache")).iter().map(|f| f.1.div_ceil(BLOCK)).sum();
        assert!(blocks <= 3, "{blocks}");
    }
    let mut rendered = Vec::new();
    for azimuth in (0..5).rev() {
        rendered.push(get(server.client(), &model, &format!("&azimuth={azimuth}")).await.was_rendered);
    }
    assert_eq!(rendered, [false, false, false, true, true]);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_cache_every_thumbnail_is_rendered_again() {
    let server = server_with(0).await;
    let model = trained(server.client()).await.model.unwrap();
    let (one, two) = (get(server.client(), &model, "").await, get(server.client(), &model, "").await);
    assert!(one.was_rendered && one == two);
    assert!(!server.data_dir().join("cache").exists());
}
