//! The default view of a model: that of its first photograph, for every endpoint that shows one.

use glam::DVec3;
use relume::testing;
use relume_api::ModelId;
use relume_client::Client;
use relume_scene::PhotographedViews;
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};

use crate::service_support::{CaptureZip, ended, small_job};

/// A model whose first photograph is not on the +x side, and its card.
async fn turned_model(client: &Client) -> (ModelId, Value) {
    let mut capture = CaptureZip::new(8, 32);
    capture.transforms["frames"].as_array_mut().unwrap().rotate_left(3);
    let capture = client.upload_capture_bytes(capture.zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 10, 5), None).await.unwrap();
    let model = ended(client, &job.id).await.model.unwrap();
    let card = client.model(&model).await.unwrap().card;
    (model, card)
}

/// The bytes of a picture, and its angle to the nearest photograph.
async fn picture(response: Response) -> (Vec<u8>, f64) {
    assert_eq!(response.status(), StatusCode::OK);
    let angle = response.headers()["relume-photograph-angle"].to_str().unwrap().parse().unwrap();
    (response.bytes().await.unwrap().to_vec(), angle)
}

async fn thumbnail(client: &Client, model: &ModelId, query: &str) -> (Vec<u8>, f64) {
    let path = format!("/v1/models/{model}/thumbnail?size=32{query}");
    picture(client.request(Method::GET, &path).unwrap().send().await.unwrap()).await
}

/// The greatest difference of two PNG files, levels.
fn difference(a: &[u8], b: &[u8]) -> u8 {
    let [a, b] = [a, b].map(|png| image::load_from_memory(png).unwrap().into_rgba8().into_raw());
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn default_views_of_all_surfaces_agree() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let (model, card) = turned_model(client).await;
    let views = PhotographedViews::of_card(&card).unwrap();
    assert!(views.azimuth_deg.abs() > 45.0, "the control: not the +x side");

    let (default, angle) = thumbnail(client, &model, "").await;
    let elevation = views.elevation_deg;
    for same in ["&azimuth=0".to_owned(), format!("&azimuth=0&elevation={elevation}")] {
        assert!(thumbnail(client, &model, &same).await.0 == default, "{same}");
    }
    let (other, far) = thumbnail(client, &model, "&azimuth=100&elevation=-85").await;
    assert!(other != default && angle < 20.0 && far > 60.0, "{angle} {far}");
    assert_eq!(thumbnail(client, &model, "").await.1, angle, "also from the cache");
    let path = format!("/v1/models/{model}/thumbnail?size=32");
    let head = client.request(Method::HEAD, &path).unwrap().send().await.unwrap();
    assert_eq!(picture(head).await.1, angle, "also without the picture");

    let stream = client.viewer_stream(&model).await.unwrap();
    let length = u32::from_le_bytes(stream[8..12].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&stream[12..12 + length]).unwrap();
    assert_eq!(header["photographed_views"], card["photographed_views"]);
    let framing = &header["framing"];
    let eye = DVec3::from_array(std::array::from_fn(|k| framing["eye"][k].as_f64().unwrap()));
    assert!((eye - views.target).angle_between(views.direction(None, None)) < 1e-6);

    let look_at =
        json!({ "eye": framing["eye"], "target": framing["target"], "fov_y_deg": framing["fov_deg"] });
    let body = json!({ "camera": { "look_at": look_at }, "environment": { "builtin": "recovered" },
        "width": 32, "height": 32, "tier": "preview" });
    let render = client.request(Method::POST, &format!("/v1/models/{model}/render")).unwrap();
    let (rendered, its_angle) = picture(render.json(&body).send().await.unwrap()).await;
    assert!((its_angle - angle).abs() < 0.11, "{its_angle} {angle}");
    assert!(difference(&rendered, &default) <= 2, "the viewer starts at the view of the thumbnail");
    assert!(difference(&other, &default) > 2, "the control");
}
