//! The service through its API: upload, train, query, download, render.

use relume::server::ServerConfig;
use relume::testing;
use relume_api::CaptureId;
use relume_api::cameras::{CameraSpec, LookAtSpec};
use relume_api::jobs::{JobState, NewJob};
use relume_api::renders::RenderRequest;
use relume_capture::formats::image_file;
use relume_engine::{Device, DeviceChoice};
use relume_spec::rendering::{Background, ColourDepth, FrameFormat, Output, ToneCurve};

use crate::service_support::{capture_zip, ended, small_job, trained, until};

pub fn look_at() -> CameraSpec {
    let look = LookAtSpec { eye: [3.0, 0.0, 1.0], target: [0.0; 3], up: [0.0, 0.0, 1.0], fov_y_deg: 40.0 };
    CameraSpec { look_at: Some(look), ..CameraSpec::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_capture_becomes_a_model_that_renders_over_http() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    assert_eq!(capture.report.layout, "nerf-synthetic");
    let job = client.create_job(&small_job(&capture.id, 10, 5), None).await.unwrap();
    let mut kinds = Vec::new();
    let job = client.wait(&job.id, |event| kinds.push(event.kind.clone())).await.unwrap();
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    assert_eq!(job.progress.step, 10);
    assert!(
        ["state", "progress", "checkpoint"].iter().all(|k| kinds.iter().any(|seen| seen == k)),
        "{kinds:?}"
    );

    let model = client.model(&job.model.unwrap()).await.unwrap();
    let names: Vec<_> = model.files.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["model.ply", "model.safetensors"]);
    let request = RenderRequest { camera: look_at(), width: 24, height: 16, ..RenderRequest::default() };
    let request = RenderRequest { outputs: vec![Output::Rgb], ..request };
    let png = client.render(&model.summary.id, &request, FrameFormat::Png).await.unwrap();
    assert_eq!(image_file::dimensions(&png).unwrap(), (24, 16));
    let jpeg = client.render(&model.summary.id, &request, FrameFormat::Jpeg).await.unwrap();
    assert_eq!(image_file::dimensions(&jpeg).unwrap(), (24, 16));
    let outputs = vec![Output::Rgb, Output::Normal, Output::Depth, Output::Visibility];
    let request = RenderRequest { outputs, ..request };
    let exr = client.render(&model.summary.id, &request, FrameFormat::Exr).await.unwrap();
    assert_eq!(image_file::dimensions(&exr).unwrap(), (24, 16));
    let thumbnail = client.thumbnail(&model.summary.id, "env=studio&size=32").await.unwrap();
    assert_eq!(image_file::dimensions(&thumbnail).unwrap(), (32, 32));
    server.stop().await.unwrap();
}

/// The wait according to `Server-Timing`: number of training steps that ended in it.
fn steps_waited(response: &reqwest::Response) -> u64 {
    let timing = response.headers()["server-timing"].to_str().unwrap();
    let steps = timing.split("desc=\"").nth(1).unwrap().split(' ').next().unwrap();
    steps.parse().unwrap()
}

/// Renders thumbnails while `job` trains, and returns the wait of each.
async fn steps_waited_during(
    server: &testing::TestServer,
    job: impl FnOnce(&CaptureId) -> NewJob,
) -> Vec<u64> {
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let url =
        |azimuth: u32| format!("{}v1/models/{model}/thumbnail?size=64&azimuth={azimuth}", client.base());
    // The first thumbnail prepares the light.
    reqwest::get(url(1)).await.unwrap().error_for_status().unwrap();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&job(&capture.id), None).await.unwrap();
    let begin = until(client, &job.id, |job| job.progress.step > 2).await.progress.step;
    let mut waited = Vec::new();
    for azimuth in 0..12 {
        let response = reqwest::get(url(azimuth * 30)).await.unwrap();
        waited.push(steps_waited(&response.error_for_status().unwrap()));
    }
    until(client, &job.id, |job| job.progress.step > begin).await;
    client.cancel_job(&job.id).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Cancelled);
    waited
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_gpu_thumbnails_do_not_wait_for_training_steps() {
    let folder = tempfile::TempDir::new().unwrap();
    let on_cpu = |config: &mut ServerConfig| config.worker.device = DeviceChoice::Cpu;
    let server = testing::spawn_with(folder, on_cpu).await.unwrap();
    // Steps that take longer than a thumbnail: if frames were rendered between steps, each would wait for the
    // end of a step.
    let long_steps = |capture: &CaptureId| {
        let mut job = small_job(capture, 100_000, 50_000);
        job.overrides.initial_gaussians = Some(60_000);
        job.overrides.max_gaussians = Some(60_000);
        job
    };
    let waited = steps_waited_during(&server, long_steps).await;
    assert!(waited.contains(&0), "{waited:?}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
async fn on_a_gpu_thumbnails_wait_for_at_most_one_training_step() {
    let Device::Gpu(gpu) = relume_reference::gpu_device() else { panic!("the device is a GPU") };
    let index = gpu.report().index;
    let folder = tempfile::TempDir::new().unwrap();
    let on_gpu = |config: &mut ServerConfig| config.worker.device = DeviceChoice::Gpu(Some(index));
    let server = testing::spawn_with(folder, on_gpu).await.unwrap();
    let mut waited = steps_waited_during(&server, |capture| small_job(capture, 100_000, 50_000)).await;
    waited.sort_unstable();
    // Occasionally the operating system lets a thread wait for a few steps.
    assert!(waited[waited.len() / 2] <= 1, "{waited:?}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_missing_gpu_refuses_gpu_jobs_and_stops_startup() {
    let folder = tempfile::TempDir::new().unwrap();
    let server = testing::spawn_with(folder, |c| c.worker.device = DeviceChoice::Cpu).await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let mut job = small_job(&capture.id, 10, 5);
    job.device = relume_api::jobs::JobDevice::Gpu;
    let refusal = client.create_job(&job, None).await.unwrap_err().to_string();
    assert!(refusal.contains("/device") || refusal.contains("no GPU"), "{refusal}");
    server.stop().await.unwrap();
    let folder = tempfile::TempDir::new().unwrap();
    let missing =
        testing::spawn_with(folder, |c| c.worker.device = DeviceChoice::Gpu(Some(99))).await.unwrap();
    let Err(error) = missing.stop().await else { panic!("it started") };
    assert!(error.to_string().contains("gpu:99"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn background_tone_curve_and_colour_depth_are_applied() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let asked = RenderRequest {
        camera: look_at(),
        width: 24,
        height: 16,
        outputs: vec![Output::Rgb],
        ..RenderRequest::default()
    };
    let render = |change: fn(&mut RenderRequest), format| {
        let mut request = asked.clone();
        change(&mut request);
        let (client, model) = (client.clone(), model.clone());
        async move { client.render(&model, &request, format).await }
    };
    let alpha = |png: &[u8]| {
        let image = image_file::decode(png, 1 << 20).unwrap();
        image.pixels.iter().map(|p| p[3]).fold(1.0, f32::min)
    };
    let plain = render(|_| {}, FrameFormat::Png).await.unwrap();
    assert!(alpha(&plain) < 0.5, "the control: around the model there is nothing");
    let lit = render(|r| r.background = Background::Environment, FrameFormat::Png).await.unwrap();
    let coloured =
        render(|r| r.background = Background::Colour([10, 20, 30]), FrameFormat::Png).await.unwrap();
    assert!(alpha(&lit) == 1.0 && alpha(&coloured) == 1.0 && lit != coloured);
    assert_ne!(render(|r| r.tone_curve = ToneCurve::Agx, FrameFormat::Png).await.unwrap(), plain);
    let exr = render(|r| r.colour_depth = Some(ColourDepth::Half), FrameFormat::Exr).await.unwrap();
    let text = String::from_utf8_lossy(&exr);
    for said in [
        "worldToCamera",
        model.as_str(),
        "relume:light",
        "recovered",
        "fx ",
        "screenWindowWidth",
        "relume:background",
    ] {
        assert!(text.contains(said), "{said}");
    }
    let refused = render(|r| r.tone_curve = ToneCurve::Agx, FrameFormat::Exr).await.unwrap_err();
    let problem = refused.problem().unwrap();
    assert_eq!((problem.status, problem.errors[0].pointer.as_str()), (422, "/tone_curve"));
    let mut wrong = serde_json::to_value(&asked).unwrap();
    wrong["background"] = "white".into();
    let path = format!("/v1/models/{model}/render");
    let answer = client.request(reqwest::Method::POST, &path).unwrap().json(&wrong).send().await.unwrap();
    assert_eq!(answer.status(), 422);
    let text = answer.text().await.unwrap();
    assert!(text.contains("/background") && text.contains("#f4f4f4"), "{text}");
    let thumbnail = |query: &str| {
        let path = format!("/v1/models/{model}/thumbnail?size=16{query}");
        let request = client.request(reqwest::Method::GET, &path).unwrap();
        async move {
            let answer = request.send().await.unwrap();
            let tag = answer.headers().get("etag").map(|v| v.to_str().unwrap().to_owned());
            (answer.status().as_u16(), tag)
        }
    };
    let (plain, white) = (thumbnail("").await, thumbnail("&background=ffffff&tone_curve=neutral").await);
    assert!(plain.0 == 200 && white.0 == 200 && plain.1 != white.1, "{plain:?} {white:?}");
    assert_eq!(thumbnail("&tone_curve=linear").await.0, 422);
}
