//! A model and a light made ready once, and pictures of them.

use std::path::Path;
use std::sync::Arc;

use super::args::RenderArgs;
use crate::cli::error::CommandResult;
use crate::cli::input;
use crate::cli::light::named_light;
use relume_engine::Device;
use relume_scene::{Illumination, Model};
use relume_spec::rendering::{Background, FrameFormat, Output, Quality, Tier};
use relume_train::render::{Finish, FrameNotes, PreparedLight, Renderer, View, encode_frame};

/// A model and a light, ready to be rendered many times.
pub(super) struct Studio {
    renderer: Renderer,
    /// With its exposure, not turned.
    light: Illumination,
    quality: Quality,
    outputs: Vec<Output>,
    format: FrameFormat,
    /// All but the camera and the turn of the light.
    finish: Finish,
}

/// A light that stands in one way.
pub(super) struct TurnedLight {
    rotation_deg: f64,
    prepared: PreparedLight,
}

impl Studio {
    /// Reads the model and the light that `args` name; refuses what files of `format` cannot show.
    pub(super) fn open(args: &RenderArgs, format: FrameFormat) -> CommandResult<Self> {
        let quality = args.quality.quality(Tier::default());
        let notes = FrameNotes {
            model: file_name(&args.model),
            light: args.env.clone(),
            rotation_deg: args.rotation,
            exposure_ev: args.exposure,
            quality,
            camera: None,
            frames_per_second: args.sequence.fps,
        };
        let finish = Finish {
            background: args.background,
            tone_curve: args.tone_curve,
            colour_depth: args.colour_depth,
            alpha: args.alpha,
            primaries: args.primaries,
            notes,
        };
        let model = Arc::new(input::read_model(&args.model)?);
        let outputs = args.outputs(&model)?;
        finish.check(&outputs, format)?;
        let light = match args.env.as_str() {
            "recovered" => model.recovered_light(),
            name => named_light(name, "recovered ")?.into(),
        };
        let light = light.rotated_and_scaled(0.0, args.exposure.exp2() as f32);
        let renderer = Renderer::on(model, &Device::open(args.device)?)?;
        Ok(Self { renderer, light, quality, outputs, format, finish })
    }

    pub(super) fn model(&self) -> &Model {
        self.renderer.model()
    }

    /// The picture file of a view. `light` is that of the last view, and is made anew where it stands otherwise.
    pub(super) fn picture(&self, view: &View, light: &mut Option<TurnedLight>) -> CommandResult<Vec<u8>> {
        let rotation_deg = self.finish.notes.rotation_deg + view.light_turn_deg;
        let kept = light.take().filter(|light| light.rotation_deg == rotation_deg);
        let light = light.insert(match kept {
            Some(light) => light,
            None => {
                let turned = self.light.rotated_and_scaled(rotation_deg, 1.0);
                TurnedLight { rotation_deg, prepared: self.renderer.prepare_light(turned)? }
            }
        });
        let View { camera, .. } = view;
        let mut frame = self.renderer.render(camera, &light.prepared, self.quality, &self.outputs)?;
        if self.finish.background == Background::Environment {
            self.renderer.show_environment(&mut frame, camera, &light.prepared);
        }
        let notes = FrameNotes { camera: Some(*camera), rotation_deg, ..self.finish.notes.clone() };
        let finish = Finish { notes, ..self.finish.clone() };
        Ok(encode_frame(&frame, &self.outputs, self.format, &finish)?.bytes)
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
