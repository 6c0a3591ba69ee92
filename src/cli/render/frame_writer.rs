//! Writes a frame while the next one is rendered.

use std::thread::JoinHandle;

use crate::cli::error::CommandResult;

/// A thread that encodes and writes one frame.
#[derive(Default)]
pub(super) struct FrameWriter {
    last: Option<JoinHandle<CommandResult>>,
}

impl FrameWriter {
    /// Waits for the last frame, then starts to write the next one.
    ///
    /// # Errors
    /// If the last frame could not be written.
    pub(super) fn start(&mut self, write: impl FnOnce() -> CommandResult + Send + 'static) -> CommandResult {
        self.finish()?;
        self.last = Some(std::thread::spawn(write));
        Ok(())
    }

    /// Waits for the last frame.
    ///
    /// # Errors
    /// If it could not be written.
    pub(super) fn finish(&mut self) -> CommandResult {
        match self.last.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(_)) => Err("the thread that writes frames failed".into()),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_that_cannot_be_written_is_an_error_of_the_next_call() {
        let mut writer = FrameWriter::default();
        writer.start(|| Err("disk full".into())).unwrap();
        let error = writer.start(|| Ok(())).unwrap_err();
        assert_eq!(error.to_string(), "disk full");
        writer.start(|| Err("disk full".into())).unwrap();
        assert!(writer.finish().is_err(), "or of the end");
        assert!(writer.finish().is_ok(), "the control");
    }
}
