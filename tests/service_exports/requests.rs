//! The request in the views of an export.

use relume::testing;
use relume_api::exports::{FramesExport, NewExport, SplatsExport, SplatsKind};
use serde_json::json;

use super::{ended, queued, trained};

#[tokio::test(flavor = "multi_thread")]
async fn exports_show_their_request_unless_it_is_long() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let frames = FramesExport { width: Some(8), height: Some(8), ..FramesExport::turntable(2) };
    let frame = json!({ "file_path": "a.png", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]] });
    let path = json!({ "camera_angle_x": 0.7, "frames": vec![frame; 60] });
    let long = FramesExport { path: Some(path), ..FramesExport::turntable(1) };
    let long = FramesExport { turntable: None, width: Some(8), height: Some(8), ..long };
    for (request, is_shown) in [
        (NewExport::Frames(Box::new(frames)), true),
        (NewExport::Splats(SplatsExport::of(SplatsKind::Ply)), true),
        (NewExport::Frames(Box::new(long)), false),
    ] {
        let shown = is_shown.then(|| request.clone());
        let made = queued(client, &model, &json!(request)).await;
        assert_eq!(made.request, shown, "the answer to the request");
        assert_eq!(ended(client, &made.id).await.request, shown, "the export");
        let listed = client.exports(Some(&model)).await.unwrap().items;
        let listed = listed.into_iter().find(|export| export.id == made.id).unwrap();
        assert_eq!(listed.request, shown, "the list");
    }
}
