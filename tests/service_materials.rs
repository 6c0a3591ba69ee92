//! Materials of models over HTTP: the list, masks, and changes in pictures and exports.

use relume::testing;
use relume_api::ModelId;
use relume_api::exports::{ExportState, MeshExport, NewExport, SplatsExport, SplatsKind};
use relume_api::renders::RenderRequest;
use relume_capture::formats::image_file;
use relume_client::{Client, ClientError};
use relume_scene::ImageRgba;
use relume_spec::rendering::{Ball, Colour, FrameFormat, MaterialEdit, Output};
use reqwest::{Method, StatusCode};
use serde_json::Value;

use crate::service::look_at;
use crate::service_exports::until;
use crate::service_support::trained;

/// The albedo of a picture with changed materials.
async fn albedo(client: &Client, model: &ModelId, materials: Vec<MaterialEdit>) -> ImageRgba {
    let outputs = vec![Output::Albedo];
    let size = RenderRequest { camera: look_at(), width: 24, height: 16, ..RenderRequest::default() };
    let request = RenderRequest { outputs, materials, ..size };
    image_file::decode(&client.render(model, &request, FrameFormat::Png).await.unwrap(), 1024).unwrap()
}

fn brightest(image: &ImageRgba) -> f32 {
    image.pixels.iter().filter(|pixel| pixel[3] > 0.5).map(|pixel| pixel[0]).fold(0.0, f32::max)
}

/// Status and pointer of a refusal.
fn refusal<T: std::fmt::Debug>(answer: Result<T, ClientError>) -> (u16, String) {
    match answer {
        Err(ClientError::Problem(problem)) => {
            (problem.status, problem.errors.first().map(|error| error.pointer.clone()).unwrap_or_default())
        }
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn changed_materials_show_in_pictures_and_exports_alone() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let materials = client.materials(&model).await.unwrap().items;
    let shares: f32 = materials.iter().map(|material| material.share).sum();
    assert!((shares - 1.0).abs() < 1e-3, "{materials:?}");

    let before = albedo(client, &model, Vec::new()).await;
    let black = |material| MaterialEdit { material, scale: Some(0.0), ..MaterialEdit::default() };
    let all: Vec<MaterialEdit> = materials.iter().map(|material| black(material.material)).collect();
    assert!(brightest(&albedo(client, &model, all.clone()).await) < 0.02);
    assert!(brightest(&before) > 0.2, "the control");
    assert_eq!(albedo(client, &model, Vec::new()).await.pixels, before.pixels, "the model stays");

    let merged: Vec<MaterialEdit> = materials[1..]
        .iter()
        .map(|material| MaterialEdit {
            material: material.material,
            into: Some(materials[0].material),
            ..MaterialEdit::default()
        })
        .collect();
    let close = |a: &ImageRgba, b: &ImageRgba| {
        a.pixels.iter().zip(&b.pixels).all(|(a, b)| (a[0] - b[0]).abs() < 0.02)
    };
    assert!(close(&albedo(client, &model, merged.clone()).await, &before), "merging keeps the colours");
    let with_black = [merged, vec![black(materials[0].material)]].concat();
    assert!(brightest(&albedo(client, &model, with_black).await) < 0.02, "the merged material is everything");

    let split = |radius| MaterialEdit {
        material: 0,
        split: Some(Ball { centre: [0.0; 3], radius }),
        ..MaterialEdit::default()
    };
    let new = black(materials.len() as u32);
    let of_all = albedo(client, &model, vec![split(1e3), new]).await;
    assert_eq!(of_all.pixels, albedo(client, &model, vec![black(0)]).await.pixels, "the ball has all of it");
    assert_eq!(
        albedo(client, &model, vec![split(1e-6), new]).await.pixels,
        before.pixels,
        "the control, an empty ball"
    );

    let ply = SplatsExport { materials: all, ..SplatsExport::of(SplatsKind::Ply) };
    let mut files = Vec::new();
    for export in [NewExport::Splats(ply), NewExport::Splats(SplatsExport::of(SplatsKind::Ply))] {
        let made = client.create_export(&model, &export, None).await.unwrap();
        let ended = until(client, &made.id, |export| export.state.is_terminal()).await;
        assert_eq!(ended.state, ExportState::Succeeded, "{ended:?}");
        files.push(client.export_file(&made.id).await.unwrap());
    }
    assert_ne!(files[0], files[1]);
    assert_eq!(files[1], client.file(&model, "model.ply").await.unwrap(), "the control: no change");
}

#[tokio::test(flavor = "multi_thread")]
async fn masks_of_all_materials_cover_the_surface_once() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let count = client.materials(&model).await.unwrap().items.len();
    let mask = async |path: String| {
        let answer = client.request(Method::GET, &format!("/v1/models/{model}/materials/{path}")).unwrap();
        let answer = answer.send().await.unwrap();
        (answer.status(), answer.bytes().await.unwrap())
    };
    let mut sums = vec![0.0f32; 32 * 32];
    let mut covered = Vec::new();
    for material in 0..count {
        let (status, png) = mask(format!("{material}/mask?size=32")).await;
        assert_eq!(status, StatusCode::OK);
        let image = image_file::decode(&png, 1024).unwrap();
        let shares = image.pixels.iter().map(|pixel| relume_scene::srgb::decode(pixel[0]));
        sums.iter_mut().zip(shares).for_each(|(sum, share)| *sum += share);
        covered = image.pixels.iter().map(|pixel| pixel[3] > 0.9).collect();
    }
    let inside: Vec<f32> = sums.iter().zip(&covered).filter(|(_, is)| **is).map(|(sum, _)| *sum).collect();
    assert!(inside.len() > 50, "{} pixels", inside.len());
    assert!(inside.iter().all(|sum| (sum - 1.0).abs() < 0.05), "{inside:?}");

    for (path, status) in [
        (format!("{count}/mask"), StatusCode::NOT_FOUND),
        ("x/mask".to_owned(), StatusCode::BAD_REQUEST),
        ("0/mask?size=8".to_owned(), StatusCode::UNPROCESSABLE_ENTITY),
    ] {
        let (found, body) = mask(path.clone()).await;
        let body: Value = serde_json::from_slice(&body).unwrap();
        assert_eq!(
            (found, body["status"].as_u64()),
            (status, Some(u64::from(status.as_u16()))),
            "{path}: {body}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_changes_of_materials_are_refused_by_name() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let plain = MaterialEdit { colour: Some(Colour([1, 2, 3])), ..MaterialEdit::default() };
    let wrong = MaterialEdit { roughness: Some(1.5), ..plain };
    let missing = MaterialEdit { material: 999, ..plain };
    let empty = Ball { centre: [0.0; 3], radius: 0.0 };
    let request = RenderRequest { camera: look_at(), width: 8, height: 8, ..RenderRequest::default() };
    let request = RenderRequest { outputs: vec![Output::Rgb], ..request };
    for (edits, pointer) in [
        (vec![plain, wrong], "/materials/1/roughness"),
        (vec![missing], "/materials/0/material"),
        (vec![MaterialEdit { into: Some(999), ..MaterialEdit::default() }], "/materials/0/into"),
        (vec![plain, MaterialEdit { into: Some(1), ..plain }], "/materials/1/into"),
        (vec![MaterialEdit { split: Some(empty), ..MaterialEdit::default() }], "/materials/0/split"),
        (vec![plain; 1001], "/materials"),
    ] {
        let request = RenderRequest { materials: edits.clone(), ..request.clone() };
        let rendered = client.render(&model, &request, FrameFormat::Png).await;
        assert_eq!(refusal(rendered), (422, pointer.to_owned()));
        let mesh = MeshExport { kind: Default::default(), cells: 16, materials: edits };
        let exported = client.create_export(&model, &NewExport::Mesh(mesh), None).await;
        assert_eq!(refusal(exported), (422, pointer.to_owned()));
    }
    let valid = RenderRequest { materials: vec![plain; 1000], ..request };
    assert!(client.render(&model, &valid, FrameFormat::Png).await.is_ok(), "the control");
}
