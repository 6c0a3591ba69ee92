//! The HTTP conventions: problems, caching, ranges, keys, metrics.

use relume::server::ApiKeys;
use relume::testing;
use relume_api::JobId;
use relume_api::jobs::JobState;
use relume_capture::builtin;
use relume_capture::formats::model_file;
use relume_client::Client;
use relume_compare::worst;
use relume_scene::EnvMap;
use relume_spec::training::{KnownLight, LightExposure};
use reqwest::{Method, RequestBuilder, StatusCode, header};
use serde_json::{Value, json};

use crate::service_support::{capture_zip, ended, small_job, trained};

/// Sends a request and checks that the answer is a problem of this type with the request's identifier.
async fn problem(request: RequestBuilder, status: u16, kind: &str) -> Value {
    let response = request.header("x-request-id", "test-1").send().await.unwrap();
    assert_eq!(response.headers()["x-request-id"], "test-1");
    let media = response.headers()[header::CONTENT_TYPE].to_str().unwrap().to_owned();
    let found = response.status().as_u16();
    let body: Value = serde_json::from_str(&response.text().await.unwrap()).unwrap();
    assert_eq!((found, media.as_str()), (status, "application/problem+json"), "{body}");
    assert_eq!(body["type"], format!("urn:relume:problem:{kind}"), "{body}");
    assert_eq!((&body["status"], &body["request_id"]), (&json!(status), &json!("test-1")));
    body
}

fn post_json(client: &Client, path: &str, body: &Value) -> RequestBuilder {
    client.request(Method::POST, path).unwrap().json(body)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_error_is_a_problem_with_the_request_id() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let get = |path: &str| client.request(Method::GET, path).unwrap();
    problem(get("/nowhere"), 404, "not-found").await;
    problem(client.request(Method::DELETE, "/v1/jobs").unwrap(), 405, "method-not-allowed").await;
    for family in ["captures", "environments", "jobs", "models"] {
        problem(get(&format!("/v1/{family}/nobody")), 404, "not-found").await;
        problem(get(&format!("/v1/{family}?limit=0")), 422, "invalid-field").await;
        let body = problem(get(&format!("/v1/{family}?colour=red")), 422, "invalid-field").await;
        assert_eq!(body["errors"][0]["pointer"], "query/colour", "{body}");
    }
    for path in ["events", "cancel", "retry"] {
        let method = if path == "events" { Method::GET } else { Method::POST };
        problem(client.request(method, &format!("/v1/jobs/nobody/{path}")).unwrap(), 404, "not-found").await;
    }
    problem(get("/v1/models/nobody/thumbnail"), 404, "not-found").await;
    problem(get("/v1/models/nobody/files/model.ply"), 404, "not-found").await;
    let plain = client.request(Method::POST, "/v1/jobs").unwrap().body("{}");
    problem(plain, 415, "unsupported-media-type").await;
    let broken = client.request(Method::POST, "/v1/jobs").unwrap().body("{");
    problem(broken.header(header::CONTENT_TYPE, "application/json"), 400, "malformed-json").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_with_an_invalid_field_is_refused_with_a_pointer() {
    let server = testing::spawn().await.unwrap();
    let capture = server.client().upload_capture_bytes(capture_zip()).await.unwrap().id;
    let cases = [
        (json!({}), "/capture"),
        (json!({ "capture": "nobody" }), "/capture"),
        (json!({ "capture": capture, "colour": 1 }), "/colour"),
        (json!({ "capture": capture, "preset": "best" }), "/preset"),
        (json!({ "capture": capture, "overrides": { "speed": 11 } }), "/overrides/speed"),
        (json!({ "capture": capture, "overrides": { "seed": -1 } }), "/overrides/seed"),
        (
            json!({ "capture": capture, "overrides": { "initial_gaussians": 100_000_000 } }),
            "/overrides/initial_gaussians",
        ),
        (
            json!({ "capture": capture, "device": "cpu", "overrides": { "max_gaussians": 4_000_000 } }),
            "/overrides/max_gaussians",
        ),
        (
            json!({ "capture": capture, "overrides": { "light": { "environment": "nowhere" } } }),
            "/overrides/light/environment",
        ),
        (
            json!({ "capture": capture, "overrides": { "light": { "rotation_deg": 3 } } }),
            "/overrides/light/environment",
        ),
        (
            json!({ "capture": capture, "overrides": { "light": { "environment": "studio", "exposure_ev": 40 } } }),
            "/overrides/light/exposure_ev",
        ),
        (
            json!({ "capture": capture, "overrides": { "weights": { "smoothness": -1 } } }),
            "/overrides/weights/smoothness",
        ),
        (json!({ "capture": capture, "overrides": { "time_budget_s": 29 } }), "/overrides/time_budget_s"),
        (
            json!({ "capture": capture, "overrides": { "time_budget_s": 60, "iterations": 9 } }),
            "/overrides/iterations",
        ),
        (json!({ "capture": capture, "overrides": { "until": "psnr>=30" } }), "/overrides/until"),
        (json!({ "capture": capture, "priority": 101 }), "/priority"),
        (json!({ "capture": capture, "device": "gpu" }), "/device"),
    ];
    for (body, pointer) in cases {
        let answer = problem(post_json(server.client(), "/v1/jobs", &body), 422, "invalid-field").await;
        assert_eq!(answer["errors"][0]["pointer"], pointer, "{answer}");
    }
    assert!(server.client().jobs().await.unwrap().items.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_content_uploaded_twice_is_one_capture() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let send = |zip: Vec<u8>| {
        let part = reqwest::multipart::Part::bytes(zip).file_name("scan.zip");
        let form = reqwest::multipart::Form::new().part("archive", part);
        client.request(Method::POST, "/v1/captures").unwrap().multipart(form).send()
    };
    let first = send(capture_zip()).await.unwrap();
    assert_eq!(first.status(), StatusCode::CREATED);
    let location = first.headers()[header::LOCATION].to_str().unwrap().to_owned();
    let second = client.request(Method::POST, "/v1/captures").unwrap();
    let second =
        second.header(header::CONTENT_TYPE, "application/zip").body(capture_zip()).send().await.unwrap();
    assert_eq!(second.status(), StatusCode::OK);
    let again: Value = serde_json::from_str(&second.text().await.unwrap()).unwrap();
    assert_eq!(location, format!("/v1/captures/{}", again["id"].as_str().unwrap()));
    assert_eq!(client.captures().await.unwrap().items.len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn validating_a_capture_stores_nothing() {
    let server = testing::spawn().await.unwrap();
    let report = server.client().validate_capture_bytes(capture_zip()).await.unwrap();
    assert_eq!(report.train_images + report.test_images, 8);
    assert!(server.client().captures().await.unwrap().items.is_empty());
    assert!(crate::service_support::files_under(server.data_dir()).is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_repeated_idempotency_key_returns_the_same_response() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let submit = |iterations: u32| {
        let job = small_job(&capture, iterations, 5);
        client.request(Method::POST, "/v1/jobs").unwrap().header("idempotency-key", "abc").json(&job)
    };
    let first = submit(10).send().await.unwrap();
    assert_eq!(first.status(), StatusCode::ACCEPTED);
    assert!(!first.headers().contains_key("idempotent-replayed"));
    let first = first.text().await.unwrap();
    let again = submit(10).send().await.unwrap();
    assert_eq!(again.headers()["idempotent-replayed"], "true");
    assert_eq!(again.text().await.unwrap(), first);
    problem(submit(11), 422, "idempotency-key-reused").await;
    assert_eq!(client.jobs().await.unwrap().items.len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn retrying_a_cancelled_job_creates_a_new_job() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let long = client.create_job(&small_job(&capture, 100_000, 1000), None).await.unwrap();
    let waiting = client.create_job(&small_job(&capture, 3, 5), None).await.unwrap();
    let retry = |id: &JobId| client.request(Method::POST, &format!("/v1/jobs/{id}/retry")).unwrap();
    problem(retry(&waiting.id), 409, "job-not-retryable").await;
    assert_eq!(client.cancel_job(&waiting.id).await.unwrap().state, JobState::Cancelled);
    client.cancel_job(&long.id).await.unwrap();
    let again = client.retry_job(&waiting.id).await.unwrap();
    assert_eq!((again.retry_of.as_ref(), again.state), (Some(&waiting.id), JobState::Queued));
    assert_eq!(ended(client, &again.id).await.state, JobState::Succeeded);
    assert_eq!(client.job(&waiting.id).await.unwrap().state, JobState::Cancelled, "the old one stays");
    let cancel = client.request(Method::POST, &format!("/v1/jobs/{}/cancel", again.id)).unwrap();
    problem(cancel, 409, "job-finished").await;
    let patch = client.request(Method::PATCH, &format!("/v1/jobs/{}", again.id)).unwrap();
    problem(patch.json(&json!({ "priority": 1 })), 409, "job-not-queued").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn event_stream_resumes_without_gaps_or_duplicates() {
    let server = testing::spawn().await.unwrap();
    let job = trained(server.client()).await;
    let listen = async |after: Option<&str>| -> Vec<i64> {
        let request = server.client().request(Method::GET, &format!("/v1/jobs/{}/events", job.id)).unwrap();
        let request = match after {
            Some(after) => request.header("last-event-id", after),
            None => request,
        };
        let text = request.send().await.unwrap().text().await.unwrap();
        text.lines().filter_map(|l| l.strip_prefix("id: ")).map(|id| id.parse().unwrap()).collect()
    };
    let all = listen(None).await;
    assert!(all.len() >= 4 && all.windows(2).all(|p| p[0] < p[1]), "{all:?}");
    for cut in 0..=all.len() {
        let after = if cut == 0 { "0".to_owned() } else { all[cut - 1].to_string() };
        assert_eq!(listen(Some(&after)).await, all[cut..], "after {after}");
    }
    let request = server.client().request(Method::GET, &format!("/v1/jobs/{}/events", job.id)).unwrap();
    problem(request.header("last-event-id", "x"), 422, "invalid-field").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_support_ranges_and_etags_and_match_their_digest() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let id = trained(client).await.model.unwrap();
    let model = client.model(&id).await.unwrap();
    let file = model.files.iter().find(|f| f.name == "model.safetensors").unwrap();
    let whole = client.file(&id, "model.safetensors").await.unwrap();
    let digest = <sha2::Sha256 as sha2::Digest>::digest(&whole);
    assert_eq!(relume::store::hex(&digest), file.sha256);
    let get = || client.request(Method::GET, &file.href).unwrap();
    let part = get().header(header::RANGE, "bytes=4-9").send().await.unwrap();
    assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
    assert_eq!(part.headers()[header::CONTENT_RANGE], format!("bytes 4-9/{}", whole.len()));
    let etag = part.headers()[header::ETAG].to_str().unwrap().to_owned();
    assert_eq!(etag, format!("\"{}\"", file.sha256));
    assert_eq!(part.bytes().await.unwrap(), whole.slice(4..10));
    let stale =
        get().header(header::RANGE, "bytes=4-9").header(header::IF_RANGE, "\"old\"").send().await.unwrap();
    assert_eq!(stale.status(), StatusCode::OK);
    let beyond = get().header(header::RANGE, format!("bytes={}-", whole.len()));
    problem(beyond, 416, "range-not-satisfiable").await;
    let known = get().header(header::IF_NONE_MATCH, etag).send().await.unwrap();
    assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
    let head = client.request(Method::HEAD, &file.href).unwrap().send().await.unwrap();
    assert_eq!(head.headers()[header::CONTENT_LENGTH], whole.len().to_string());
}

#[tokio::test(flavor = "multi_thread")]
async fn thumbnail_etags_are_stable_and_differ_between_images() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let id = trained(client).await.model.unwrap();
    let get =
        |query: &str| client.request(Method::GET, &format!("/v1/models/{id}/thumbnail?{query}")).unwrap();
    let tag = async |query: &str| {
        let response = get(query).send().await.unwrap();
        assert_eq!(response.status(), StatusCode::OK, "{query}");
        response.headers()[header::ETAG].to_str().unwrap().to_owned()
    };
    let base = tag("size=32&env=studio").await;
    assert_eq!(tag("env=studio&size=32").await, base, "the order of the query does not matter");
    let others = [
        "size=33&env=studio",
        "size=32&env=sunset",
        "size=32&env=studio&azimuth=1",
        "size=32&env=studio&format=jpeg",
    ];
    for other in others {
        assert_ne!(tag(other).await, base, "{other}");
    }
    let known = get("size=32&env=studio").header(header::IF_NONE_MATCH, &base).send().await.unwrap();
    assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
    for (query, name) in [
        ("size=9999", "size"),
        ("azimuth=NaN", "azimuth"),
        ("elevation=91", "elevation"),
        ("env=mars", "env"),
        ("format=exr", "format"),
        ("tier=reference", "tier"),
    ] {
        let body = problem(get(query), 422, "invalid-field").await;
        assert_eq!(body["errors"][0]["pointer"], format!("query/{name}"), "{body}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_render_request_is_refused_with_a_pointer() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let id = trained(client).await.model.unwrap();
    let path = format!("/v1/models/{id}/render");
    let look = json!({ "look_at": { "eye": [3, 0, 1], "target": [0, 0, 0], "fov_y_deg": 40 } });
    let good = json!({ "camera": look, "width": 8, "height": 8, "environment": { "builtin": "studio" } });
    let with = |pointer: &str, value: Value| {
        let mut body = good.clone();
        let (parent, field) = pointer.rsplit_once('/').unwrap();
        body.pointer_mut(parent).unwrap().as_object_mut().unwrap().insert(field.to_owned(), value);
        body
    };
    let ok = post_json(client, &path, &good).send().await.unwrap();
    assert_eq!(
        (ok.status(), &ok.headers()[header::CONTENT_TYPE]),
        (StatusCode::OK, &"image/png".parse().unwrap())
    );
    let reference = |side: u32, samples: u32| json!({ "camera": look, "width": side, "height": side, "tier": "reference", "samples": samples });
    for body in [reference(8, 4), with("/tier", json!("high"))] {
        assert_eq!(post_json(client, &path, &body).send().await.unwrap().status(), StatusCode::OK, "{body}");
    }
    let identity = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]);
    let singular = json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]);
    let cases = [
        (with("/width", json!(0)), "/width"),
        (with("/height", json!(5000)), "/height"),
        (with("/width", json!("wide")), "/width"),
        (with("/colour", json!(1)), "/colour"),
        (with("/camera/roll", json!(1)), "/camera/roll"),
        (with("/camera/look_at/fov_y_deg", json!(180)), "/camera/look_at/fov_y_deg"),
        (with("/camera/look_at/target", json!([3, 0, 1])), "/camera/look_at/target"),
        (with("/camera/look_at/eye", json!([3, 0])), "/camera/look_at/eye"),
        (with("/camera", json!({})), "/camera"),
        (with("/camera", json!({ "camera_to_world": identity })), "/camera"),
        (with("/camera", json!({ "camera_to_world": singular, "fov_y_deg": 40 })), "/camera/camera_to_world"),
        (with("/camera", json!({ "camera_to_world": identity, "fov_y_deg": 0 })), "/camera/fov_y_deg"),
        (
            with(
                "/camera",
                json!({ "camera_to_world": identity, "intrinsics": { "fx": -1, "fy": 1, "cx": 1, "cy": 1 } }),
            ),
            "/camera/intrinsics/fx",
        ),
        (with("/environment/builtin", json!("mars")), "/environment/builtin"),
        (with("/environment/id", json!("x")), "/environment"),
        (with("/environment", json!({ "id": "nobody" })), "/environment/id"),
        (with("/environment", json!({ "inline_base64": "%" })), "/environment/inline_base64"),
        (with("/environment/exposure_ev", json!(99)), "/environment/exposure_ev"),
        (with("/outputs", json!([])), "/outputs"),
        (with("/outputs", json!(["rgb", "normal"])), "/outputs"),
        (with("/outputs", json!(["colour"])), "/outputs/0"),
        (with("/tier", json!("best")), "/tier"),
        (with("/samples", json!(0)), "/samples"),
        (with("/samples", json!(70_000)), "/samples"),
        (with("/seed", json!(-1)), "/seed"),
        // The maximum is 2^21 queries: 512 samples at 64 x 64 pixels.
        (reference(64, 513), "/samples"),
        (reference(2048, 1), "/samples"),
    ];
    for (body, pointer) in cases {
        let answer = problem(post_json(client, &path, &body), 422, "invalid-field").await;
        assert_eq!(answer["errors"][0]["pointer"], pointer, "{body}\n{answer}");
    }
    let odd = post_json(client, &path, &good).header(header::ACCEPT, "text/html");
    problem(odd, 406, "not-acceptable").await;
    let twice = post_json(client, &path, &with("/outputs", json!(["albedo", "depth", "albedo"])));
    let answer = problem(twice.header(header::ACCEPT, "image/x-exr"), 422, "invalid-field").await;
    assert_eq!(answer["errors"][0]["pointer"], "/outputs/2", "{answer}");
}

#[tokio::test(flavor = "multi_thread")]
async fn with_api_keys_requests_without_a_valid_key_answer_401() {
    let keys =
        |config: &mut relume::server::ServerConfig| config.api_keys = ApiKeys::new(["one-long-api-key"]);
    let server = testing::spawn_with(tempfile::tempdir().unwrap(), keys).await.unwrap();
    let get = |path: &str| server.client().request(Method::GET, path).unwrap();
    problem(get("/v1/jobs"), 401, "unauthorized").await;
    problem(get("/v1/jobs").bearer_auth("another-api-key"), 401, "unauthorized").await;
    problem(get("/metrics"), 401, "unauthorized").await;
    assert_eq!(
        get("/v1/jobs").bearer_auth("one-long-api-key").send().await.unwrap().status(),
        StatusCode::OK
    );
    for open in ["/healthz", "/readyz", "/v1/openapi.json"] {
        assert_eq!(get(open).send().await.unwrap().status(), StatusCode::OK, "{open}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_count_requests_by_route_not_by_path() {
    let server = testing::spawn().await.unwrap();
    let get = async |path: &str| {
        server.client().request(Method::GET, path).unwrap().send().await.unwrap().text().await.unwrap()
    };
    for i in 0..3 {
        get(&format!("/v1/jobs/secret-{i}")).await;
        get(&format!("/secret-{i}")).await;
    }
    let text = get("/metrics").await;
    assert!(text.contains("route=\"/v1/jobs/{id}\""), "{text}");
    assert!(text.contains("route=\"unmatched\"") && !text.contains("secret"));
    assert!(text.contains("relume_jobs{state=\"queued\"} 0"), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn environments_are_deduplicated_and_repaired_with_a_warning() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let mut texels = vec![[1.0f32; 3]; 8];
    let good = relume_capture::formats::exr_image::encode_rgb(4, 2, &texels).unwrap();
    let first = client.upload_environment(good.clone()).await.unwrap();
    assert_eq!((first.width, first.height, first.warnings.len()), (4, 2, 0));
    assert_eq!(client.upload_environment(good).await.unwrap().id, first.id);
    texels[3] = [-1.0, 0.5, 0.5];
    let negative = relume_capture::formats::exr_image::encode_rgb(4, 2, &texels).unwrap();
    assert_eq!(client.upload_environment(negative).await.unwrap().warnings.len(), 1);
    let list = client.environments().await.unwrap();
    assert!(list.builtin.contains(&"studio".to_owned()) && list.uploaded.items.len() == 2);
    let id = trained(client).await.model.unwrap();
    client.thumbnail(&id, &format!("env={}&size=16", first.id)).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_trains_with_the_given_light() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let map = EnvMap::from_fn(32, 16, |d| [0.2 + 0.5 * (1.0 + d.x as f32), 0.4, 0.1]);
    let file = relume_capture::formats::exr_image::encode_rgb(32, 16, map.texels()).unwrap();
    let uploaded = client.upload_environment(file).await.unwrap().id;
    let light = |environment: String| KnownLight {
        environment,
        rotation_deg: 90.0,
        exposure_ev: LightExposure::Stops(1.0),
    };
    for light in [None, Some(light(uploaded.to_string())), Some(light("studio".into()))] {
        let mut job = small_job(&capture, 40, 20);
        job.overrides.light = light.clone();
        let job = client.create_job(&job, None).await.unwrap();
        let job = ended(client, &job.id).await;
        assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
        let file = client.file(&job.model.unwrap(), "model.safetensors").await.unwrap();
        let found = model_file::decode(&file).unwrap().environment(0);
        let told = match light.as_ref().map(|l| l.environment.as_str()) {
            Some("studio") => builtin("studio").unwrap(),
            _ => map.clone(),
        };
        let told = told.rotated_and_scaled(90.0, 2.0).resampled(32, 16);
        let apart = found.texels().iter().flatten().zip(told.texels().iter().flatten());
        let error = worst(apart.map(|(a, b)| (a - b).abs() / (b + 0.01)));
        assert!(error.is_finite(), "{light:?}");
        assert_eq!(error < 1e-3, light.is_some(), "{light:?}: {error}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_utf8_paths_answer_400_and_upload_errors_name_archive() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let answer = client.request(Method::GET, "/v1/jobs/%F1%83").unwrap().send().await.unwrap();
    assert_eq!(answer.status(), 400);
    assert_eq!(answer.headers()["content-type"], "application/problem+json");
    let request = client.request(Method::POST, "/v1/captures").unwrap();
    let request = request.header("content-type", "application/zip").body("no archive at all");
    let problem: Value = serde_json::from_str(&request.send().await.unwrap().text().await.unwrap()).unwrap();
    assert!(problem["detail"].as_str().unwrap().starts_with("archive: "), "{problem}");
    assert_eq!(problem["content"]["file"], "archive");
}
