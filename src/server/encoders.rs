//! Encoding of frames. Only a few large frames are encoded at the same time, so that processors remain for small frames.

use std::sync::Arc;

use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use crate::server::memory::MemoryPermit;
use crate::server::problem::Problem;
use relume_spec::rendering::{FrameFormat, Output};
use relume_train::render::{EncodeOptions, EncodedFrame, Frame, encode_wanted_frame};

/// Maximum number of values of a frame that is encoded without a limit: 512 x 512 pixels of colour and alpha.
const AT_ONCE: u64 = 1 << 20;

/// The concurrency limit of large frames.
#[derive(Clone)]
pub(super) struct Encoders(Arc<Semaphore>);

impl Encoders {
    /// Permits half as many concurrent large frames as processors, at least one.
    pub(super) fn new() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        Self(Arc::new(Semaphore::new((processors / 2).max(1))))
    }

    /// Encodes a frame to a file; `memory` is the permit for both. If the future is dropped, the work stops soon.
    ///
    /// # Errors
    /// 500 if the encoder fails.
    pub(super) async fn encode(
        &self,
        frame: Frame,
        outputs: Vec<Output>,
        format: FrameFormat,
        encoding: EncodeOptions,
        memory: MemoryPermit,
    ) -> Result<EncodedFrame, Problem> {
        let permit = match values(&frame, &outputs) > AT_ONCE {
            true => Some(self.0.clone().acquire_owned().await.map_err(Problem::internal)?),
            false => None,
        };
        let gone = CancellationToken::new();
        let _until_dropped = gone.clone().drop_guard();
        let span = tracing::info_span!("encode");
        let work = move || {
            let _span = span.entered();
            // Both are held until the work has ended, even if the caller no longer waits.
            let _held = (memory, permit);
            encode_wanted_frame(&frame, &outputs, format, &encoding, &|| !gone.is_cancelled())
        };
        tokio::task::spawn_blocking(work).await.map_err(Problem::internal)?.map_err(Problem::internal)
    }
}

fn values(frame: &Frame, outputs: &[Output]) -> u64 {
    let channels: usize = outputs.iter().map(|output| output.channels()).sum();
    u64::from(frame.width) * u64::from(frame.height) * (channels as u64 + 1)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::server::memory::MemoryBudget;

    fn frame(side: u32) -> Frame {
        let pixels = (side * side) as usize;
        let planes = [(Output::Rgb, vec![0.5; 3 * pixels]), (Output::Alpha, vec![1.0; pixels])];
        Frame { width: side, height: side, planes: planes.into() }
    }

    async fn encode(encoders: &Encoders, side: u32) -> Result<EncodedFrame, Problem> {
        let memory = MemoryBudget::new(1 << 30).reserve(1).await.unwrap();
        encoders
            .encode(frame(side), vec![Output::Rgb], FrameFormat::Exr, EncodeOptions::default(), memory)
            .await
    }

    #[tokio::test]
    async fn large_frames_wait_for_an_encoder_and_small_ones_do_not() {
        let encoders = Encoders(Arc::new(Semaphore::new(1)));
        let taken = encoders.0.clone().acquire_owned().await.unwrap();
        assert!(encode(&encoders, 64).await.is_ok());
        let large = tokio::time::timeout(Duration::from_millis(50), encode(&encoders, 1024)).await;
        assert!(large.is_err(), "it must wait");
        drop(taken);
        assert!(encode(&encoders, 1024).await.is_ok());
    }

    #[tokio::test]
    async fn encoder_permit_is_released_when_the_client_disconnects() {
        let encoders = Encoders(Arc::new(Semaphore::new(1)));
        let used = encoders.clone();
        let client = tokio::spawn(async move { encode(&used, 2048).await.is_ok() });
        while encoders.0.available_permits() > 0 && !client.is_finished() {
            tokio::task::yield_now().await;
        }
        client.abort();
        assert!(encode(&encoders, 1024).await.is_ok());
        assert_eq!(encoders.0.available_permits(), 1);
    }
}
