//! Mutated user files: no reader panics. `RELUME_FUZZ_CASES` is the number of cases per reader.

mod mutate;
mod seeds;

use std::panic::AssertUnwindSafe;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume_api::jobs::{JobChange, NewJob};
use relume_api::keys::NewKey;
use relume_api::metadata::{MetadataChange, parse_labels};
use relume_api::renders::RenderRequest;
use relume_api::uploads::CaptureSource;
use relume_api::webhooks::{NewWebhook, WebhookChange};
use relume_api::{Problem, TenantId};
use relume_capture::formats::{environment, exr_image, image_file, model_file, ply_points, splat_import};
use relume_capture::{ImportLimits, ImportOptions};
use relume_fixtures::cases_or;
use relume_spec::training::{TrainConfig, UpAxis};
use reqwest::{Method, header};
use tempfile::NamedTempFile;

use mutate::mutated;
use relume_fixtures::small_set::{Files, gzip, tar, zip};

/// Default number of cases per reader.
const CASES: u32 = 500;
const SEED: u64 = 4;

fn cases() -> u64 {
    cases_or(CASES).into()
}

/// Calls `read` with cases made from `seeds`. If it panics, reports the case and the path of its bytes.
fn fuzz(name: &str, seeds: &[Vec<u8>], read: impl Fn(&[u8])) {
    for seed in seeds {
        read(seed);
    }
    let make = |random: &mut ChaCha8Rng| mutated(&seeds[random.random_range(0..seeds.len())], seeds, random);
    run(name, make, read);
}

fn run(name: &str, make: impl Fn(&mut ChaCha8Rng) -> Vec<u8>, read: impl Fn(&[u8])) {
    let mut slowest = Duration::ZERO;
    for case in 0..cases() {
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        random.set_stream(case);
        let bytes = make(&mut random);
        let began = Instant::now();
        if std::panic::catch_unwind(AssertUnwindSafe(|| read(&bytes))).is_err() {
            let path = std::env::temp_dir().join(format!("relume-fuzz-{name}-{case}"));
            std::fs::write(&path, &bytes).unwrap();
            panic!("{name} panicked at case {case}: {}", path.display());
        }
        slowest = slowest.max(began.elapsed());
    }
    println!("{name}: {} cases, the slowest in {} ms", cases(), slowest.as_millis());
}

#[test]
fn fuzzing_detects_a_reader_that_panics() {
    let seeds = seeds::clouds();
    let careless = |bytes: &[u8]| assert!(seeds.iter().any(|seed| seed == bytes), "these are changed");
    let found = std::panic::catch_unwind(|| fuzz("the-control", &seeds, careless)).unwrap_err();
    let said = found.downcast_ref::<String>().unwrap();
    let path = said.rsplit(": ").next().unwrap();
    assert!(!seeds.contains(&std::fs::read(path).unwrap()), "{said}");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn mutated_images_cause_no_panic() {
    fuzz("pictures", &seeds::images(), |bytes| {
        let _ = image_file::dimensions(bytes);
        let _ = image_file::decode(bytes, 1 << 16);
        let _ = image_file::decode_photograph(bytes, 1 << 16, |size| size);
    });
}

#[test]
fn mutated_environments_cause_no_panic() {
    fuzz("environments", &seeds::environments(), |bytes| {
        let _ = exr_image::dimensions(bytes);
        let _ = exr_image::decoded_bytes(bytes);
        // As in the server, files that would take too much memory are not decoded.
        if environment::decoding_bytes(bytes).is_ok_and(|count| count < 1 << 24) {
            let _ = environment::decode(bytes);
        }
    });
}

#[test]
fn mutated_models_cause_no_panic() {
    fuzz("models", &seeds::models(), |bytes| {
        if let Ok(model) = model_file::decode(bytes) {
            let _ = model.check();
        }
    });
}

#[test]
fn mutated_point_clouds_cause_no_panic() {
    fuzz("point-clouds", &seeds::clouds(), |bytes| drop(ply_points::read_points(bytes, 1000)));
}

#[test]
fn mutated_splat_files_cause_no_panic() {
    fuzz("splats", &seeds::splats(), |bytes| drop(splat_import::decode(bytes)));
}

#[test]
fn mutated_json_bodies_cause_no_panic() {
    fuzz("bodies", &seeds::bodies(), |bytes| {
        if let Ok(job) = serde_json::from_slice::<NewJob>(bytes) {
            let _ = TrainConfig::new(job.preset, &job.overrides);
            let _ = (job.metadata().validation_error(), serde_json::to_vec(&job).unwrap());
        }
        if let Ok(change) = serde_json::from_slice::<MetadataChange>(bytes) {
            let _ = relume_api::metadata::ResourceMetadata::default().changed(&change).validation_error();
        }
        if let Ok(key) = serde_json::from_slice::<NewKey>(bytes) {
            let _ = key.validation_error(&TenantId::of_operator());
        }
        let _ = serde_json::from_slice::<JobChange>(bytes);
        let _ = serde_json::from_slice::<RenderRequest>(bytes);
        let _ = serde_json::from_slice::<NewWebhook>(bytes);
        let _ = serde_json::from_slice::<WebhookChange>(bytes);
        let _ = serde_json::from_slice::<CaptureSource>(bytes);
        let _ = parse_labels(&String::from_utf8_lossy(bytes));
    });
}

/// Reads an archive in all ways that the server uses.
fn read_archive(bytes: &[u8]) {
    let file = NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let mut limits = ImportLimits::default();
    (limits.max_total_bytes, limits.max_image_pixels) = (1 << 22, 1 << 16);
    let options = ImportOptions { limits, ..ImportOptions::default() };
    let _ = relume_capture::import(file.path(), &options);
    let _ = relume_capture::cameras(file.path(), &limits, UpAxis::Auto);
}

fn pack(files: &Files, random: &mut ChaCha8Rng) -> Vec<u8> {
    match random.random_range(0..6) {
        0 => zip(files),
        1 => gzip(&tar(files)),
        _ => tar(files),
    }
}

/// Valid archives of all layouts, as ZIP and as tar.
fn archives() -> Vec<Vec<u8>> {
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let packed = |files| [zip(files), tar(files), pack(files, &mut random)];
    seeds::captures().iter().flat_map(packed).collect()
}

#[test]
fn mutated_archives_cause_no_panic() {
    fuzz("archives", &archives(), read_archive);
}

/// `count` mutated archives, for readers in processes of their own.
#[cfg(target_os = "linux")]
pub fn mutated_archives(count: u64) -> Vec<Vec<u8>> {
    let archives = archives();
    let make = |case| {
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        random.set_stream(case);
        mutated(&archives[random.random_range(0..archives.len())], &archives, &mut random)
    };
    (0..count).map(make).collect()
}

#[test]
fn mutated_files_in_valid_archives_cause_no_panic() {
    let captures = seeds::captures();
    let make = |random: &mut ChaCha8Rng| {
        let mut files = captures[random.random_range(0..captures.len())].clone();
        let all: Vec<Vec<u8>> = files.values().cloned().collect();
        for _ in 0..random.random_range(1..=2) {
            // Mostly pose files are mutated; images have a separate test.
            let pictures = random.random_bool(0.2);
            let names: Vec<String> =
                files.keys().filter(|name| name.ends_with(".png") == pictures).cloned().collect();
            let name = names[random.random_range(0..names.len())].clone();
            let changed = mutated(&files[&name], &all, random);
            files.insert(name, changed);
        }
        pack(&files, random)
    };
    run("files-in-archives", make, read_archive);
}

#[tokio::test(flavor = "multi_thread")]
async fn mutated_json_bodies_answer_4xx_and_never_5xx() {
    let server = relume::testing::spawn().await.unwrap();
    let seeds = seeds::bodies();
    // Each of these cases is a request.
    for case in 0..cases().div_ceil(5) {
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        random.set_stream(case);
        let (method, path, seed) = [
            (Method::POST, "/v1/jobs", 0),
            (Method::POST, "/v1/models/none/render", 1),
            (Method::PATCH, "/v1/jobs/none", 2),
            (Method::POST, "/v1/captures", 5),
        ][random.random_range(0..4)]
        .clone();
        let body = mutated(&seeds[seed], &seeds, &mut random);
        let request =
            server.client().request(method, path).unwrap().header(header::CONTENT_TYPE, "application/json");
        let answer = request.body(body.clone()).send().await.unwrap();
        let status = answer.status().as_u16();
        let text = answer.text().await.unwrap();
        let problem: Problem =
            serde_json::from_str(&text).unwrap_or_else(|_| panic!("case {case}: {status} {text}"));
        let sent = String::from_utf8_lossy(&body);
        assert!((400..500).contains(&status), "case {case}, {path}: {problem:?} to {sent}");
    }
    println!("bodies over HTTP: {} cases", cases().div_ceil(5));
}
