//! Limits of a job for the device of this server. Preparation and single steps cannot be interrupted, so a job must not occupy
//! the device for minutes.

use crate::server::problem::Problem;
use relume_spec::training::TrainConfig;

/// The limits of a job on an engine.
struct JobLimits {
    engine: &'static str,
    gaussians: u32,
    resolution: u32,
    /// Number of Gaussians times probe directions: each pair is a ray of one measurement of the visibility.
    rays: u64,
}

const CPU: JobLimits = JobLimits { engine: "CPU", gaussians: 200_000, resolution: 4096, rays: 32 << 20 };
const GPU: JobLimits = JobLimits { engine: "GPU", gaussians: 4_000_000, resolution: 8192, rays: 512 << 20 };

/// # Errors
/// Names the override that exceeds a limit.
pub(super) fn check(config: &TrainConfig, on_gpu: bool) -> Result<(), Problem> {
    let most = if on_gpu { GPU } else { CPU };
    let rays = most.rays / u64::from(config.max_gaussians.max(1));
    let asked = [
        ("max_gaussians", config.max_gaussians, u64::from(most.gaussians)),
        ("resolution", config.resolution, u64::from(most.resolution)),
        ("probe_directions", config.probe_directions, rays),
    ];
    for (field, value, most_here) in asked {
        if u64::from(value) > most_here {
            let detail = format!(
                "must be at most {most_here} on the {} with these settings, got {value}",
                most.engine
            );
            return Err(Problem::invalid_field(format!("/overrides/{field}"), detail));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::{Preset, TrainOverrides};

    fn refused(overrides: TrainOverrides, on_gpu: bool) -> Option<String> {
        let config = TrainConfig::new(Preset::Standard, &overrides).unwrap();
        check(&config, on_gpu).err().map(|problem| problem.errors[0].pointer.clone())
    }

    #[test]
    fn presets_are_within_job_limits_and_larger_jobs_are_refused() {
        for preset in [Preset::Draft, Preset::Standard, Preset::High] {
            assert!(check(&TrainConfig::preset(preset), false).is_ok());
        }
        let many = || TrainOverrides { max_gaussians: Some(300_000), ..TrainOverrides::default() };
        assert_eq!(refused(many(), false).as_deref(), Some("/overrides/max_gaussians"));
        assert_eq!(refused(many(), true), None);
        let rays = TrainOverrides { probe_directions: Some(1024), max_gaussians: Some(100_000), ..many() };
        assert_eq!(refused(rays, false).as_deref(), Some("/overrides/probe_directions"));
        let fine = TrainOverrides { resolution: Some(8192), ..TrainOverrides::default() };
        assert_eq!(refused(fine, false).as_deref(), Some("/overrides/resolution"));
    }
}
