//! A model and a light that are prepared once for many images.

use std::path::Path;
use std::sync::Arc;

use super::args::RenderArgs;
use crate::cli::error::CommandResult;
use crate::cli::input;
use crate::cli::light::illumination;
use relume_engine::Device;
use relume_scene::{Illumination, Model};
use relume_spec::rendering::{Background, FrameFormat, Lamp, Output, Quality, Tier};
use relume_train::render::{
    EncodeOptions, Frame, FrameMetadata, FrameView, Renderer, RotatedLight, encode_frame,
};

/// A model and a light, ready for rendering.
pub(super) struct RenderSession {
    renderer: Renderer,
    /// The light with its exposure, not rotated.
    light: Illumination,
    quality: Quality,
    outputs: Vec<Output>,
    ground_height: Option<f64>,
    lamps: Vec<Lamp>,
    format: FrameFormat,
    /// All encoding options except the camera and the rotation of the light.
    encoding: EncodeOptions,
}

impl RenderSession {
    /// Reads the model and the light in `args`. Refuses options that files of `format` do not support.
    pub(super) fn open(args: &RenderArgs, format: FrameFormat) -> CommandResult<Self> {
        let quality = args.quality.quality(Tier::default());
        let env = args.env.as_deref().unwrap_or("recovered");
        let frame_metadata = FrameMetadata {
            model: file_name(&args.model),
            light: env.to_owned(),
            rotation_deg: args.rotation,
            exposure_ev: args.exposure,
            quality,
            camera: None,
            frames_per_second: args.sequence.fps,
            ground_height: args.ground_height,
            lamps: args.lamps()?,
        };
        let encoding = EncodeOptions {
            background: args.background,
            tone_curve: args.tone_curve,
            colour_depth: args.colour_depth,
            alpha: args.alpha,
            primaries: args.primaries,
            frame_metadata,
        };
        let model = Arc::new(args.materials.apply(input::read_model(&args.model)?)?);
        let outputs = args.outputs(&model)?;
        encoding.check(&outputs, format)?;
        let light = illumination(env, &model)?;
        let light = light.rotated_and_scaled(0.0, args.exposure.exp2() as f32);
        let renderer = Renderer::on(model, &Device::open(args.device)?)?;
        Ok(Self {
            renderer,
            light,
            quality,
            outputs,
            ground_height: args.ground_height,
            lamps: args.lamps()?,
            format,
            encoding,
        })
    }

    pub(super) fn model(&self) -> &Model {
        self.renderer.model()
    }

    /// Renders a view. `light` has the light of the previous view; it is prepared again if
    /// its rotation differs.
    pub(super) fn picture(&self, view: &FrameView, light: &mut RotatedLight) -> CommandResult<Picture> {
        let rotation_deg = self.encoding.frame_metadata.rotation_deg + view.light_rotation_deg;
        let light = light.at(&self.renderer, &self.light, rotation_deg)?;
        let FrameView { camera, .. } = view;
        let bands = self.renderer.bands(camera, light, self.quality, &self.outputs)?;
        let bands = bands.undivided().on_ground(self.ground_height).between(view.neighbours);
        let mut bands = bands.with_lamps(self.lamps.clone());
        while bands.render_next()? {}
        let mut frame = bands.into_frame();
        if self.encoding.background == Background::Environment {
            self.renderer.show_environment(&mut frame, camera, light);
        }
        let frame_metadata =
            FrameMetadata { camera: Some(*camera), rotation_deg, ..self.encoding.frame_metadata.clone() };
        let encoding = EncodeOptions { frame_metadata, ..self.encoding.clone() };
        Ok(Picture { frame, outputs: self.outputs.clone(), format: self.format, encoding })
    }
}

/// A rendered view that is not encoded yet.
pub(super) struct Picture {
    frame: Frame,
    outputs: Vec<Output>,
    format: FrameFormat,
    encoding: EncodeOptions,
}

impl Picture {
    /// The bytes of the image file.
    pub(super) fn encoded(&self) -> CommandResult<Vec<u8>> {
        Ok(encode_frame(&self.frame, &self.outputs, self.format, &self.encoding)?.bytes)
    }
}

/// The name of a file without its folder.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
