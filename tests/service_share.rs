//! The page that shows a model to people without a key.

use std::sync::Arc;
use std::time::Duration;

use relume::jobs::ManualClock;
use relume::server::{ApiKeys, ServerConfig};
use relume::testing::{self, TestServer};
use relume_api::ModelId;
use relume_api::metadata::MetadataChange;
use relume_capture::formats::image_file;
use relume_client::Client;
use reqwest::{Method, header};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::trained;

const OPERATOR: &str = "the-operators-own-key";

struct Shared {
    server: TestServer,
    clock: Arc<ManualClock>,
    /// A client with a key.
    owner: Client,
    model: ModelId,
}

impl Shared {
    /// A server with a model; with keys if `has_keys`.
    async fn new(has_keys: bool) -> Self {
        let clock = Arc::new(ManualClock::default());
        let hands = clock.clone();
        let change = move |config: &mut ServerConfig| {
            config.clock = hands;
            config.api_keys = if has_keys { ApiKeys::new([OPERATOR]) } else { ApiKeys::default() };
        };
        let server = testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap();
        let key = has_keys.then(|| OPERATOR.to_owned());
        let owner = Client::new(server.client().base().as_str(), key).unwrap();
        let model = trained(&owner).await.model.unwrap();
        Self { server, clock, owner, model }
    }

    /// The signed link of a page, valid for an hour.
    async fn link(&self) -> String {
        let path = format!("/share/{}?light=sunset&azimuth=30", self.model);
        let request = self.owner.request(Method::POST, "/v1/signed-urls").unwrap();
        let answer = request.json(&json!({ "path": path })).send().await.unwrap();
        let signed: Value = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
        signed["url"].as_str().unwrap_or_else(|| panic!("{signed}")).to_owned()
    }

    /// The text of a page, for a browser without a key.
    async fn page(&self, link: &str) -> String {
        let answer = self.server.client().request(Method::GET, link).unwrap().send().await.unwrap();
        assert_eq!(answer.status(), 200);
        assert_eq!(answer.headers()[header::CONTENT_TYPE], "text/html; charset=utf-8");
        assert_eq!(answer.headers()[header::CACHE_CONTROL], "no-store");
        let policy = answer.headers()[header::CONTENT_SECURITY_POLICY].to_str().unwrap().to_owned();
        assert!(policy.contains("default-src 'none'") && policy.contains("script-src 'self'"), "{policy}");
        answer.text().await.unwrap()
    }

    /// The status of a request of the page.
    async fn status(&self, method: Method, path: &str, link: &str) -> u16 {
        let share = link.split_once('?').map_or("", |(_, query)| query);
        let request = self.server.client().request(method, path).unwrap().header("relume-share", share);
        request.send().await.unwrap().status().as_u16()
    }
}

/// The address of the preview picture of a page.
fn picture(page: &str) -> Option<String> {
    let (_, rest) = page.split_once("property=\"og:image\" content=\"")?;
    Some(rest.split_once('"')?.0.replace("&amp;", "&"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shared_page_shows_only_its_model_until_it_expires() {
    let shared = Shared::new(true).await;
    let model = &shared.model;
    let change = MetadataChange { name: Some(Some("A <red> vase".to_owned())), ..MetadataChange::default() };
    shared.owner.change_model(model, &change).await.unwrap();
    let link = shared.link().await;
    let page = shared.page(&link).await;
    assert!(page.contains("<title>A &lt;red&gt; vase</title>"), "{page}");
    let picture = picture(&page).unwrap();
    let base = shared.server.client().base().to_string();
    let path = picture.strip_prefix(base.trim_end_matches('/')).unwrap();
    assert!(path.contains("env=sunset") && path.contains("azimuth=30"), "{path}");
    let bytes = shared.server.client().request(Method::GET, path).unwrap().send().await.unwrap();
    assert_eq!(image_file::dimensions(&bytes.bytes().await.unwrap()).unwrap(), (1024, 1024));

    let of_model = |rest: &str| format!("/v1/models/{model}/{rest}");
    for read in ["stream", "light?environment=studio&rotation=90", "thumbnail?size=16&env=night"] {
        assert_eq!(shared.status(Method::GET, &of_model(read), &link).await, 200, "{read}");
        assert_eq!(shared.status(Method::GET, &of_model(read), "").await, 403, "{read}, without the link");
    }
    for (method, path) in [
        (Method::GET, format!("/v1/models/{model}")),
        (Method::GET, of_model("card")),
        (Method::GET, of_model("files/model.ply")),
        (Method::POST, of_model("render")),
        (Method::POST, of_model("stream")),
        (Method::DELETE, format!("/v1/models/{model}")),
        (Method::GET, "/v1/models/another/stream".to_owned()),
        (Method::GET, "/v1/models".to_owned()),
        (Method::GET, "/v1/environments".to_owned()),
    ] {
        assert_eq!(shared.status(method.clone(), &path, &link).await, 403, "{method} {path}");
    }

    let stream = of_model("stream");
    let changed = link.replace("light=sunset", "light=studio");
    assert_eq!(shared.status(Method::GET, &stream, &changed).await, 403, "a changed link");
    let unsigned = format!("/share/{model}?light=sunset");
    shared.clock.advance(Duration::from_secs(3599));
    assert_eq!(shared.status(Method::GET, &stream, &link).await, 200);
    shared.clock.advance(Duration::from_secs(2));
    assert_eq!(shared.status(Method::GET, &stream, &link).await, 403, "the link has expired");
    for link in [&link, &changed, &unsigned, "/share/another"] {
        let page = shared.page(link).await;
        assert!(!page.contains("vase") && !page.contains("og:"), "{link}: {page}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_keys_a_shared_page_needs_no_signature() {
    let shared = Shared::new(false).await;
    let page = shared.page(&format!("/share/{}", shared.model)).await;
    let picture = picture(&page).unwrap();
    assert!(page.contains("<title>A relightable model</title>") && picture.contains("env=studio"), "{page}");
    assert!(!picture.contains("signature"), "{picture}");
    assert!(!shared.page("/share/nobody").await.contains("<title>"), "a model that does not exist");
}
