//! The photographs of a capture over HTTP: the list and the images.

use relume::testing;
use relume_api::CaptureId;
use relume_api::cameras::CameraConvention;
use relume_api::photographs::{CapturePhotographs, CapturedPhotograph};
use relume_capture::formats::image_file::encode_png;
use relume_client::Client;
use reqwest::{Method, Response, header};
use serde_json::{Value, json};

use crate::service_support::{CaptureZip, zip_of};

const OPENGL: CameraConvention = CameraConvention::Opengl;

/// Eight photographs, of which one is black.
fn with_a_dark_one() -> CaptureZip {
    let mut capture = CaptureZip::new(8, 48);
    capture.images[3].1 = encode_png(48, 48, &[[0u8, 0, 0, 255]; 48 * 48]).unwrap();
    capture
}

async fn get(client: &Client, path: &str) -> Response {
    client.request(Method::GET, path).unwrap().send().await.unwrap()
}

async fn picture(client: &Client, photograph: &CapturedPhotograph, query: &str) -> image::RgbImage {
    let bytes = client.capture_photograph(photograph, query).await.unwrap();
    assert!(bytes.starts_with(b"\xff\xd8\xff"), "a JPEG");
    image::load_from_memory(&bytes).unwrap().into_rgb8()
}

async fn list(client: &Client, id: &CaptureId) -> CapturePhotographs {
    client.capture_photographs(id, OPENGL).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn photographs_are_listed_with_cameras_and_quality_warnings() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(with_a_dark_one().zip()).await.unwrap();
    let listed = list(client, &capture.id).await;
    let cameras = client.capture_cameras(&capture.id, OPENGL).await.unwrap().cameras;
    let taken: Vec<_> = listed.photographs.iter().map(|photograph| photograph.taken.clone()).collect();
    assert_eq!(taken, cameras);
    assert_eq!(taken.iter().filter(|camera| camera.held_out).count(), 1);
    for photograph in &listed.photographs {
        let is_dark = photograph.warnings.iter().any(|warning| warning.contains("are dark"));
        assert_eq!(is_dark, photograph.taken.name == "train/r_3.png", "{photograph:?}");
    }
    let noted: Vec<_> =
        capture.report.notes.iter().filter(|note| note.photographs == ["train/r_3.png"]).collect();
    assert!(noted.iter().any(|note| note.text.contains("are dark")), "{:?}", capture.report.notes);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_photograph_is_served_at_the_requested_width() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let sent = with_a_dark_one();
    let capture = client.upload_capture_bytes(sent.zip()).await.unwrap();
    let photographs = list(client, &capture.id).await.photographs;
    assert_eq!(photographs[1].href, format!("/v1/captures/{}/photographs/train%2Fr_1.png", capture.id));
    let whole = picture(client, &photographs[1], "").await;
    let sent_pixels = image::load_from_memory(&sent.images[1].1).unwrap().into_rgba8();
    assert_eq!(whole.dimensions(), (48, 48));
    // Composited over white, within the loss of JPEG.
    let error = |shown: &image::RgbImage| {
        let of = |(shown, sent): (&image::Rgb<u8>, &image::Rgba<u8>)| {
            let white = |k: usize| if sent[3] == 0 { 255 } else { sent[k] };
            (0..3).map(|k| u32::from(shown[k].abs_diff(white(k)))).sum::<u32>()
        };
        shown.pixels().zip(sent_pixels.pixels()).map(of).sum::<u32>() / (48 * 48)
    };
    assert!(error(&whole) < 20, "{}", error(&whole));
    let dark = picture(client, &photographs[3], "").await;
    assert!(error(&dark) > 60, "the control: another photograph, {}", error(&dark));
    for _ in 0..2 {
        assert_eq!(
            picture(client, &photographs[1], "width=16").await.dimensions(),
            (16, 16),
            "made, then cached"
        );
    }
    assert_eq!(picture(client, &photographs[1], "width=4096").await.dimensions(), (48, 48), "never enlarged");
}

#[tokio::test(flavor = "multi_thread")]
async fn photographs_answer_304_for_a_known_etag() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(with_a_dark_one().zip()).await.unwrap();
    let base = format!("/v1/captures/{}/photographs", capture.id);
    for (path, other) in [
        (base.clone(), format!("{base}?convention=colmap")),
        (format!("{base}/train%2Fr_1.png?width=16"), format!("{base}/train%2Fr_1.png?width=17")),
    ] {
        let first = get(client, &path).await;
        assert_eq!(first.status(), 200, "{path}");
        let tag = first.headers()[header::ETAG].clone();
        let again = |path: &str| {
            client.request(Method::GET, path).unwrap().header(header::IF_NONE_MATCH, tag.clone()).send()
        };
        assert_eq!(again(&path).await.unwrap().status(), 304);
        assert_eq!(again(&other).await.unwrap().status(), 200, "the control: {other}");
    }
    let head =
        client.request(Method::HEAD, &format!("{base}/train%2Fr_2.png")).unwrap().send().await.unwrap();
    assert_eq!(
        (head.status().as_u16(), &head.headers()[header::CONTENT_TYPE]),
        (200, &"image/jpeg".parse().unwrap())
    );
    assert!(head.headers().contains_key(header::ETAG) && head.bytes().await.unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn photograph_names_outside_the_capture_answer_404() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let mut sent = with_a_dark_one();
    sent.images.push(("more.png".to_owned(), sent.images[0].1.clone()));
    let capture = client.upload_capture_bytes(sent.zip()).await.unwrap();
    let base = format!("/v1/captures/{}/photographs", capture.id);
    for name in [
        "transforms_train.json",
        "more.png",
        "r_1.png",
        "train",
        "train%2Fr_99.png",
        "..%2F..%2Frelume.db",
        "%2Fetc%2Fpasswd",
        "..%2f..%2f..%2f..%2fetc%2fpasswd",
        "train%2F..%2Ftrain%2Fr_1.png",
        "train%5Cr_1.png",
        "train%2Fr_1.png%00",
    ] {
        for method in [Method::GET, Method::HEAD] {
            let answer = client.request(method, &format!("{base}/{name}")).unwrap().send().await.unwrap();
            // No name has a NUL, so such a path is malformed.
            let expected = if name.contains("%00") { 400 } else { 404 };
            assert_eq!(answer.status(), expected, "{name}");
        }
    }
    assert_eq!(get(client, &format!("{base}/train%2Fr_1.png")).await.status(), 200, "the control");
    for (query, field) in [
        ("width=15", "query/width"),
        ("width=4097", "query/width"),
        ("undistorted=2", "query/undistorted"),
        ("size=9", "query/size"),
    ] {
        let refused = get(client, &format!("{base}/train%2Fr_1.png?{query}")).await;
        let problem: Value = serde_json::from_str(&refused.text().await.unwrap()).unwrap();
        assert_eq!((&problem["status"], &problem["errors"][0]["pointer"]), (&json!(422), &json!(field)));
    }
}

/// A nerfstudio capture with the lens distortion `k1`, in its own folder.
fn bent(k1: f64) -> Vec<(String, Vec<u8>)> {
    let CaptureZip { mut transforms, images } = with_a_dark_one();
    for (frame, (name, _)) in transforms["frames"].as_array_mut().unwrap().iter_mut().zip(&images) {
        frame["file_path"] = json!(name);
    }
    transforms["k1"] = json!(k1);
    let mut entries = vec![("thing/transforms.json".to_owned(), serde_json::to_vec(&transforms).unwrap())];
    entries.extend(images.into_iter().map(|(name, bytes)| (format!("thing/{name}"), bytes)));
    entries
}

#[tokio::test(flavor = "multi_thread")]
async fn photographs_are_undistorted_on_request() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    for k1 in [0.3, 0.0] {
        let capture = client.upload_capture_bytes(zip_of(&bent(k1))).await.unwrap();
        let photographs = list(client, &capture.id).await.photographs;
        assert_eq!(photographs[1].taken.name, "train/r_1.png");
        let as_taken = picture(client, &photographs[1], "").await;
        let undistorted = picture(client, &photographs[1], "undistorted=true").await;
        assert_eq!(as_taken.dimensions(), undistorted.dimensions());
        assert_eq!(as_taken == undistorted, k1 == 0.0, "a pinhole is the control");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn photographs_of_a_tar_are_served_until_the_capture_is_deleted() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let mut tar = tar::Builder::new(flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast()));
    for (name, bytes) in bent(0.1) {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        tar.append_data(&mut header, name, bytes.as_slice()).unwrap();
    }
    let archive = tar.into_inner().unwrap().finish().unwrap();
    let capture = client.upload_capture_bytes(archive).await.unwrap();
    let photographs = list(client, &capture.id).await.photographs;
    for photograph in &photographs {
        assert_eq!(picture(client, photograph, "width=20").await.dimensions(), (20, 20));
    }
    client.request(Method::DELETE, &format!("/v1/captures/{}", capture.id)).unwrap().send().await.unwrap();
    for path in
        [format!("/v1/captures/{}/photographs", capture.id), format!("{}?width=20", photographs[1].href)]
    {
        assert_eq!(get(client, &path).await.status(), 404, "{path}");
    }
}
