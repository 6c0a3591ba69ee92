//! Figures of a whole training on a path-traced scene, as a guard against changes that only relighting shows.

mod with_data {
    use std::sync::Arc;
    use std::time::Duration;

    use relume_capture::{ImportOptions, import};
    use relume_engine::Device;
    use relume_fixtures::data;
    use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
    use relume_train::Trainer;
    use relume_train::eval::{EvalOptions, evaluate};

    const SIDE: u32 = 128;

    #[test]
    #[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
    fn draft_of_a_sunlit_scene_finds_the_sun_and_relights() {
        let options = ImportOptions { max_side: Some(SIDE), ..ImportOptions::default() };
        let capture = import(&data("scenes/yard"), &options).unwrap();
        let overrides = TrainOverrides { resolution: Some(SIDE), ..TrainOverrides::default() };
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        let mut trainer = Trainer::new(&capture, config, &Device::Cpu).unwrap();
        while !trainer.is_done() {
            trainer.step().unwrap();
        }
        let model = Arc::new(trainer.model().unwrap());
        assert_eq!(model.lights.lights.len(), 1, "{}", model.card["light"]);
        let options =
            EvalOptions { views: Some(3), frame_rate_time: Duration::ZERO, ..EvalOptions::default() };
        let report = evaluate(model, &capture, &options).unwrap();
        let [relit, novel_view] =
            [&report.relit.mean, &report.novel_view].map(|s| s.psnr.unwrap_or(f64::NAN));
        // A training that misses the sun relights at 25 dB.
        assert!(relit > 29.0 && novel_view > 38.5, "relit {relit} dB, novel view {novel_view} dB");
    }
}
