//! Headers of answers and times of events.

use relume::testing;
use relume_capture::formats::environment;
use relume_scene::EnvMap;
use reqwest::{Method, RequestBuilder, Response, StatusCode, header};
use serde_json::Value;

use crate::service_support::{capture_zip, small_job, trained};

#[tokio::test(flavor = "multi_thread")]
async fn head_of_a_thumbnail_returns_its_etag_without_rendering() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let id = trained(client).await.model.unwrap();
    let ask = async |method, query: &str| {
        let path = format!("/v1/models/{id}/thumbnail?{query}");
        let answer = client.request(method, &path).unwrap().send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK);
        answer.headers().clone()
    };
    let head = ask(Method::HEAD, "size=16&format=jpeg").await;
    let get = ask(Method::GET, "size=16&format=jpeg").await;
    for name in [header::ETAG, header::CONTENT_TYPE, header::CACHE_CONTROL] {
        assert_eq!(head[&name], get[&name]);
    }
    // A rendered answer states its rendering time.
    assert!(!head.contains_key("server-timing") && get.contains_key("server-timing"));
}

/// The `Content-Length` that an answer states.
fn stated_length(answer: &Response) -> Option<usize> {
    let length = answer.headers().get(header::CONTENT_LENGTH)?;
    Some(length.to_str().unwrap().parse().unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn head_states_the_length_of_get_or_no_length() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let (capture, model) = (&job.capture, job.model.as_ref().unwrap());
    let ask = async |method: Method, path: &str| {
        let answer = client.request(method, path).unwrap().send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK, "{path}");
        answer
    };
    for (path, is_stated) in [
        (format!("/v1/models/{model}/thumbnail?size=16"), false),
        (format!("/v1/models/{model}/thumbnail?size=16&format=jpeg"), false),
        (format!("/v1/models/{model}/stream"), false),
        (format!("/v1/models/{model}/light?environment=studio"), false),
        (format!("/v1/captures/{capture}/photographs/train%2Fr_1.png?width=16"), false),
        (format!("/v1/captures/{capture}/photographs/train%2Fr_2.png"), false),
        (format!("/v1/jobs/{}/events", job.id), false),
        (format!("/v1/models/{model}/files/model.safetensors"), true),
        (format!("/v1/models/{model}"), true),
        ("/v1/openapi.json".to_owned(), true),
        ("/".to_owned(), true),
    ] {
        // Before and after the server has the bytes in its cache.
        let before = ask(Method::HEAD, &path).await;
        let bytes = ask(Method::GET, &path).await.bytes().await.unwrap().len();
        let after = ask(Method::HEAD, &path).await;
        assert!(bytes > 0, "{path}");
        for length in [stated_length(&before), stated_length(&after)] {
            assert!(length.is_none_or(|length| length == bytes), "{path}: {length:?}, not {bytes}");
            assert!(length.is_some() || !is_stated, "the control: {path}");
        }
        let Some(tag) = after.headers().get(header::ETAG) else { continue };
        let known = client.request(Method::HEAD, &path).unwrap().header(header::IF_NONE_MATCH, tag);
        let known = known.send().await.unwrap();
        assert_eq!((known.status(), stated_length(&known)), (StatusCode::NOT_MODIFIED, None), "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn event_streams_ask_proxies_not_to_buffer() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await.id;
    let ask = async |path: String| client.request(Method::GET, &path).unwrap().send().await.unwrap();
    let events = ask(format!("/v1/jobs/{job}/events")).await;
    assert_eq!(events.headers()["x-accel-buffering"], "no");
    assert_eq!(events.headers()[header::CACHE_CONTROL], "no-cache");
    assert_eq!(events.headers()[header::CONTENT_TYPE], "text/event-stream");
    let view = ask(format!("/v1/jobs/{job}")).await;
    assert!(!view.headers().contains_key("x-accel-buffering"), "the control");
}

#[tokio::test(flavor = "multi_thread")]
async fn created_resources_have_a_location_and_events_a_time() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let location = async |request: RequestBuilder| {
        let answer = request.send().await.unwrap();
        let status = answer.status();
        let path = answer.headers().get(header::LOCATION).map(|path| path.to_str().unwrap().to_owned());
        let made: Value = answer.json().await.unwrap();
        let path = path.unwrap_or_else(|| panic!("{status} without a location: {made}"));
        let found: Value =
            client.request(Method::GET, &path).unwrap().send().await.unwrap().json().await.unwrap();
        assert_eq!(found["id"], made["id"], "{path}");
        status
    };
    let map = EnvMap::constant(2, 1, [1.0; 3]);
    let map = environment::encode_exr(&map).unwrap();
    let upload = client.request(Method::POST, "/v1/environments").unwrap();
    let upload = upload.header(header::CONTENT_TYPE, "image/x-exr").body(map);
    assert_eq!(location(upload).await, StatusCode::CREATED);
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = small_job(&capture.id, 100_000, 1000);
    let post = || {
        let request = client.request(Method::POST, "/v1/jobs").unwrap();
        request.header("idempotency-key", "once").json(&job)
    };
    assert_eq!([location(post()).await, location(post()).await], [StatusCode::ACCEPTED; 2]);
    let id = client.jobs().await.unwrap().items[0].id.clone();
    client.cancel_job(&id).await.unwrap();
    let mut times = Vec::new();
    let job =
        client.wait(&id, |event| times.push(event.data["at"].as_str().unwrap().to_owned())).await.unwrap();
    assert_eq!((times.first(), times.last()), (Some(&job.created_at), job.finished_at.as_ref()));
    let retry = client.request(Method::POST, &format!("/v1/jobs/{id}/retry")).unwrap();
    assert_eq!(location(retry).await, StatusCode::ACCEPTED);
    // A repetition gets the first answer, even after the deletion of the capture.
    let delete = format!("/v1/captures/{}?cascade=true", capture.id);
    let gone = client.request(Method::DELETE, &delete).unwrap().send().await.unwrap();
    assert_eq!(gone.status(), StatusCode::NO_CONTENT);
    let again = post().send().await.unwrap();
    assert_eq!(
        (again.status(), &again.headers()["idempotent-replayed"]),
        (StatusCode::ACCEPTED, &"true".parse().unwrap())
    );
    assert_eq!(again.json::<Value>().await.unwrap()["id"], id.as_str());
}
