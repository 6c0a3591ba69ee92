//! Time and work of the device per stage.

/// Time and work of a stage, summed over all submissions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageTime {
    /// Name of the stage.
    pub name: &'static str,
    /// Milliseconds on the device.
    pub ms: f64,
    /// Minimum of bytes read and written; 0 where they are not counted.
    pub bytes: f64,
    /// Floating-point operations; 0 where they are not counted.
    pub flops: f64,
}

/// Time per stage, in order of first appearance.
#[derive(Debug, Default)]
pub(super) struct Timings {
    stages: Vec<StageTime>,
}

impl Timings {
    pub(super) fn add(&mut self, name: &'static str, [ms, bytes, flops]: [f64; 3]) {
        let at = self.stages.iter().position(|s| s.name == name).unwrap_or_else(|| {
            self.stages.push(StageTime { name, ms: 0.0, bytes: 0.0, flops: 0.0 });
            self.stages.len() - 1
        });
        let stage = &mut self.stages[at];
        stage.ms += ms;
        stage.bytes += bytes;
        stage.flops += flops;
    }

    pub(super) fn listed(&self) -> Vec<StageTime> {
        self.stages.clone()
    }
}
