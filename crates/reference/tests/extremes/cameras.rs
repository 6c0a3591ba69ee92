//! Cameras at the poles, far away, and with fields of view from 0.001 to 179 degrees.

use std::sync::Arc;

use glam::{DMat4, DVec3};
use relume_compare::largest_difference;
use relume_engine::Device;
use relume_scene::{Camera, EnvMap, Field};
use relume_spec::rendering::{Output, Tier};
use relume_train::render::Renderer;

use super::harness::{Suite, TIGHT, in_front, looking_from, model, on_each_engine, set};

on_each_engine! {
    views_along_the_polar_axis_match,
    cameras_a_million_units_away_match,
    capture_a_million_units_from_the_origin_renders_equally,
    fields_of_view_up_to_179_degrees_match,
}

fn views_along_the_polar_axis_match(device: &Device) {
    let mut suite = Suite::on(device);
    let mut model = model(8, 20);
    // Exactly above and below the camera's axis: directions are exactly +z and -z.
    set(&mut model, Field::Mean, &[[0.0, 0.0, 0.3], [0.0, 0.0, -0.4]]);
    for z in [3.0, -3.0] {
        suite.check(&format!("from z = {z}"), &model, &looking_from([0.0, 0.0, z], (16, 12)), TIGHT);
    }
    suite.finish();
}

fn cameras_a_million_units_away_match(device: &Device) {
    let mut suite = Suite::on(device);
    let model = model(8, 21);
    for distance in [1e3, 1e6] {
        let eye = DVec3::new(0.6, -0.64, 0.48) * distance;
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 2.0 / distance, (16, 12)).unwrap();
        // The depths of all Gaussians differ by a millionth, the last digit of f32; the depth key keeps more digits.
        suite.check(&format!("{distance:e} away"), &model, &camera, TIGHT);
    }
    suite.finish();
}

fn capture_a_million_units_from_the_origin_renders_equally(device: &Device) {
    let offset = DVec3::new(1e6, -2e6, 5e5);
    let light = EnvMap::from_fn(8, 4, |d| [0.3 + d.x.max(0.0) as f32, 0.5, 0.6]);
    let render = |shift: DVec3, seed| {
        let mut model = model(8, seed);
        model.world_offset = -shift;
        let renderer = Renderer::on(Arc::new(model), device).unwrap();
        let light = renderer.prepare_light(&light).unwrap();
        let eye = DVec3::new(0.0, -3.0, 0.5) + shift;
        let camera = Camera::look_at(eye, shift, DVec3::Z, 0.6, (16, 12)).unwrap();
        renderer.render(&camera, &light, Tier::Standard, &[Output::Rgb]).unwrap().planes[&Output::Rgb].clone()
    };
    let (near, far) = (render(DVec3::ZERO, 22), render(offset, 22));
    let error = largest_difference(&near, &far);
    assert!(error < 1e-5, "{} {error:e}", device.name());
    let control = largest_difference(&near, &render(offset, 23));
    assert!(control.is_finite() && control > 1e-2, "the control: another model is another picture");
}

fn fields_of_view_up_to_179_degrees_match(device: &Device) {
    let mut suite = Suite::on(device);
    for degrees in [1e-3f64, 0.1, 90.0, 170.0, 179.0] {
        let mut model = model(8, 24);
        // As large as the width of the view.
        let width = (3.0 * (0.5 * degrees.to_radians()).tan()) as f32;
        model.gaussians.field_mut(Field::Mean).iter_mut().for_each(|v| *v *= width);
        (0..8).for_each(|i| model.gaussians.row_mut(Field::Mean, i)[1] = 0.1 * i as f32);
        model.gaussians.field_mut(Field::LogScale).iter_mut().for_each(|v| *v += width.ln());
        let fov = degrees.to_radians();
        let camera =
            Camera::look_at(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, DVec3::Z, fov, (16, 12)).unwrap();
        suite.check(&format!("{degrees} degrees"), &model, &camera, TIGHT);
    }
    suite.finish();
}

#[test]
fn invalid_cameras_are_refused_by_field() {
    let (eye, size) = (DVec3::new(0.0, -3.0, 0.0), (16, 12));
    let look = |fov| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, fov, size).unwrap_err().field;
    for fov in [0.0, -1.0, std::f64::consts::PI, f64::NAN, f64::INFINITY] {
        assert_eq!(look(fov), "fov_y");
    }
    assert_eq!(look(1e-200), "fx", "a focal length that no f32 holds");
    assert_eq!(Camera::look_at(eye, eye, DVec3::Z, 0.6, size).unwrap_err().field, "target");
    let good = in_front(size);
    let spoilt: [(&str, Camera); 9] = [
        ("width,height", Camera { width: 0, ..good }),
        ("width,height", Camera { height: 0, ..good }),
        ("fx", Camera { fx: 0.0, ..good }),
        ("fx", Camera { fx: 1e300, ..good }),
        ("fy", Camera { fy: -1.0, ..good }),
        ("fy", Camera { fy: f64::NAN, ..good }),
        ("cx", Camera { cx: f64::INFINITY, ..good }),
        ("cy", Camera { cy: 1e200, ..good }),
        ("transform_matrix", Camera { translation: DVec3::new(0.0, f64::NAN, 0.0), ..good }),
    ];
    for (field, camera) in spoilt {
        assert_eq!(camera.validated().unwrap_err().field, field);
    }
    let pose = |m: DMat4| Camera::from_opengl(&m, size, (20.0, 20.0), (8.0, 6.0));
    assert_eq!(pose(DMat4::from_scale(DVec3::new(1.0, 1.0, 0.0))).unwrap_err().field, "transform_matrix");
    assert!(pose(DMat4::IDENTITY).is_ok() && good.validated().is_ok(), "the control");
}
