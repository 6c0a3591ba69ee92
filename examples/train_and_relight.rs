//! Uses the library without a server: reads a capture, trains a model and writes relit pictures.
//!
//! ```sh
//! cargo run --release --example train_and_relight                    # the synthetic scene, 300 steps
//! cargo run --release --example train_and_relight -- CAPTURE 1500    # your folder or archive, 1500 steps
//! ```
//!
//! It writes `relit_LIGHT.png` for three built-in lights and `relit.exr` with linear colour and normals.

use std::path::Path;
use std::sync::Arc;

use relume::{
    Capture, Device, Frame, ImportOptions, Model, Output, Preset, Renderer, Tier, TrainConfig,
    TrainOverrides, Trainer, import,
};
use relume_capture::formats::exr_frame::{self, FrameAttributes, FrameLayer, FrameLayers};
use relume_capture::formats::image_file::encode_png;
use relume_capture::{SyntheticOptions, builtin, synthetic};
use relume_spec::rendering::{ColourDepth, Primaries};

const DEFAULT_STEPS: u32 = 300;
/// Longest side of the training photographs, pixels.
const TRAINING_SIDE: u32 = 96;
/// Longest side of the relit pictures, pixels.
const PICTURE_SIDE: u32 = 384;

type AnyError = Box<dyn std::error::Error>;

fn main() -> Result<(), AnyError> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next();
    let steps = arguments.next().map_or(Ok(DEFAULT_STEPS), |text| text.parse())?;

    let capture = read_capture(folder.as_deref())?;
    let view = capture.test.first().or(capture.train.first()).ok_or("the capture has no photograph")?;
    let longest = view.camera.width.max(view.camera.height);
    let scaled = |side: u32| (side * PICTURE_SIDE / longest).max(1);
    let camera = view.camera.resized(scaled(view.camera.width), scaled(view.camera.height));

    let renderer = Renderer::new(Arc::new(train(&capture, steps)?));
    let outputs = [Output::Rgb, Output::Normal];
    for name in ["studio", "sunset", "night"] {
        let light = builtin(name).ok_or("not a built-in light")?;
        let frame = renderer.render(&camera, &renderer.prepare_light(&light)?, Tier::Standard, &outputs)?;
        let file = format!("relit_{name}.png");
        std::fs::write(&file, encode_png(frame.width, frame.height, &frame.to_srgb8())?)?;
        println!("wrote {file}");
        if name == "sunset" {
            std::fs::write("relit.exr", linear_exr(&frame)?)?;
            println!("wrote relit.exr");
        }
    }
    Ok(())
}

/// Reads the capture at `path`, or makes the synthetic scene.
/// Photographs have at most [`TRAINING_SIDE`] pixels a side.
fn read_capture(path: Option<&str>) -> Result<Capture, AnyError> {
    let Some(path) = path else {
        let options =
            SyntheticOptions { train_views: 16, size: TRAINING_SIDE, paths: 32, ..Default::default() };
        return Ok(synthetic(&options)?);
    };
    let options = ImportOptions { max_side: Some(TRAINING_SIDE), load_truth: false, ..Default::default() };
    let capture = import(Path::new(path), &options)?;
    capture.warnings.iter().for_each(|warning| eprintln!("warning: {warning}"));
    Ok(capture)
}

/// Trains on the CPU; `Device::open` opens a GPU.
fn train(capture: &Capture, steps: u32) -> Result<Model, AnyError> {
    let overrides = TrainOverrides {
        iterations: Some(steps),
        resolution: Some(TRAINING_SIDE),
        max_gaussians: Some(4000),
        ..Default::default()
    };
    let config = TrainConfig::new(Preset::Draft, &overrides)?;
    let mut trainer = Trainer::new(capture, config, &Device::Cpu)?;
    while !trainer.is_done() {
        let report = trainer.step()?;
        if report.step.is_multiple_of(50) {
            println!("step {:>5}  PSNR {:.2} dB  {} Gaussians", report.step, report.psnr, report.gaussians);
        }
    }
    Ok(trainer.model()?)
}

/// Encodes linear colour (premultiplied, with alpha) and world-space normals as a 32-bit float EXR.
fn linear_exr(frame: &Frame) -> Result<Vec<u8>, AnyError> {
    let plane = |output| frame.planes.get(&output).ok_or("the frame lacks an output");
    let (rgb, alpha) = (plane(Output::Rgb)?, plane(Output::Alpha)?);
    let rgba: Vec<f32> = rgb.chunks_exact(3).zip(alpha).flat_map(|(c, a)| [c[0], c[1], c[2], *a]).collect();
    let layers = FrameLayers {
        width: frame.width,
        height: frame.height,
        colour: &[FrameLayer::new("", "RGBA", &rgba)],
        primaries: Primaries::Rec709,
        data: &[FrameLayer::new("N", "XYZ", plane(Output::Normal)?)],
        attributes: &FrameAttributes::default(),
    };
    Ok(exr_frame::encode(&layers, ColourDepth::Full)?)
}
