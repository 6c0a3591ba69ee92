//! Light matrices: weighted sums of their frames against frames under the weighted light.

use std::sync::Arc;

use exr::prelude::{ReadChannels as _, ReadLayers as _};

use relume_compare::rms_difference;
use relume_scene::light::{LightLobes, MatrixWeights, dominant_lights};
use relume_scene::{
    DiffuseForm, EnvMap, Illumination, IndirectForm, LightSplit, Model, ShadeAt, ShadingOptions, SplitLight,
    VisibilityForm,
};
use relume_spec::rendering::{ColourDepth, Output, Tier};
use relume_train::render::{FrameMetadata, Renderer};

use crate::tiers::{camera, sun, table};

const SIZE: u32 = 48;

fn renderer(options: ShadingOptions) -> Renderer {
    Renderer::new(Arc::new(Model { shading: options, ..Model::clone(&table()) }))
}

/// The frame under `light`, and the weighted sum of the frames of a matrix, linear RGB.
fn both(
    renderer: &Renderer,
    light: &Illumination,
    lobes: &LightLobes,
    (suns, weights): (Vec<SplitLight>, &[[f32; 3]]),
) -> [Vec<f32>; 2] {
    let prepared = renderer.prepare_light(light).unwrap();
    let frame = renderer.render(&camera(SIZE), &prepared, Tier::Standard, &[Output::Rgb]).unwrap();
    let lights = renderer.matrix_lights(lobes, suns);
    let matrix = renderer.light_matrix(&camera(SIZE), &lights).unwrap();
    [frame.planes[&Output::Rgb].clone(), matrix.weighted_sum(weights).into_flattened()]
}

/// Root mean square difference over that of the first from 0.
fn relative([expected, found]: &[Vec<f32>; 2]) -> f64 {
    rms_difference(found, expected) / rms_difference(expected, &vec![0.0; expected.len()])
}

/// Weights of a smooth light.
fn smooth(lobes: &LightLobes) -> Vec<[f32; 3]> {
    let of = |d: &glam::DVec3| [1.2 + d.z, 1.0 + 0.5 * d.x, 0.8 + 0.6 * d.y * d.z].map(|v| v as f32);
    lobes.directions().iter().map(of).collect()
}

/// The light without separately shaded lights.
fn whole(environment: EnvMap) -> Illumination {
    Illumination { environment, split: Some(LightSplit::default()) }
}

#[test]
fn weighted_sum_of_lobes_is_the_frame_under_their_light() {
    let lobes = LightLobes::new(45);
    let weights = smooth(&lobes);
    let mut permuted = weights.clone();
    permuted.reverse();
    let light: Illumination = lobes.combined(&weights).into();
    let usual = ShadingOptions::default();
    for options in [
        usual,
        ShadingOptions { indirect: IndirectForm::Off, ..usual },
        ShadingOptions { indirect: IndirectForm::Learned, diffuse: DiffuseForm::AmbientOcclusion, ..usual },
        ShadingOptions { visibility: VisibilityForm::Off, ..usual },
    ] {
        let renderer = renderer(options);
        let error = relative(&both(&renderer, &light, &lobes, (Vec::new(), &weights)));
        println!("{options:?}: {error:.2e}");
        assert!(error < 1e-5, "{options:?}: {error}");
        let wrong = relative(&both(&renderer, &light, &lobes, (Vec::new(), &permuted)));
        assert!(wrong > 0.05, "the control: {wrong}");
    }
}

#[test]
fn models_shaded_in_the_pixel_have_the_matrix_of_their_preview() {
    let lobes = LightLobes::new(20);
    let weights = smooth(&lobes);
    let renderer = renderer(ShadingOptions { shade_at: ShadeAt::Pixel, ..ShadingOptions::default() });
    let light = renderer.prepare_light(lobes.combined(&weights)).unwrap();
    let frame = |tier| {
        let frame = renderer.render(&camera(SIZE), &light, tier, &[Output::Rgb]).unwrap();
        frame.planes[&Output::Rgb].clone()
    };
    let lights = renderer.matrix_lights(&lobes, Vec::new());
    let sum = renderer.light_matrix(&camera(SIZE), &lights).unwrap().weighted_sum(&weights).into_flattened();
    assert!(relative(&[frame(Tier::Preview), sum.clone()]) < 1e-5);
    assert!(relative(&[frame(Tier::Standard), sum]) > 1e-4, "the control");
}

#[test]
fn a_sun_has_its_own_frame() {
    let lobes = LightLobes::new(30);
    let renderer = renderer(ShadingOptions::default());
    let weights = smooth(&lobes);
    let map = lobes.combined(&weights);
    let spot = sun();
    let brightest = spot.texels().iter().map(|t| t[0]).fold(0.0, f32::max);
    let mut texels = map.resampled(256, 128).texels().to_vec();
    let towards = dominant_lights(&spot.into()).1[0].direction.map(f64::from);
    let [u, v] = relume_scene::direction_to_uv(glam::DVec3::from_array(towards));
    texels[(v * 128.0) as usize * 256 + (u * 256.0) as usize] = [8.0 * brightest; 3];
    let light: Illumination = EnvMap::new(256, 128, texels).unwrap().0.into();
    let suns: Vec<SplitLight> = dominant_lights(&light).1.iter().map(SplitLight::from).collect();
    assert_eq!(suns.len(), 1);
    let found = MatrixWeights::of(&light, &lobes, &suns);
    let error = relative(&both(&renderer, &light, &lobes, (suns, &found.columns())));
    println!("with the sun as its own part: {error:.2e}");
    assert!(error < 1e-4, "{error}");
    let without = MatrixWeights::of(&light, &lobes, &[]);
    let soft = relative(&both(&renderer, &light, &lobes, (Vec::new(), &without.columns())));
    assert!(soft > 0.03, "the control: a lobe casts a soft shadow, {soft}");
}

#[test]
fn frame_of_a_lobe_is_the_frame_under_its_map() {
    let lobes = LightLobes::new(12);
    // Without light from other surfaces no irradiance of this model is clamped.
    let renderer = renderer(ShadingOptions { indirect: IndirectForm::Off, ..ShadingOptions::default() });
    let one = |k: usize| -> Vec<[f32; 3]> { (0..12).map(|i| [f32::from(u8::from(i == k)); 3]).collect() };
    for k in 0..12 {
        let light = whole(lobes.combined(&one(k)));
        let error = relative(&both(&renderer, &light, &lobes, (Vec::new(), &one(k))));
        assert!(error < 1e-5, "{k}: {error}");
        let other = relative(&both(&renderer, &light, &lobes, (Vec::new(), &one((k + 1) % 12))));
        assert!(other > 0.1, "the control: {other}");
    }
}

#[test]
fn only_clamped_irradiance_separates_a_lobe_from_its_frame() {
    let lobes = LightLobes::new(12);
    let renderer = renderer(ShadingOptions::default());
    let one = |k: usize| -> Vec<[f32; 3]> { (0..12).map(|i| [f32::from(u8::from(i == k)); 3]).collect() };
    let all: Vec<[Vec<f32>; 2]> = (0..12)
        .map(|k| both(&renderer, &whole(lobes.combined(&one(k))), &lobes, (Vec::new(), &one(k))))
        .collect();
    let worst = all.iter().map(relative).fold(0.0, f64::max);
    println!("worst error of a lobe with clamped irradiance: {worst:.2e}");
    assert!(worst > 1e-3, "the clamp binds: {worst}");
    let pixels = || all.iter().flat_map(|[frame, lobe]| frame.iter().zip(lobe));
    let least = all.iter().flat_map(|[_, lobe]| lobe).fold(f32::INFINITY, |least, value| least.min(*value));
    assert!(least < -1e-5, "lobes are negative where the frame is clamped: {least}");
    // The clamp only adds light to the surface itself; of other surfaces it is the light that they reflect.
    let lost = pixels().map(|(frame, lobe)| f64::from(frame - lobe)).sum::<f64>();
    assert!(lost > 0.0, "the clamp adds light: {lost}");
}

#[test]
fn file_of_a_matrix_has_its_frames_for_any_number_of_threads() {
    let lobes = LightLobes::new(3);
    let renderer = renderer(ShadingOptions::default());
    let suns = vec![SplitLight { direction: [0.0, 0.6, 0.8], radius: 0.02 }];
    let lights = renderer.matrix_lights(&lobes, suns);
    let metadata = FrameMetadata { model: "table".to_owned(), ..FrameMetadata::default() };
    let file = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut out = std::io::Cursor::new(Vec::new());
        let matrix = renderer.light_matrix(&camera(SIZE), &lights).unwrap();
        pool.install(|| matrix.write(&mut out, ColourDepth::Full, &metadata, &|_| true)).unwrap();
        out.into_inner()
    };
    let bytes = file(1);
    assert!(file(3) == bytes);
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level();
    let reader = reader.all_channels().all_layers().all_attributes();
    let image = reader.from_buffered(std::io::Cursor::new(&bytes)).unwrap();
    assert_eq!(image.layer_data.len(), 5, "alpha, three lobes, a sun");
    let matrix = renderer.light_matrix(&camera(SIZE), &lights).unwrap();
    for k in 0..4 {
        let mut weights = [[0.0; 3]; 4];
        weights[k] = [1.0; 3];
        let expected = matrix.weighted_sum(&weights);
        let channels = &image.layer_data[k + 1].channel_data.list;
        for (c, channel) in channels.iter().rev().enumerate() {
            let found: Vec<f32> = channel.sample_data.values_as_f32().collect();
            let wanted: Vec<f32> = expected.iter().map(|pixel| pixel[c]).collect();
            assert_eq!(found, wanted, "{}", channel.name);
            assert!(found.iter().any(|v| *v > 0.0));
        }
    }
}
