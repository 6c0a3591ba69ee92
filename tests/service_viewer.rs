//! Streams for viewers: caching by tags, equal numbers of Gaussians in both, signed URLs, and bounded memory.

use relume::server::ApiKeys;
use relume::testing;
use relume_api::ModelId;
use relume_api::signed_urls::NewSignedUrl;
use relume_client::Client;
use relume_scene::EnvMap;
use reqwest::header::{CACHE_CONTROL, ETAG, IF_NONE_MATCH};
use reqwest::{Method, Response};
use serde_json::Value;

use crate::service_support::trained;

async fn get(client: &Client, method: Method, path: &str, tag: Option<&str>) -> Response {
    let request = client.request(method, path).unwrap();
    let request = tag.map_or(request.try_clone().unwrap(), |tag| request.header(IF_NONE_MATCH, tag));
    request.send().await.unwrap()
}

/// The header of a stream.
fn header(bytes: &[u8], magic: &[u8; 4]) -> Value {
    assert_eq!(&bytes[..4], magic);
    let length = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[12..12 + length]).unwrap()
}

fn tag_of(response: &Response) -> String {
    response.headers()[ETAG].to_str().unwrap().to_owned()
}

async fn with_model() -> (testing::TestServer, ModelId) {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    (server, model)
}

#[tokio::test(flavor = "multi_thread")]
async fn both_viewer_streams_have_one_record_per_gaussian() {
    let (server, model) = with_model().await;
    let gaussians = server.client().model(&model).await.unwrap().summary.gaussians;
    let stream = server.client().viewer_stream(&model).await.unwrap();
    let sky = EnvMap::from_fn(128, 64, |d| [if d.z > 0.998 { 900.0 } else { 1.0 }; 3]);
    let sky = relume_capture::formats::exr_image::encode_rgb(128, 64, sky.texels()).unwrap();
    let sky = server.client().upload_environment(sky).await.unwrap().id;
    let light =
        server.client().viewer_light(&model, &format!("environment={sky}&rotation=40")).await.unwrap();
    let (stream, light) = (header(&stream, b"RLMG"), header(&light, b"RLML"));
    assert_eq!(
        (&stream["records"]["count"], &light["records"]["count"]),
        (&gaussians.into(), &gaussians.into())
    );
    assert_eq!(stream["shading"]["shade_at"], "gaussian");
    assert_eq!(light["lights"].as_array().unwrap().len(), 1, "the sun");
    assert!(light["map"].is_null(), "nobody asked for it");
    let with_map = server.client().viewer_light(&model, "environment=studio&map=true").await.unwrap();
    assert!(header(&with_map, b"RLML")["map"]["height"].as_u64().unwrap() <= 256);
}

#[tokio::test(flavor = "multi_thread")]
async fn viewer_streams_answer_304_for_a_known_etag() {
    let (server, model) = with_model().await;
    let mut tags = Vec::new();
    for (path, cache) in [
        (format!("/v1/models/{model}/stream"), "public, no-cache"),
        (format!("/v1/models/{model}/light?environment=studio"), "public, no-cache"),
        (format!("/v1/models/{model}/light?environment=studio&rotation=5"), "public, no-cache"),
        (format!("/v1/models/{model}/light?environment=studio&map=true"), "public, no-cache"),
        (format!("/v1/models/{model}/light"), "public, no-cache"),
    ] {
        let first = get(server.client(), Method::GET, &path, None).await;
        assert_eq!(
            (first.status().as_u16(), &first.headers()[CACHE_CONTROL]),
            (200, &cache.parse().unwrap())
        );
        let tag = tag_of(&first);
        let again = get(server.client(), Method::GET, &path, Some(&tag)).await;
        assert_eq!((again.status().as_u16(), tag_of(&again)), (304, tag.clone()), "{path}");
        assert!(again.bytes().await.unwrap().is_empty());
        let other = get(server.client(), Method::GET, &path, Some("\"another\"")).await;
        assert_eq!(
            other.bytes().await.unwrap(),
            first.bytes().await.unwrap(),
            "the control: another tag, and equal bytes"
        );
        let head = get(server.client(), Method::HEAD, &path, None).await;
        assert_eq!((head.status().as_u16(), tag_of(&head)), (200, tag.clone()));
        assert!(!tags.contains(&tag), "each light has a tag of its own");
        tags.push(tag);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_viewer_light_parameters_are_refused_by_name() {
    let (server, model) = with_model().await;
    for (query, parameter) in [
        ("environment=moon", "query/environment"),
        ("rotation=inf", "query/rotation"),
        ("rotation=x", "query"),
        ("sun=1", "query"),
    ] {
        let answer =
            get(server.client(), Method::GET, &format!("/v1/models/{model}/light?{query}"), None).await;
        assert_eq!(answer.status().as_u16(), 422, "{query}");
        assert!(answer.text().await.unwrap().contains(parameter), "{query}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn both_viewer_streams_accept_signed_urls() {
    let keys = |config: &mut relume::server::ServerConfig| config.api_keys = ApiKeys::new(["operator"]);
    let server = testing::spawn_with(tempfile::TempDir::new().unwrap(), keys).await.unwrap();
    let client = Client::new(server.client().base().as_str(), Some("operator".to_owned())).unwrap();
    let model = trained(&client).await.model.unwrap();
    for path in [
        format!("/v1/models/{model}/stream"),
        format!("/v1/models/{model}/light?environment=dawn&rotation=7"),
    ] {
        let bare = get(server.client(), Method::GET, &path, None).await;
        assert_eq!(bare.status().as_u16(), 401, "the control: {path}");
        let signed = client.sign_url(&NewSignedUrl { path: path.clone(), expires_in: 60 }).await.unwrap();
        let answer = get(server.client(), Method::GET, &signed.url, None).await;
        assert_eq!(answer.status().as_u16(), 200, "{path}");
        assert!(answer.headers()[CACHE_CONTROL].to_str().unwrap().starts_with("private"));
    }
}
