//! Exported frames of camera paths in the axes of a model.

use relume::testing;
use relume_api::ModelId;
use relume_client::Client;
use relume_spec::training::UpAxis;
use reqwest::Method;
use serde_json::{Value, json};

use super::{entries, made};
use crate::service_support::{self, CaptureZip, small_job};

/// The images of an export of frames without light.
async fn normals(client: &Client, model: &ModelId, path: &Value) -> Vec<Vec<u16>> {
    let body = json!({ "kind": "frames", "path": path, "outputs": ["normal"], "width": 32, "height": 32 });
    let (_, zip) = made(client, model, &body).await;
    let images = entries(&zip).into_iter().filter(|(name, _)| name.ends_with(".png"));
    images.map(|(_, png)| image::load_from_memory(&png).unwrap().into_rgb16().into_raw()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn transforms_json_is_rendered_in_the_world_of_the_model() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let sent = CaptureZip::new(8, 32);
    let capture = client.upload_capture_bytes(sent.zip()).await.unwrap();
    // The files state +Z; the training decides otherwise.
    let mut request = small_job(&capture.id, 10, 5);
    request.overrides.up = Some(UpAxis::Y);
    let job = client.create_job(&request, None).await.unwrap();
    let model = service_support::ended(client, &job.id).await.model.unwrap();
    let cameras = async |query: &str| -> Value {
        let path = format!("/v1/captures/{}/cameras{query}", capture.id);
        let answer = client.request(Method::GET, &path).unwrap().send().await.unwrap();
        serde_json::from_str(&answer.text().await.unwrap()).unwrap()
    };
    let by_files = normals(client, &model, &sent.transforms).await;
    let in_its_world = normals(client, &model, &cameras(&format!("?model={model}")).await).await;
    let in_another = normals(client, &model, &cameras("").await).await;
    let error = |frames: &[Vec<u16>]| {
        assert_eq!((frames.len(), by_files.len()), (8, 8));
        let levels = frames.iter().flatten().zip(by_files.iter().flatten());
        levels.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / (8.0 * 32.0 * 32.0 * 3.0)
    };
    // Cameras that were written and read differ by rounding.
    assert!(error(&in_its_world) < 1.0, "{}", error(&in_its_world));
    assert!(error(&in_another) > 300.0, "the control: {}", error(&in_another));
}
