//! Previews of a running training.

use std::time::Duration;

use relume::testing::{self, TestServer};
use relume_api::JobId;
use relume_api::jobs::{JobState, JobView};
use relume_client::Client;
use reqwest::{Method, Response, StatusCode, header};
use serde_json::Value;

use crate::service_support::{capture_zip, ended, small_job, trained};

async fn ask(client: &Client, job: &JobId, query: &str, known: Option<&str>) -> Response {
    let request = client.request(Method::GET, &format!("/v1/jobs/{job}/preview{query}")).unwrap();
    let request = match known {
        Some(tag) => request.header(header::IF_NONE_MATCH, tag),
        None => request,
    };
    request.send().await.unwrap()
}

async fn problem(answer: Response) -> (u16, String, String) {
    let status = answer.status().as_u16();
    let body: Value = answer.json().await.unwrap();
    let text = |name: &str| body[name].as_str().unwrap_or_default().to_owned();
    (status, text("type").replace("urn:relume:problem:", ""), text("detail"))
}

/// A job that trains until it is cancelled, and a queued job after it.
async fn busy(server: &TestServer) -> (JobView, JobView) {
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let first = client.create_job(&small_job(&capture.id, 1_000_000, 1_000_000), None).await.unwrap();
    let second = client.create_job(&small_job(&capture.id, 5, 5), None).await.unwrap();
    (first, second)
}

/// The first preview of a job with another step than `but`.
async fn picture(client: &Client, job: &JobId, but: Option<u32>) -> (u32, String, Vec<u8>) {
    loop {
        let answer = ask(client, job, "?size=32", None).await;
        if answer.status() == StatusCode::OK {
            let of = |name: &str| answer.headers()[name].to_str().unwrap().to_owned();
            let (step, tag): (u32, String) = (of("relume-step").parse().unwrap(), of("etag"));
            if Some(step) != but {
                return (step, tag, answer.bytes().await.unwrap().to_vec());
            }
        } else {
            let retry = answer.headers().contains_key(header::RETRY_AFTER);
            let (status, kind, _) = problem(answer).await;
            assert_eq!((status, &*kind, retry), (404, "no-preview", true));
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn previews_of_a_running_training_change_with_its_steps() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let (job, waiting) = busy(&server).await;
    let (step, tag, png) = picture(client, &job.id, None).await;
    let image = image::load_from_memory(&png).unwrap().into_rgba8();
    assert_eq!(image.dimensions(), (32, 32));
    assert!(image.pixels().any(|pixel| pixel.0[3] > 128), "something is seen");
    let (later, other, changed) = picture(client, &job.id, Some(step)).await;
    assert!(later > step && other != tag && changed != png, "{step} {later}");

    let seen = ask(client, &job.id, "?size=32", Some(&other)).await;
    if seen.headers()[header::ETAG] == *other {
        assert_eq!(seen.status(), StatusCode::NOT_MODIFIED);
    }
    assert_ne!(ask(client, &job.id, "?size=16", Some(&other)).await.status(), StatusCode::NOT_MODIFIED);

    let (status, kind, detail) = problem(ask(client, &waiting.id, "", None).await).await;
    assert_eq!((status, &*kind), (404, "no-preview"));
    assert!(detail.contains("queue"), "{detail}");
    client.cancel_job(&job.id).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Cancelled);
    let (status, kind, detail) = problem(ask(client, &job.id, "", None).await).await;
    assert_eq!((status, &*kind), (404, "no-preview"));
    assert!(detail.contains("ended"), "{detail}");
}

#[tokio::test(flavor = "multi_thread")]
async fn preview_of_a_finished_job_is_the_thumbnail_of_its_model() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let preview = client.job_preview(&job.id, 32).await.unwrap();
    let model = job.model.unwrap();
    assert_eq!(preview, client.thumbnail(&model, "size=32").await.unwrap());
    assert_ne!(preview, client.thumbnail(&model, "size=32&azimuth=90").await.unwrap());
    let turned = ask(client, &job.id, "?size=32&azimuth=90", None).await;
    assert_eq!(turned.bytes().await.unwrap(), client.thumbnail(&model, "size=32&azimuth=90").await.unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_preview_requests_are_refused() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let nobody = JobId::from("01890000-0000-7000-8000-000000000000");
    assert_eq!(problem(ask(client, &nobody, "", None).await).await.1, "not-found");
    for query in ["?size=15", "?size=1025", "?elevation=91", "?azimuth=NaN", "?colour=red"] {
        assert_eq!(
            ask(client, &nobody, query, None).await.status(),
            StatusCode::UNPROCESSABLE_ENTITY,
            "{query}"
        );
    }
}
