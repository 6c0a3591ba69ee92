//! The checkpoint file of `relume train`: written when a signal stops the training and at regular steps, read when the command
//! runs again.

use std::error::Error;
use std::path::{Path, PathBuf};

use crate::cli::error::CommandResult;
use crate::cli::output;
use crate::cli::progress::ProgressReporter;
use crate::cli::stop::StopSignal;
use relume_capture::{Capture, Up};
use relume_engine::Device;
use relume_spec::training::TrainConfig;
use relume_train::time_budget::Timeline;
use relume_train::{PreparedTraining, Trainer, planned_config, up_of_checkpoint};

/// Seconds of training before which a file without a given name is not written at regular steps.
const DEFAULT_FILE_AFTER: f64 = 60.0;

/// The checkpoint file and its schedule.
pub(super) struct CheckpointFile {
    path: PathBuf,
    /// `--checkpoint` names the file. A file that does not fit stays where it is.
    is_named: bool,
    stop: StopSignal,
}

impl CheckpointFile {
    /// The file that `--checkpoint` names, otherwise `OUT.checkpoint`. From now on a signal ends the process with exit code 75.
    pub(super) fn new(named: Option<&Path>, out: &Path) -> CommandResult<Self> {
        let path = named.map_or_else(|| with_suffix(out, "checkpoint"), Path::to_owned);
        Ok(Self { path, is_named: named.is_some(), stop: StopSignal::listen()? })
    }

    /// The checkpoint from which a training with `config` resumes, if there is one.
    pub(super) fn resumed(&self, config: &TrainConfig) -> CommandResult<Option<Resumed>> {
        if !self.path.exists() {
            return Ok(None);
        }
        let read = || -> Result<Resumed, Box<dyn Error + Send + Sync>> {
            let bytes = std::fs::read(&self.path)?;
            Ok(Resumed { up: up_of_checkpoint(&bytes)?, config: planned_config(&bytes, config)?, bytes })
        };
        match read() {
            Ok(resumed) => Ok(Some(resumed)),
            Err(error) => Err(self.refused(&*error).into()),
        }
    }

    /// From now on a signal only sets [`CheckpointFile::is_stopped`].
    pub(super) fn wait(&self) {
        self.stop.wait();
    }

    /// Whether a signal asks the training to stop.
    pub(super) fn is_stopped(&self) -> bool {
        self.stop.is_requested()
    }

    /// Whether the training is due to be saved after its last step.
    pub(super) fn is_due(&self, trainer: &Trainer) -> bool {
        let every = trainer.config().checkpoint_every.max(1);
        let is_kept = self.is_named || trainer.seconds() >= DEFAULT_FILE_AFTER;
        is_kept && trainer.progress().step.is_multiple_of(every)
    }

    /// Writes the state of the training.
    pub(super) fn write(&self, trainer: &mut Trainer) -> CommandResult {
        Ok(output::write_named(&self.path, &trainer.checkpoint()?)?)
    }

    /// Deletes the file of a training that has ended.
    pub(super) fn delete(&self) -> CommandResult {
        if self.path.exists() {
            std::fs::remove_file(&self.path)?;
        }
        Ok(())
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The error of a file from which this training cannot resume. A file without a given name is renamed, so that the same command
    /// starts from the beginning and nothing is lost.
    fn refused(&self, error: &dyn Error) -> String {
        let file = self.path.display();
        if self.is_named {
            return format!("{file}: {error}");
        }
        let old = with_suffix(&self.path, "old");
        match std::fs::rename(&self.path, &old) {
            Ok(()) => format!(
                "{file}: {error}. The file is now {}: run the command again to start from the beginning",
                old.display()
            ),
            Err(failed) => format!("{file}: {error}; it cannot be renamed to {}: {failed}", old.display()),
        }
    }
}

/// `thing.safetensors.SUFFIX` for `thing.safetensors`.
fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".{suffix}"));
    name.into()
}

/// A checkpoint from which a training resumes.
pub(super) struct Resumed {
    bytes: Vec<u8>,
    /// The up direction of the training that the checkpoint continues.
    pub up: Up,
    /// The settings, with those that were planned for a time budget.
    pub config: TrainConfig,
}

/// The settings of a training, and what it starts from.
pub(super) struct TrainingStart {
    pub config: TrainConfig,
    /// A recorded plan to repeat.
    pub timeline: Option<Timeline>,
    pub resumed: Option<Resumed>,
}

impl TrainingStart {
    /// Resumes from the checkpoint if there is one, which was read from `file`; otherwise starts a training.
    pub(super) fn trainer(
        self,
        capture: &Capture,
        device: &Device,
        file: Option<&CheckpointFile>,
        progress: &ProgressReporter,
    ) -> CommandResult<Trainer> {
        if let (Some(Resumed { bytes, .. }), Some(file)) = (&self.resumed, file) {
            let trainer = Trainer::resume(capture, self.config, bytes, device);
            let trainer = trainer.map_err(|error| file.refused(&error))?;
            let step = trainer.progress().step;
            progress.status(&format!("resuming from step {step}, {}", file.path.display()));
            return Ok(trainer);
        }
        let start = PreparedTraining::new(capture, self.config)?;
        let start = match self.timeline {
            Some(timeline) => start.with_timeline(timeline),
            None => start,
        };
        Ok(start.on(device)?)
    }
}
