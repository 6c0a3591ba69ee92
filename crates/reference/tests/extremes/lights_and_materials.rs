//! Materials at their limits, grazing views, and lights from black to 1e30.

use std::sync::Arc;

use relume_compare::largest_difference;
use relume_engine::Device;
use relume_scene::{DiffuseForm, EnvMap, EnvMapError, Field, NormalForm, VisibilityForm};
use relume_spec::rendering::{Output, Tier};
use relume_train::render::Renderer;

use super::harness::{ENV, Suite, TIGHT, in_front, model, on_each_engine, set};

on_each_engine! {
    normals_perpendicular_to_the_view_match,
    zero_and_extreme_normals_match,
    extreme_roughness_and_metalness_match,
    extreme_sheen_matches,
    learned_environments_from_black_to_1e18_match,
    frames_are_linear_in_the_light,
}

fn normals_perpendicular_to_the_view_match(device: &Device) {
    let mut suite = Suite::on(device);
    let mut model = model(3, 30);
    model.shading.normal = NormalForm::Free;
    (0..3).for_each(|i| model.gaussians.row_mut(Field::Mean, i)[0] = 0.0);
    set(&mut model, Field::Normal, &[[0.0, 0.0, 1.0]; 3]);
    // The only pixel looks exactly along +y: n.v is exactly 0.
    suite.check("n.v = 0", &model, &in_front((1, 1)), TIGHT);
    set(&mut model, Field::Normal, &[[0.0, 1e-5, 1.0]; 3]);
    suite.check("n.v = -1e-5", &model, &in_front((1, 1)), TIGHT);
    suite.finish();
}

fn zero_and_extreme_normals_match(device: &Device) {
    let mut suite = Suite::on(device);
    let mut model = model(4, 31);
    model.shading.normal = NormalForm::Free;
    set(&mut model, Field::Normal, &[[0.0; 3], [-0.0; 3], [1e-30, 0.0, 0.0], [1e18, -1e18, 0.0]]);
    suite.alike("zero normals", &model, &in_front((16, 12)), 1e-4);
    suite.finish();
}

fn extreme_roughness_and_metalness_match(device: &Device) {
    let mut suite = Suite::on(device);
    for visibility in [VisibilityForm::Linear, VisibilityForm::Sigmoid, VisibilityForm::Off] {
        for (rough, metal) in [(-1e4, -1e4), (-1e4, 1e4), (1e4, -1e4), (1e4, 1e4), (-20.0, 20.0)] {
            let mut model = model(8, 32);
            model.shading.visibility = visibility;
            if visibility == VisibilityForm::Sigmoid {
                model.shading.diffuse = DiffuseForm::AmbientOcclusion;
            }
            model.gaussians.field_mut(Field::RoughLogit).fill(rough);
            model.gaussians.field_mut(Field::MetalLogit).fill(metal);
            suite.check(&format!("{visibility:?} {rough} {metal}"), &model, &in_front((16, 12)), TIGHT);
        }
    }
    suite.finish();
}

fn extreme_sheen_matches(device: &Device) {
    let mut suite = Suite::on(device);
    for sheen in [-1e30, -3.0, 3.0, 1e30] {
        let mut model = model(8, 35);
        model.gaussians.field_mut(Field::Sheen).fill(sheen);
        suite.check(&format!("sheen {sheen:e}"), &model, &in_front((16, 12)), TIGHT);
    }
    suite.finish();
}

fn learned_environments_from_black_to_1e18_match(device: &Device) {
    let mut suite = Suite::on(device);
    for texel in [-1e4f32, 6e4, 1e18] {
        let mut model = model(8, 33);
        if texel < 0.0 {
            model.env_raw.fill([texel; 3]);
        } else {
            model.env_raw[11] = [texel; 3];
        }
        // Most of the image is at its white limit.
        suite.check(&format!("texel {texel:e}"), &model, &in_front((16, 12)), TIGHT);
    }
    suite.finish();
}

fn measured_light(texel: f32) -> EnvMap {
    let mut texels = vec![[0.0f32; 3]; ENV.0 * ENV.1];
    texels[11] = [texel; 3];
    EnvMap::new(ENV.0, ENV.1, texels).unwrap().0
}

fn frames_are_linear_in_the_light(device: &Device) {
    let renderer = Renderer::on(Arc::new(model(8, 34)), device).unwrap();
    let rgb = |map: &EnvMap| {
        let light = renderer.prepare_light(map).unwrap();
        let frame = renderer.render(&in_front((16, 12)), &light, Tier::Standard, &[Output::Rgb]).unwrap();
        frame.planes[&Output::Rgb].clone()
    };
    assert!(rgb(&measured_light(0.0)).iter().all(|v| *v == 0.0), "no light, no picture: {}", device.name());
    let one = rgb(&measured_light(1.0));
    let most = one.iter().fold(0.0f32, |m, v| m.max(*v));
    assert!(most > 1e-3, "the control: light makes a picture");
    for gain in [6e4f32, 1e30] {
        let scaled: Vec<f32> = rgb(&measured_light(gain)).iter().map(|v| v / gain).collect();
        let error = largest_difference(&scaled, &one) / f64::from(most);
        assert!(error < 1e-5, "{} {gain:e}: {error:e}", device.name());
    }
}

#[test]
fn non_finite_texels_are_refused_and_negative_ones_are_counted() {
    let with = |value: f32| {
        let mut texels = vec![[0.5f32; 3]; 8];
        texels[6][1] = value;
        EnvMap::new(4, 2, texels)
    };
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let error = with(value).unwrap_err();
        assert_eq!(error, EnvMapError::NotFinite { x: 2, y: 1 });
        assert!(error.to_string().contains("column 2, row 1"), "{error}");
    }
    let error = with(2e30).unwrap_err().to_string();
    assert!(error.contains("column 2, row 1") && error.contains("1e30"), "{error}");
    let (map, stats) = with(-3.0).unwrap();
    assert_eq!((map.texels()[6][1], stats.clamped_negatives), (0.0, 1));
    assert_eq!(with(1e30).unwrap().1.clamped_negatives, 0, "the control");
}
