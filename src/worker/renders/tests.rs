use super::*;
use relume_scene::{Field, Gaussians, Model};
use relume_spec::rendering::Tier;
use relume_train::render::Orbit;

fn render(cache: &RenderCache, task: &RenderTask) -> Result<Frame, RenderFailure> {
    cache.scene(task, &Device::Cpu, &|| true)?.render(task, || Ok(()))
}

/// A model file with three opaque balls that see the whole sky.
fn model(folder: &tempfile::TempDir) -> ModelSource {
    let mut gaussians = Gaussians::zeroed(3, 1, 2, 0);
    for i in 0..3 {
        gaussians.row_mut(Field::Mean, i).copy_from_slice(&[i as f32 * 0.4 - 0.4, 0.1, 0.0]);
        gaussians.row_mut(Field::LogScale, i).fill(0.2f32.ln());
        gaussians.row_mut(Field::Quaternion, i)[0] = 1.0;
        gaussians.row_mut(Field::OpacityLogit, i)[0] = 4.0;
        gaussians.row_mut(Field::Visibility, i)[0] = relume_scene::light::UNOCCLUDED_SH0;
    }
    let model = Model::new(gaussians, vec![[0.5; 3]], vec![[0.0; 3]; 8], (4, 2));
    let path = folder.path().join("model.safetensors");
    std::fs::write(&path, model_file::encode(&model).unwrap()).unwrap();
    ModelSource::new("model".into(), ModelContent::File(path))
}

fn task(model: &ModelSource, tier: Tier, exposure_ev: f64) -> RenderTask {
    RenderTask {
        model: model.clone(),
        light: LightSource::Builtin("sunset".to_owned()),
        rotation_deg: 30.0,
        exposure_ev,
        shows_environment: false,
        viewpoint: Viewpoint::Orbit(Orbit { azimuth_deg: Some(10.0), elevation_deg: Some(20.0), size: 24 }),
        quality: Quality { samples: 4, ..tier.into() },
        outputs: vec![Output::Rgb, Output::Diffuse, Output::Specular, Output::Albedo, Output::Depth],
        ground_height: None,
        lamps: Vec::new(),
        neighbours: Neighbours::default(),
    }
}

#[test]
fn exposure_scales_the_frame_without_preparing_a_new_light() {
    let folder = tempfile::TempDir::new().unwrap();
    let model = model(&folder);
    let cache = RenderCache::new(1, 4);
    for tier in Tier::ALL {
        let at = |ev| render(&cache, &task(&model, tier, ev)).unwrap();
        let (plain, bright) = (at(0.0), at(2.0));
        for (output, plane) in &plain.planes {
            let lit = matches!(output, Output::Rgb | Output::Diffuse | Output::Specular);
            assert!(!lit || plane.iter().any(|v| *v > 0.01), "{output:?} shows something");
            let expected: Vec<f32> = plane.iter().map(|v| if lit { v * 4.0 } else { *v }).collect();
            assert_eq!(bright.planes[output], expected, "{tier:?} {output:?}");
        }
        assert_eq!(lock(&cache.lights).len(), 1);
    }
}

#[test]
fn a_scaled_frame_equals_a_frame_under_a_scaled_light() {
    let folder = tempfile::TempDir::new().unwrap();
    let model = model(&folder);
    for tier in Tier::ALL {
        let task = task(&model, tier, 1.5);
        let frame = render(&RenderCache::new(1, 1), &task).unwrap();
        let renderer = load(&model, &Device::Cpu).unwrap();
        let map = task.light.map().unwrap().unwrap().rotated_and_scaled(30.0, 1.5f32.exp2());
        let camera = task.viewpoint.camera(renderer.model()).unwrap();
        let light = renderer.prepare_light(&map).unwrap();
        let truth = renderer.render(&camera, &light, task.quality, &task.outputs).unwrap();
        for (a, b) in frame.planes[&Output::Rgb].iter().zip(&truth.planes[&Output::Rgb]) {
            assert!((a - b).abs() <= 1e-4 + 1e-3 * b.abs(), "{tier:?}: {a} and {b}");
        }
    }
}

#[test]
fn background_environment_is_rotated_and_exposed_like_the_light() {
    let folder = tempfile::TempDir::new().unwrap();
    let model = model(&folder);
    let at = |shows_environment, exposure_ev| {
        let task = RenderTask { shows_environment, ..task(&model, Tier::Preview, exposure_ev) };
        render(&RenderCache::new(1, 1), &task).unwrap()
    };
    let (without, with, bright) = (at(false, 0.0), at(true, 0.0), at(true, 1.0));
    let task = task(&model, Tier::Preview, 0.0);
    let camera = task.viewpoint.camera(load(&model, &Device::Cpu).unwrap().model()).unwrap();
    let map = task.light.map().unwrap().unwrap().rotated_and_scaled(30.0, 1.0);
    // A corner without a ball.
    assert_eq!(without.planes[&Output::Rgb][..3], [0.0; 3]);
    for (k, expected) in map.sample(camera.ray(0, 0)).into_iter().enumerate() {
        let (seen, brighter) = (with.planes[&Output::Rgb][k], bright.planes[&Output::Rgb][k]);
        assert!((seen - expected).abs() < 0.05 * expected, "{seen}, not {expected}");
        assert_eq!(brighter, seen * 2.0);
    }
    assert_eq!(with.planes[&Output::Alpha], without.planes[&Output::Alpha]);
}

#[test]
fn abandoned_render_stops_before_the_next_stage() {
    let folder = tempfile::TempDir::new().unwrap();
    let task = task(&model(&folder), Tier::Preview, 0.0);
    for (asked, models, lights) in [(1, 0, 0), (2, 1, 0), (3, 1, 1)] {
        let cache = RenderCache::new(1, 1);
        let left = std::cell::Cell::new(asked);
        let is_wanted = || left.replace(left.get() - 1) > 1;
        let ended = cache.scene(&task, &Device::Cpu, &is_wanted);
        assert!(matches!(ended, Err(RenderFailure::Abandoned)));
        assert_eq!((lock(&cache.models).len(), lock(&cache.lights).len()), (models, lights));
    }
}

#[test]
fn abandoned_expensive_frame_stops_between_bands() {
    let folder = tempfile::TempDir::new().unwrap();
    let orbit = Orbit { azimuth_deg: Some(10.0), elevation_deg: Some(20.0), size: 40 };
    let quality = Quality::monte_carlo(Quality::MAX_SAMPLES);
    let task = RenderTask {
        viewpoint: Viewpoint::Orbit(orbit),
        quality,
        ..task(&model(&folder), Tier::MonteCarlo, 0.0)
    };
    let scene = RenderCache::new(1, 1).scene(&task, &Device::Cpu, &|| true).unwrap();
    let mut seams = 0;
    let ended = scene.render(&task, || {
        seams += 1;
        Err(RenderFailure::Abandoned)
    });
    assert_eq!((ended, seams), (Err(RenderFailure::Abandoned), 1));
    let mut seams = 0;
    let cheap = RenderTask { quality: Tier::High.into(), ..task };
    let whole = scene.render(&cheap, || {
        seams += 1;
        Ok(())
    });
    assert_eq!((whole.unwrap().height, seams), (40, 0), "a cheap frame has one band");
}

#[test]
fn rendering_a_deleted_model_or_environment_reports_gone() {
    let folder = tempfile::TempDir::new().unwrap();
    let model = model(&folder);
    let render = |task: &RenderTask| render(&RenderCache::new(1, 1), task).map(drop);
    let mut lit = task(&model, Tier::Preview, 0.0);
    lit.light = LightSource::Stored {
        sha256: "00".to_owned(),
        path: folder.path().join("no-map"),
        maps: DecodedMaps::default(),
    };
    assert_eq!(render(&lit), Err(RenderFailure::Gone { what: "environment", id: "00".to_owned() }));
    let task = task(&model, Tier::Preview, 0.0);
    render(&task).unwrap();
    let ModelContent::File(path) = &model.content else { panic!("the model is a file") };
    std::fs::remove_file(path).unwrap();
    assert_eq!(render(&task), Err(RenderFailure::Gone { what: "model", id: "model".to_owned() }));
    std::fs::create_dir(path).unwrap();
    assert!(
        matches!(render(&task), Err(RenderFailure::Internal(_))),
        "an unreadable file is an internal error"
    );
}

#[test]
fn viewer_and_frames_share_one_prepared_light() {
    let folder = tempfile::TempDir::new().unwrap();
    let task = task(&model(&folder), Tier::Standard, 0.0);
    let RenderTask { model, light, rotation_deg, .. } = task.clone();
    let cache = RenderCache::new(1, 2);
    let frame = cache.scene(&task, &Device::Cpu, &|| true).unwrap();
    let asked = LightTask { model, light, rotation_deg, with_map: false };
    let lit = cache.lit_model(&asked, &Device::Cpu, &|| true).unwrap();
    assert!(Arc::ptr_eq(&lit.light, &frame.lit.light) && lock(&cache.lights).len() == 1);
    assert!(lit.stream(true).len() > lit.stream(false).len() + 6 * 2 * 64 * 32);
    let other = LightTask { rotation_deg: 31.0, ..asked };
    let nobody = cache.lit_model(&other, &Device::Cpu, &|| false);
    assert!(matches!(nobody, Err(RenderFailure::Abandoned)) && lock(&cache.lights).len() == 1);
    cache.lit_model(&other, &Device::Cpu, &|| true).unwrap();
    assert_eq!(lock(&cache.lights).len(), 2, "the control: a caller waits for it");
}

/// A model whose file is a pipe, so that loading blocks until the test writes to it.
#[cfg(target_os = "linux")]
#[test]
fn a_ready_model_renders_while_another_one_loads() {
    use std::io::Write as _;
    use std::time::Duration;

    let folder = tempfile::TempDir::new().unwrap();
    let ready = model(&folder);
    let ModelContent::File(file) = &ready.content else { panic!("a file") };
    let bytes = std::fs::read(file).unwrap();
    let pipe = folder.path().join("pipe");
    let mode = rustix::fs::Mode::from_raw_mode(0o600);
    rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, mode, 0).unwrap();
    let loading = ModelSource::new("loading".into(), ModelContent::File(pipe.clone()));
    let cache = Arc::new(RenderCache::new(2, 2));
    let task_of = |model: &ModelSource| task(model, Tier::Preview, 0.0);
    let first = render(&cache, &task_of(&ready)).unwrap();

    let (slow_cache, slow_task) = (cache.clone(), task_of(&loading));
    let slow = std::thread::spawn(move || render(&slow_cache, &slow_task));
    // Opening a pipe returns when the other side has opened it, so the other thread is now loading.
    let mut writer = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
    let (done, frames) = std::sync::mpsc::channel();
    let (quick_cache, quick_task) = (cache.clone(), task_of(&ready));
    std::thread::spawn(move || done.send(render(&quick_cache, &quick_task)));
    let frame =
        frames.recv_timeout(Duration::from_secs(60)).expect("the ready model must not wait for the other");
    assert_eq!(frame.unwrap().planes, first.planes);
    writer.write_all(&bytes).unwrap();
    drop(writer);
    assert_eq!(slow.join().unwrap().unwrap().planes, first.planes);
}

#[test]
fn a_model_that_fails_to_load_is_not_cached() {
    let folder = tempfile::TempDir::new().unwrap();
    let ready = model(&folder);
    let missing = ModelSource::new("missing".into(), ModelContent::File(folder.path().join("none")));
    let cache = RenderCache::new(2, 2);
    render(&cache, &task(&ready, Tier::Preview, 0.0)).unwrap();
    assert!(render(&cache, &task(&missing, Tier::Preview, 0.0)).is_err());
    assert_eq!(lock(&cache.models).len(), 1);
}

#[test]
fn an_evicted_model_takes_its_lights_with_it() {
    let folder = tempfile::TempDir::new().unwrap();
    let first = model(&folder);
    let second = replaced(&folder, &first);
    let cache = RenderCache::new(1, 4);
    let cached_models = || {
        let names =
            lock(&cache.lights).iter().map(|(key, _)| key.0.0.file_name().unwrap().to_owned()).collect();
        let names: Vec<std::ffi::OsString> = names;
        names
    };
    render(&cache, &task(&first, Tier::Preview, 0.0)).unwrap();
    assert_eq!(cached_models(), ["model.safetensors"], "the control: the light of a cached model stays");
    render(&cache, &task(&second, Tier::Preview, 0.0)).unwrap();
    assert_eq!(cached_models(), ["replaced.safetensors"]);
}

/// The same model with half of its albedo, in another file.
fn replaced(folder: &tempfile::TempDir, source: &ModelSource) -> ModelSource {
    let ModelContent::File(path) = &source.content else { panic!("a file") };
    let mut model = model_file::decode(&std::fs::read(path).unwrap()).unwrap();
    model.prototypes[0] = [0.25; 3];
    let path = folder.path().join("replaced.safetensors");
    std::fs::write(&path, model_file::encode(&model).unwrap()).unwrap();
    ModelSource { content: ModelContent::File(path), ..source.clone() }
}

#[test]
fn a_model_with_a_replaced_file_is_loaded_again() {
    let folder = tempfile::TempDir::new().unwrap();
    let first = model(&folder);
    let cache = RenderCache::new(2, 4);
    let frame = |source: &ModelSource| render(&cache, &task(source, Tier::Preview, 0.0)).unwrap();
    let before = frame(&first);
    assert_ne!(frame(&replaced(&folder, &first)), before);
    assert_eq!(frame(&first), before, "the control");
}
