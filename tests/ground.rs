//! The ground below a model, and lamps: outputs of `relume render` and of the service.

use std::path::Path;
use std::process::{Command, Output as Ended};

use relume::testing;
use relume_api::exports::{ExportState, FramesExport, NewExport};
use relume_api::renders::RenderRequest;
use relume_capture::formats::{image_file, model_file};
use relume_client::ClientError;
use relume_spec::rendering::{FrameFormat, Lamp, Output, Tier};
use tempfile::TempDir;

use crate::service::look_at;
use crate::service_exports::until;
use crate::service_support::trained;

fn relume(folder: &Path, arguments: &[&str]) -> Ended {
    let fixed = ["render", "m.safetensors", "--env", "sunset", "--size", "48", "--device", "cpu"];
    Command::new(env!("CARGO_BIN_EXE_relume"))
        .current_dir(folder)
        .args(fixed)
        .args(arguments)
        .output()
        .unwrap()
}

/// The red values of the picture of an output.
fn picture(folder: &Path, arguments: &[&str]) -> Vec<f32> {
    let ended = relume(folder, &[arguments, &["--elevation", "40", "--out", "o.png"]].concat());
    assert!(ended.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
    let image = image_file::decode(&std::fs::read(folder.join("o.png")).unwrap(), 48 * 48).unwrap();
    image.pixels.iter().map(|pixel| pixel[0]).collect()
}

#[test]
fn render_writes_the_planes_of_the_ground() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let model = relume_fixtures::model::model(300, 5);
    std::fs::write(at.join("m.safetensors"), model_file::encode(&model).unwrap()).unwrap();
    for output in ["shadow", "contact"] {
        let near = picture(at, &["--output", output]);
        let darkest = near.iter().copied().fold(1.0, f32::min);
        assert!(darkest < 0.9, "{output}: {darkest}");
        let far = picture(at, &["--output", output, "--ground-height", "-50"]);
        let of_far = far.iter().copied().fold(1.0, f32::min);
        assert!(of_far > darkest, "the control, a ground far below: {output}: {of_far} {darkest}");
    }
    assert!(picture(at, &["--output", "bounce"]).iter().any(|v| *v > 0.01));
    let lit = |output, at_height| {
        let lamp = format!("point position=0,0,{at_height} intensity=4");
        picture(at, &["--output", output, "--lamp", &lamp])
    };
    let [low, high] =
        ["-50", "3"].map(|height| lit("lamp_light", height).iter().copied().fold(0.0, f32::max));
    assert!(high > 0.05 && low == 0.0, "a lamp below the ground lights nothing: {high} {low}");
    let darkest = |values: Vec<f32>| values.iter().copied().fold(1.0, f32::min);
    let shadow = darkest(lit("lamp_shadow", "3"));
    assert!(shadow < 0.7, "{shadow}");
    assert_eq!(darkest(picture(at, &["--output", "lamp_shadow"])), 1.0, "the control, no lamp");

    let outputs = ["--output", "rgb,position,shadow,bounce,contact", "--out", "o.exr"];
    assert!(relume(at, &outputs).status.success());
    let text = String::from_utf8_lossy(&std::fs::read(at.join("o.exr")).unwrap()).into_owned();
    for channel in ["P.X", "shadow.R", "bounce.B", "contact.Y"] {
        assert!(text.contains(channel), "{channel}");
    }
    assert!(!text.contains("depth"), "only the requested outputs");
}

#[test]
fn lamps_light_the_side_that_faces_them() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let model = relume_fixtures::model::model(300, 5);
    std::fs::write(at.join("m.safetensors"), model_file::encode(&model).unwrap()).unwrap();
    let brightness =
        |options: &[&str]| picture(at, &[&["--exposure", "-20"], options].concat()).iter().sum::<f32>();
    let lamp = |intensity: f32, tier: &str| {
        let lamp = format!("point position=0,0,3 intensity={intensity}");
        brightness(&["--tier", tier, "--tone-curve", "linear", "--lamp", &lamp])
    };
    let dark = brightness(&[]);
    assert!(dark < 1.0, "{dark}");
    for tier in ["standard", "high"] {
        let (one, four) = (lamp(0.1, tier), lamp(0.4, tier));
        let ratio = (four - dark) / (one - dark);
        assert!(one > dark + 1.0 && (3.6..4.1).contains(&ratio), "{tier}: {dark} {one} {four}");
    }
}

#[test]
fn render_refuses_a_ground_that_no_output_shows() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    std::fs::write(
        at.join("m.safetensors"),
        model_file::encode(&relume_fixtures::model::model(50, 5)).unwrap(),
    )
    .unwrap();
    for (arguments, named) in [
        (&["--ground-height", "0.5"][..], "--ground-height"),
        (&["--lamp", "point position=0,0,1"], "intensity"),
        (&["--lamp", "point position=0,0,1 intensity=1", "--output", "normal"], "--lamp"),
        (&["--light-matrix", "8", "--lamp", "point position=0,0,1 intensity=1", "--out", "o.exr"], "--lamp"),
        (&["--ground-height", "nan", "--output", "shadow"], "ground-height"),
        (&["--output", "position", "--out", "o.png"], "position"),
        (&["--output", "cryptomatte", "--out", "o.png"], "cryptomatte"),
        (&["--output", "motion", "--out", "o.exr"], "--output motion"),
        (&["--light-matrix", "8", "--ground-height", "0", "--out", "o.exr"], "--ground-height"),
    ] {
        let ended = relume(at, arguments);
        let said = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(!ended.status.success() && said.contains(named), "{arguments:?}: {said}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn service_renders_ground_and_lamps_and_names_faults() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let request = |outputs: &[Output], ground_height| RenderRequest {
        camera: look_at(),
        width: 24,
        height: 16,
        outputs: outputs.to_vec(),
        ground_height,
        ..RenderRequest::default()
    };
    let of = async |request: RenderRequest, format| client.render(&model, &request, format).await;
    let near = of(request(&[Output::Contact], None), FrameFormat::Png).await.unwrap();
    let far = of(request(&[Output::Contact], Some(-50.0)), FrameFormat::Png).await.unwrap();
    assert_ne!(near, far);
    let exr =
        of(request(&[Output::Rgb, Output::Shadow, Output::Position], None), FrameFormat::Exr).await.unwrap();
    assert!(String::from_utf8_lossy(&exr).contains("shadow.G"));
    let lamp = |text: &str| -> Lamp { text.parse().unwrap() };
    let lit = |lamps| RenderRequest { lamps, ..request(&[Output::Rgb], None) };
    let bulb = lamp("point position=2,1,2 intensity=30 kelvin=3200");
    let [dark, bright] = [Vec::new(), vec![bulb.clone()]].map(lit);
    assert_ne!(
        of(dark, FrameFormat::Png).await.unwrap(),
        of(bright, FrameFormat::Png).await.unwrap(),
        "a lamp changes the picture"
    );
    let wrong = Lamp { intensity: Some(-1.0), ..bulb.clone() };
    for (request, pointer) in [
        (lit(vec![bulb.clone(), wrong]), "/lamps/1/intensity"),
        (lit(vec![bulb.clone(); 17]), "/lamps"),
        (
            RenderRequest {
                lamps: vec![bulb.clone(); 2],
                width: 2048,
                height: 2048,
                ..request(&[Output::LampLight], None)
            },
            "/lamps",
        ),
        (RenderRequest { lamps: vec![bulb.clone()], ..request(&[Output::Normal], None) }, "/lamps"),
        (RenderRequest { tier: Tier::High, width: 4096, height: 4096, ..lit(vec![bulb.clone()]) }, "/lamps"),
        (request(&[Output::Rgb], Some(0.0)), "/ground_height"),
        (request(&[Output::Position], None), "/outputs"),
        (request(&[Output::MaterialId], None), "/outputs"),
        (request(&[Output::Motion], None), "/outputs"),
    ] {
        match of(request, FrameFormat::Png).await {
            Err(ClientError::Problem(problem)) => {
                assert_eq!((problem.status, problem.errors[0].pointer.as_str()), (422, pointer));
            }
            other => panic!("{pointer}: {other:?}"),
        }
    }

    let frames = FramesExport {
        format: FrameFormat::Exr,
        outputs: vec![
            Output::Rgb,
            Output::Shadow,
            Output::LampLight,
            Output::Motion,
            Output::MaterialId,
            Output::Cryptomatte,
        ],
        lamps: vec![bulb.clone()],
        ground_height: Some(-1.0),
        width: Some(16),
        height: Some(16),
        ..FramesExport::turntable(2)
    };
    let refused = FramesExport { outputs: vec![Output::Rgb], ..frames.clone() };
    let answer = client.create_export(&model, &NewExport::Frames(Box::new(refused)), None).await;
    assert!(
        matches!(answer, Err(ClientError::Problem(problem)) if problem.errors[0].pointer == "/ground_height")
    );
    let made = client.create_export(&model, &NewExport::Frames(Box::new(frames)), None).await.unwrap();
    let ended = until(client, &made.id, |export| export.state.is_terminal()).await;
    assert_eq!(ended.state, ExportState::Succeeded, "{ended:?}");
    let zip = client.export_file(&made.id).await.unwrap();
    let text = String::from_utf8_lossy(&zip);
    let named =
        ["relume:lamps", "relume:ground_height", "shadow.R", "lamp_light.R", "backward.v", "material_id.Y"];
    assert!(named.iter().all(|name| text.contains(name)));
    assert!(text.contains("CryptoMaterial02.A") && text.contains("\"material_"), "with a manifest");
    assert!(!text.contains("confidence.Y"), "the control");
}
