//! Figures of a job's model on held-out views, and quality gates.

use std::sync::Arc;
use std::time::Duration;

use futures::TryStreamExt;
use relume::testing;
use relume_api::JobId;
use relume_api::jobs::{JobState, NewJob};
use relume_api::quality::{Figures, QualityGate};
use relume_capture::ImportOptions;
use relume_capture::formats::model_file;
use relume_client::{Client, JobEvent};
use relume_engine::Device;
use relume_spec::rendering::Tier;
use relume_train::eval::{EvalOptions, Report, evaluate};
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::server_process::Server;
use crate::service_support::{CaptureZip, capture_zip, ended, raw_pool, small_job};

fn asking(mut job: NewJob, gate: &[(&str, &str)]) -> NewJob {
    let entry = |(name, wanted): &(&str, &str)| ((*name).to_owned(), (*wanted).to_owned());
    job.quality_gate = QualityGate(gate.iter().map(entry).collect());
    job
}

/// The last event of a job that has ended.
async fn last_event(client: &Client, job: &JobId) -> JobEvent {
    let mut last = None;
    client.wait(job, |event| last = Some(event.clone())).await.unwrap();
    last.unwrap()
}

/// The report of `relume eval` for a model on the capture in `archive`, at 32 pixels.
fn evaluated(model: &[u8], archive: &[u8], tier: Tier) -> Report {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), archive).unwrap();
    let options = ImportOptions { max_side: Some(32), ..ImportOptions::default() };
    let capture = relume_capture::import(file.path(), &options).unwrap();
    let options = EvalOptions {
        quality: tier.into(),
        frame_rate_time: Duration::ZERO,
        device: &Device::Cpu,
        ..EvalOptions::default()
    };
    evaluate(Arc::new(model_file::decode(model).unwrap()), &capture, &options).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_reports_metrics_on_held_out_views() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    // The photographs have twice the size of the training, and one is missing.
    let mut zip = CaptureZip::new(17, 64);
    zip.images.remove(5);
    let archive = zip.zip();
    let capture = client.upload_capture_bytes(archive.clone()).await.unwrap();
    let mut job = small_job(&capture.id, 30, 10);
    job.device = relume_api::jobs::JobDevice::Cpu;
    let job = client.create_job(&job, None).await.unwrap();
    assert_eq!(job.figures, None, "nothing is known yet");
    let event = last_event(client, &job.id).await;
    let job = client.job(&job.id).await.unwrap();
    assert_eq!((job.state, job.missed.len()), (JobState::Succeeded, 0));

    let figures = job.figures.unwrap();
    assert_eq!((figures.views, figures.held_out_views), (2, 2), "every eighth of sixteen");
    let model = job.model.unwrap();
    let report =
        evaluated(&client.file(&model, "model.safetensors").await.unwrap(), &archive, Tier::Standard);
    assert!(figures.foreground_pixels > 0 && figures.foreground_pixels == report.foreground_pixels);
    let close = |a: Option<f64>, b: Option<f64>| (a.unwrap() - b.unwrap()).abs() < 1e-9;
    assert!(close(figures.novel_view.psnr, report.novel_view.psnr), "{figures:?}\n{report:?}");
    assert!(close(figures.novel_view.ssim, report.novel_view.ssim));
    assert!(close(figures.novel_view_radiance.psnr, report.novel_view_radiance.psnr));
    assert!(close(figures.novel_view_matched.psnr, report.novel_view_matched.psnr));
    assert!(!close(figures.novel_view.psnr, report.novel_view_radiance.psnr), "the control");
    assert!(figures.warnings.iter().any(|w| w.contains("train/r_5")), "{:?}", figures.warnings);

    let of = |value: &Value| serde_json::from_value::<Figures>(value.clone()).unwrap();
    assert_eq!(of(&event.data["figures"]), figures, "the last event says the same");
    assert_eq!(of(&client.model(&model).await.unwrap().card["figures"]), figures, "and the card");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_misses_its_gate_is_rejected_and_keeps_its_model() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = |gate| asking(small_job(&capture.id, 10, 5), gate);
    let lenient = [("novel_view.psnr", ">=1"), ("novel_view.ssim", "<=1")];
    let met = client.create_job(&job(&lenient), None).await.unwrap();
    let met = ended(client, &met.id).await;
    assert_eq!((met.state, met.missed.len()), (JobState::Succeeded, 0), "{:?}", met.figures);

    let strict = [("novel_view.psnr", ">=98.5"), ("novel_view.ssim", "<=1")];
    let id = client.create_job(&job(&strict), None).await.unwrap().id;
    let event = last_event(client, &id).await;
    let rejected = client.job(&id).await.unwrap();
    assert_eq!((rejected.state, rejected.error.is_some()), (JobState::Rejected, false));
    let [missed] = &rejected.missed[..] else { panic!("{:?}", rejected.missed) };
    let found = rejected.figures.unwrap().novel_view.psnr.unwrap();
    assert_eq!((missed.figure.as_str(), missed.wanted.as_str()), ("novel_view.psnr", ">=98.5"));
    assert_eq!((missed.found, missed.missed_by), (Some(found), Some(98.5 - found)));
    assert_eq!(
        (&event.data["state"], event.data["missed"][0]["found"].as_f64()),
        (&json!("rejected"), Some(found))
    );
    let model = rejected.model.unwrap();
    assert_eq!(client.model(&model).await.unwrap().summary.job, id);
    client.thumbnail(&model, "size=16").await.unwrap();

    // A rejected job is final, like a succeeded one.
    for refused in [client.cancel_job(&id).await, client.retry_job(&id).await] {
        assert_eq!(refused.unwrap_err().problem().unwrap().status, 409);
    }
    let listed = client.request(Method::GET, "/v1/jobs?state=rejected").unwrap().send().await.unwrap();
    let listed: Value = listed.json().await.unwrap();
    assert_eq!((listed["items"].as_array().unwrap().len(), &listed["items"][0]["id"]), (1, &json!(id)));
    client.delete_capture(&capture.id, false).await.unwrap();
    let pool = raw_pool(server.data_dir()).await;
    let changed =
        sqlx::query("UPDATE jobs SET state = 'succeeded' WHERE state = 'rejected'").execute(&pool).await;
    assert!(changed.unwrap_err().to_string().contains("terminal"));
    pool.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gate_on_an_unknown_metric_is_refused_with_a_pointer() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let post = async |gate: Value, overrides: Value| {
        let body = json!({ "capture": capture.id, "quality_gate": gate, "overrides": overrides });
        let answer = client.request(Method::POST, "/v1/jobs").unwrap().json(&body).send().await.unwrap();
        let status = answer.status().as_u16();
        let problem: Value = answer.json().await.unwrap();
        (status, problem["errors"][0]["pointer"].as_str().unwrap_or_default().to_owned())
    };
    for (gate, pointer) in [
        (json!({ "novel_view.pnsr": ">=28" }), "/quality_gate/novel_view.pnsr"),
        (json!({ "novel_view.psnr": "28" }), "/quality_gate/novel_view.psnr"),
        (json!({ "novel_view.psnr": ">=inf" }), "/quality_gate/novel_view.psnr"),
        (json!({ "novel_view.psnr": 28 }), "/quality_gate/novel_view.psnr"),
        (json!([">=28"]), "/quality_gate"),
    ] {
        assert_eq!(post(gate.clone(), json!({})).await, (422, pointer.to_owned()), "{gate}");
    }
    let colour_alone = post(json!({ "novel_view.psnr": ">=28" }), json!({ "warm_up": 1.0 })).await;
    assert_eq!(colour_alone, (422, "/quality_gate/novel_view.psnr".to_owned()));
    assert!(client.jobs().await.unwrap().items.is_empty());
    let tiny = json!({ "iterations": 1, "resolution": 16, "max_gaussians": 16 });
    assert_eq!(post(json!({ "novel_view.psnr": ">=28" }), tiny).await.0, 202, "the control");
}

/// A job whose model takes a while to compare; returns when the comparison begins.
async fn while_comparing(client: &Client) -> JobId {
    let capture = client.upload_capture_bytes(CaptureZip::new(64, 256).zip()).await.unwrap();
    let mut job = asking(small_job(&capture.id, 10, 5), &[("novel_view.psnr", ">=98")]);
    job.overrides.resolution = Some(256);
    let id = client.create_job(&job, None).await.unwrap().id;
    let mut events = std::pin::pin!(client.events(&id, 0).await.unwrap());
    while let Some(event) = events.try_next().await.unwrap() {
        if event.data["message"] == "comparing held-out view 1 of 8" {
            return id;
        }
    }
    panic!("the job ended and nothing was compared");
}

/// The number of final events of a job, and the steps of its checkpoints.
async fn told(client: &Client, job: &JobId) -> (usize, Vec<i64>) {
    let (mut ends, mut checkpoints) = (0, Vec::new());
    let heard = |event: &JobEvent| match event.kind.as_str() {
        "state" if event.data["model"].is_string() => ends += 1,
        "checkpoint" => checkpoints.extend(event.data["step"].as_i64()),
        _ => {}
    };
    client.wait(job, heard).await.unwrap();
    (ends, checkpoints)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_killed_during_evaluation_resumes_and_ends_once() {
    let data = TempDir::new().unwrap();
    let server = Server::start(data.path());
    let id = while_comparing(&server.client).await;
    server.kill();
    let server = Server::start(data.path());
    let job = ended(&server.client, &id).await;
    assert_eq!((job.state, job.attempts, job.missed.len()), (JobState::Rejected, 2, 1));
    assert_eq!(told(&server.client, &id).await, (1, vec![5]), "from step 5 to the end");
    assert_eq!(server.client.models().await.unwrap().items.len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_during_evaluation_repeats_no_training_step() {
    let server = testing::spawn().await.unwrap();
    let id = while_comparing(server.client()).await;
    let server = testing::spawn_with(server.stop().await.unwrap(), |_| {}).await.unwrap();
    let job = ended(server.client(), &id).await;
    assert_eq!((job.state, job.attempts), (JobState::Rejected, 2));
    assert_eq!(told(server.client(), &id).await, (1, vec![5, 10]), "a checkpoint of the whole training");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_can_be_cancelled_during_evaluation() {
    let server = testing::spawn().await.unwrap();
    let id = while_comparing(server.client()).await;
    assert_eq!(server.client().cancel_job(&id).await.unwrap().state, JobState::Cancelling);
    assert_eq!(ended(server.client(), &id).await.state, JobState::Cancelled);
    assert!(server.client().models().await.unwrap().items.is_empty());
}
