//! The door to the device thread for everyone else.

use std::time::Duration;

use tokio::sync::{mpsc, oneshot};

use crate::render::{Frame, RenderError};
use crate::worker::RenderTask;

/// How long a render may wait for the device and run. A training step and a first light preparation fit in.
const PATIENCE: Duration = Duration::from_secs(120);

/// Why there is no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderFailure {
    /// The queue is full or the device did not come round to it in time.
    #[error("the device is busy")]
    Busy,
    /// The request cannot be rendered.
    #[error(transparent)]
    Refused(#[from] RenderError),
    /// Our fault; the text is for the log.
    #[error("{0}")]
    Internal(String),
}

/// A task and whom to tell.
pub(super) struct Request {
    pub(super) task: RenderTask,
    pub(super) reply: oneshot::Sender<Result<Frame, RenderFailure>>,
}

/// Asks the device thread for frames. Cheap to clone.
#[derive(Clone)]
pub struct Device {
    requests: mpsc::Sender<Request>,
}

impl Device {
    pub(super) fn new(requests: mpsc::Sender<Request>) -> Self {
        Self { requests }
    }

    /// Renders between training steps.
    ///
    /// # Errors
    /// [`RenderFailure::Busy`] when too many wait already, otherwise what the renderer said.
    pub async fn render(&self, task: RenderTask) -> Result<Frame, RenderFailure> {
        let (reply, frame) = oneshot::channel();
        self.requests.try_send(Request { task, reply }).map_err(|_| RenderFailure::Busy)?;
        match tokio::time::timeout(PATIENCE, frame).await {
            Ok(Ok(result)) => result,
            Ok(Err(_)) | Err(_) => Err(RenderFailure::Busy),
        }
    }

    /// True while the device thread lives.
    pub fn is_alive(&self) -> bool {
        !self.requests.is_closed()
    }
}
