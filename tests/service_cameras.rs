//! The cameras of a capture, and frames for cameras in each convention.

use relume::testing;
use relume_api::cameras::{CameraConvention, CaptureCameras};
use relume_api::jobs::JobState;
use relume_spec::training::UpAxis;
use reqwest::{Method, StatusCode, header};
use serde_json::{Value, json};

use crate::service_support::{CaptureZip, ended, small_job, trained};

const CONVENTIONS: [CameraConvention; 3] =
    [CameraConvention::Opengl, CameraConvention::Opencv, CameraConvention::Colmap];

#[tokio::test(flavor = "multi_thread")]
async fn capture_cameras_give_the_same_frame_in_every_convention() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let sent = CaptureZip::new(8, 32).transforms;
    let mut frames = Vec::new();
    for convention in CONVENTIONS {
        let got: CaptureCameras = client.capture_cameras(&job.capture, convention).await.unwrap();
        assert_eq!((got.convention, got.cameras.len()), (convention, 8));
        let held_out: Vec<&str> =
            got.cameras.iter().filter(|c| c.held_out).map(|c| c.name.as_str()).collect();
        assert_eq!(held_out, ["train/r_0.png"]);
        if convention == CameraConvention::Opengl {
            for (camera, frame) in got.cameras.iter().zip(sent["frames"].as_array().unwrap()) {
                let rows = camera.camera.camera_to_world.unwrap();
                for (got, sent) in rows.iter().flatten().zip(numbers(&frame["transform_matrix"])) {
                    assert!((got - sent).abs() < 1e-9, "{}", camera.name);
                }
            }
        }
        let mut of_two = Vec::new();
        for photograph in &got.cameras[2..4] {
            let (width, height) = (photograph.width, photograph.height);
            let request = json!({ "camera": photograph.camera, "width": width, "height": height });
            let path = format!("/v1/models/{}/render", job.model.as_ref().unwrap());
            let answer = client.request(Method::POST, &path).unwrap().json(&request).send().await.unwrap();
            assert_eq!(answer.status(), StatusCode::OK, "{convention:?}");
            of_two.push(answer.bytes().await.unwrap());
        }
        assert_ne!(of_two[0], of_two[1], "the control: another camera shows another frame");
        frames.push(of_two);
    }
    assert_eq!(frames[0], frames[1], "the same bytes");
    // A quaternion rounds differently from a matrix.
    let pixels = |png: &[u8]| image::load_from_memory(png).unwrap().into_rgba8().into_raw();
    for (matrix, quaternion) in frames[0].iter().zip(&frames[2]) {
        let pairs = pixels(matrix).into_iter().zip(pixels(quaternion));
        assert_eq!(pairs.map(|(a, b)| a.abs_diff(b)).max().filter(|most| *most > 1), None);
    }
}

fn numbers(rows: &Value) -> Vec<f64> {
    rows.as_array().unwrap().iter().flat_map(|r| r.as_array().unwrap()).map(|v| v.as_f64().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn cameras_have_etags_and_invalid_ones_are_refused_by_field() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let cameras = format!("/v1/captures/{}/cameras", job.capture);
    let get = |query: &str, tag: &str| {
        let request = client.request(Method::GET, &format!("{cameras}{query}")).unwrap();
        request.header(header::IF_NONE_MATCH, tag).send()
    };
    let first = get("", "\"none\"").await.unwrap();
    let tag = first.headers()[header::ETAG].to_str().unwrap().to_owned();
    assert_eq!(get("?convention=opengl", &tag).await.unwrap().status(), StatusCode::NOT_MODIFIED);
    assert_eq!(get("?convention=colmap", &tag).await.unwrap().status(), StatusCode::OK, "another tag");
    let wrong = get("?convention=blender", "\"none\"").await.unwrap();
    assert_eq!((wrong.status().as_u16(), pointer(wrong).await), (422, json!("query/convention")));

    let matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]];
    let transposed = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 3, 1]];
    let pose = json!({ "qvec": [1, 0, 0, 0], "tvec": [0, 0, 3] });
    for (camera, wanted) in [
        (json!({ "camera_to_world": transposed, "fov_y_deg": 40 }), "/camera/camera_to_world"),
        (
            json!({ "camera_to_world": transposed, "axes": "opencv", "fov_y_deg": 40 }),
            "/camera/camera_to_world",
        ),
        (json!({ "camera_to_world": matrix, "colmap": pose, "fov_y_deg": 40 }), "/camera"),
        (json!({ "fov_y_deg": 40 }), "/camera"),
        (json!({ "colmap": pose }), "/camera"),
        (json!({ "colmap": pose, "axes": "opencv", "fov_y_deg": 40 }), "/camera/axes"),
        (json!({ "camera_to_world": matrix, "axes": "colmap", "fov_y_deg": 40 }), "/camera/axes"),
        (
            json!({ "colmap": { "qvec": [0, 0, 0, 0], "tvec": [0, 0, 3] }, "fov_y_deg": 40 }),
            "/camera/colmap/qvec",
        ),
        (
            json!({ "colmap": { "qvec": [1, 0, 0], "tvec": [0, 0, 3] }, "fov_y_deg": 40 }),
            "/camera/colmap/qvec",
        ),
    ] {
        let request = json!({ "camera": camera, "width": 16, "height": 16 });
        let path = format!("/v1/models/{}/render", job.model.as_ref().unwrap());
        let refused = client.request(Method::POST, &path).unwrap().json(&request).send().await.unwrap();
        assert_eq!((refused.status().as_u16(), pointer(refused).await), (422, json!(wanted)), "{camera}");
    }
}

async fn pointer(answer: reqwest::Response) -> Value {
    let problem: Value = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
    problem["errors"][0]["pointer"].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn cameras_for_a_model_are_in_the_world_of_that_model() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(CaptureZip::new(8, 32).zip()).await.unwrap();
    let mut request = small_job(&capture.id, 10, 5);
    request.overrides.up = Some(UpAxis::Y);
    let job = ended(client, &client.create_job(&request, None).await.unwrap().id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let model = job.model.unwrap();
    for resource in ["cameras", "photographs"] {
        let answer = |query: String| {
            let path = format!("/v1/captures/{}/{resource}{query}", capture.id);
            client.request(Method::GET, &path).unwrap().send()
        };
        let body = async |query: String| -> Value {
            let answer = answer(query).await.unwrap();
            assert_eq!(answer.status(), StatusCode::OK, "{resource}");
            serde_json::from_str(&answer.text().await.unwrap()).unwrap()
        };
        let in_model = body(format!("?model={model}")).await;
        assert_eq!(in_model, body("?up=y".to_owned()).await, "{resource}: the world that the model records");
        assert_ne!(
            in_model,
            body(String::new()).await,
            "the control, {resource}: the world of a new training"
        );
        let both = answer(format!("?model={model}&up=y")).await.unwrap();
        assert_eq!((both.status().as_u16(), pointer(both).await), (422, json!("query/up")), "{resource}");
        let unknown = answer("?model=unknown".to_owned()).await.unwrap();
        assert_eq!(unknown.status(), StatusCode::NOT_FOUND, "{resource}");
    }
}
