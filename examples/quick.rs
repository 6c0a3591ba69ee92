use relume::capture::*;
use relume::train::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let t = std::time::Instant::now();
    let cap = import(
        std::path::Path::new(&a[1]),
        &ImportOptions { max_side: Some(a[2].parse().unwrap()), load_truth: false, ..Default::default() },
    )
    .unwrap();
    println!(
        "import {:?} train {} test {} bounds {:?} points {} warn {}",
        t.elapsed(),
        cap.train.len(),
        cap.test.len(),
        cap.bounds,
        cap.points.len(),
        cap.warnings.len()
    );
    let o: TrainOverrides = serde_json::from_str(&a[3]).unwrap();
    let cfg = TrainConfig::new(Preset::Standard, &o).unwrap();
    let mut tr = Trainer::new(&cap, cfg).unwrap();
    let t = std::time::Instant::now();
    let mut last = t;
    let (mut l, mut p, mut n) = (0.0, 0.0, 0);
    while !tr.is_done() {
        let r = tr.step().unwrap();
        l += r.loss;
        p += r.psnr;
        n += 1;
        if let Some(w) = &r.warning {
            println!("{w}");
        }
        if r.step % 200 == 0 {
            println!(
                "{} loss {:.4} psnr {:.2} n {} {:.1} steps/s",
                r.step,
                l / n as f32,
                p / n as f32,
                r.gaussians,
                n as f64 / last.elapsed().as_secs_f64()
            );
            l = 0.;
            p = 0.;
            n = 0;
            last = std::time::Instant::now();
        }
    }
    println!("total {:?}", t.elapsed());
    std::fs::write(&a[4], relume::formats::model_file::encode(&tr.model()).unwrap()).unwrap();
}
