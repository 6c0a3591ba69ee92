//! Ground-truth layers of synthetic sets: TensoIR's files, and further ones that `scene.json` describes.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use serde::Deserialize;

use crate::formats::{environment, image_file};
use crate::images::load_picture;
use crate::json::parse_json;
use crate::{CaptureError, CaptureFiles, CaptureView, GroundTruthView, ImportOptions};
use relume_scene::{EnvMap, ImageRgba, Plane, srgb};

/// Depth images store `value / 65535 * DEPTH_RANGE` capture units along the view axis.
pub(super) const DEPTH_RANGE: f32 = 10.0;

/// The description of the layers in `scene.json`. TensoIR's own sets have no such file.
#[derive(Debug, Clone, Default, Deserialize)]
struct SceneFile {
    albedo_png: Option<String>,
}

/// Paths of the layers of one image.
#[derive(Debug, Clone, Default)]
pub(super) struct TruthFiles {
    relit: BTreeMap<String, String>,
    layers: BTreeSet<String>,
    folder: String,
    albedo: AlbedoEncoding,
}

/// Colour encoding of a set's albedo images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum AlbedoEncoding {
    /// Linear Rec.709.
    #[default]
    Linear,
    /// The sRGB curve.
    Srgb,
}

/// The encoding of the set's albedo images that `scene.json` in `folder` names; linear without that file.
///
/// # Errors
/// When `scene.json` exists but is not JSON.
pub(super) fn albedo_encoding(source: &CaptureFiles, folder: &str) -> Result<AlbedoEncoding, CaptureError> {
    let file = format!("{folder}scene.json");
    if !source.contains(&file) {
        return Ok(AlbedoEncoding::Linear);
    }
    let scene: SceneFile = parse_json(&file, &source.read(&file)?)?;
    let is_srgb = scene.albedo_png.is_some_and(|text| text.to_ascii_lowercase().contains("srgb"));
    Ok(if is_srgb { AlbedoEncoding::Srgb } else { AlbedoEncoding::Linear })
}

impl TruthFiles {
    /// Finds the layers, and the view under other lights, in the folder of `image` (e.g. `test_003/rgba.png`).
    pub(super) fn beside(source: &CaptureFiles, image: &str, albedo: AlbedoEncoding) -> Self {
        let Some((folder, own_name)) = image.rsplit_once('/') else { return Self::default() };
        if !own_name.starts_with("rgba") {
            return Self::default();
        }
        let mut out = Self { folder: folder.to_owned(), albedo, ..Self::default() };
        for path in source.paths_under(folder) {
            let name = &path[folder.len() + 1..];
            let light = name.strip_prefix("rgba_").and_then(|n| n.strip_suffix(".png"));
            match light {
                Some(light) if name != own_name => drop(out.relit.insert(light.to_owned(), path.to_owned())),
                Some(_) => {}
                None => drop(out.layers.insert(name.to_owned())),
            }
        }
        out
    }

    /// Reads the layers at the view's size.
    ///
    /// # Errors
    /// Names the layer's file.
    pub(super) fn load(
        &self,
        source: &CaptureFiles,
        size: (u32, u32),
        options: &ImportOptions,
    ) -> Result<GroundTruthView, CaptureError> {
        let mut truth = GroundTruthView::default();
        for (light, path) in &self.relit {
            let image = load_picture(source, path, options)?;
            truth.relit.insert(light.clone(), fitted(path, image, size)?);
        }
        let layer = |name: &str| self.layer(source, name, size, options);
        let colour = |v: f32| match self.albedo {
            AlbedoEncoding::Linear => v,
            AlbedoEncoding::Srgb => srgb::decode(v),
        };
        if let Some(image) = layer("albedo.png")? {
            truth.albedo = Some(reduced(&image, size, |p| ([0, 1, 2].map(|k| colour(p[k])), p[3])));
        }
        if let Some(image) = layer("normal.png")? {
            let mut plane = reduced(&image, size, |p| ([0, 1, 2].map(|k| 2.0 * p[k] - 1.0), p[3]));
            let unit = |v: &mut [f32; 3]| *v = Vec3::from(*v).normalize_or_zero().to_array();
            plane.values.iter_mut().for_each(unit);
            truth.normal = Some(plane);
        }
        if let Some(image) = layer("metallic_roughness.png")? {
            truth.metallic_roughness = Some(reduced(&image, size, |p| ([p[0], p[1]], p[3])));
        }
        if let Some(image) = layer("ao.png")? {
            truth.ambient_occlusion = Some(reduced(&image, size, |p| ([p[0]], p[3])));
        }
        if let Some(image) = layer("depth.png")? {
            let covered = |p: &[f32; 4]| f32::from(p[0] > 0.0);
            truth.depth = Some(reduced(&image, size, |p| ([p[0] * DEPTH_RANGE], covered(p))));
        }
        Ok(truth)
    }

    /// The stored layer `name`, if the set has it. A layer that is smaller than its view or has another
    /// aspect ratio is an error.
    fn layer(
        &self,
        source: &CaptureFiles,
        name: &str,
        size: (u32, u32),
        options: &ImportOptions,
    ) -> Result<Option<ImageRgba>, CaptureError> {
        if !self.layers.contains(name) {
            return Ok(None);
        }
        let path = format!("{}/{name}", self.folder);
        let bytes = source.read(&path)?;
        let image = image_file::decode(&bytes, options.limits.max_image_pixels)
            .map_err(|e| CaptureError::image(&path, e))?;
        check_shape(&path, (image.width, image.height), size)?;
        Ok(Some(image))
    }
}

fn fitted(path: &str, image: ImageRgba, size: (u32, u32)) -> Result<ImageRgba, CaptureError> {
    check_shape(path, (image.width, image.height), size)?;
    Ok(image.resized(size.0, size.1))
}

/// A layer may be larger than its view, but must have the same aspect ratio.
fn check_shape(path: &str, layer: (u32, u32), view: (u32, u32)) -> Result<(), CaptureError> {
    let aspect = |(w, h): (u32, u32)| f64::from(w) / f64::from(h);
    if (aspect(layer) / aspect(view) - 1.0).abs() < 0.02 && layer.0 >= view.0 {
        return Ok(());
    }
    let reason = format!("is {}x{}, which does not fit its view of {}x{}", layer.0, layer.1, view.0, view.1);
    Err(CaptureError::image(path, reason))
}

/// The mean over the covered pixels under each new pixel; zero where no pixel is covered. `value` returns a pixel's
/// value and coverage.
fn reduced<const C: usize>(
    image: &ImageRgba,
    (width, height): (u32, u32),
    value: impl Fn(&[f32; 4]) -> ([f32; C], f32),
) -> Plane<C> {
    let (mut weighted, mut covers) = (Vec::new(), Vec::new());
    for pixel in &image.pixels {
        let (v, cover) = value(pixel);
        weighted.push(v.map(|x| x * cover));
        covers.push([cover]);
    }
    let plane = |values| Plane { width: image.width, height: image.height, values };
    let mut out = plane(weighted).resized(width, height);
    let covers = Plane { width: image.width, height: image.height, values: covers }.resized(width, height);
    for (v, [cover]) in out.values.iter_mut().zip(covers.values) {
        *v = if cover > 0.0 { v.map(|x| x / cover) } else { [0.0; C] };
    }
    out
}

/// The maps of the lights that the views' ground truth names, from the capture or from folders around it. A light
/// without a map adds a warning.
///
/// # Errors
/// Names the map that cannot be read or decoded.
pub(super) fn lights(
    source: &CaptureFiles,
    views: &[CaptureView],
    warnings: &mut Vec<String>,
) -> Result<BTreeMap<String, EnvMap>, CaptureError> {
    let names: BTreeSet<&String> = views.iter().flat_map(|v| v.truth.relit.keys()).collect();
    let mut lights = BTreeMap::new();
    for name in names {
        let Some((path, bytes)) = light_file(source, name)? else {
            warnings.push(format!("no environment map was found for light {name:?} of the ground truth"));
            continue;
        };
        let loaded = environment::decode(&bytes).map_err(|e| CaptureError::image(&path, e))?;
        warnings.extend(loaded.warnings.iter().map(|w| format!("{path}: {w}")));
        lights.insert(name.clone(), loaded.map);
    }
    Ok(lights)
}

fn light_file(source: &CaptureFiles, name: &str) -> Result<Option<(String, Vec<u8>)>, CaptureError> {
    const INSIDE: [&str; 2] = ["envmaps", "Environment_Maps"];
    for path in INSIDE.iter().flat_map(|f| [format!("{f}/{name}.hdr"), format!("{f}/{name}.exr")]) {
        if source.contains(&path) {
            return Ok(Some((path.clone(), source.read(&path)?)));
        }
    }
    const BESIDE: [&str; 5] = [
        "../../envmaps",
        "../envmaps",
        "../Environment_Maps",
        "../Environment_Maps/high_res_envmaps_1k",
        "../Environment_Maps/high_res_envmaps_2k",
    ];
    let beside = BESIDE.iter().map(|f| format!("{f}/{name}.hdr"));
    Ok(beside.filter_map(|path| Some((path.clone(), source.read_beside(&path)?))).next())
}
