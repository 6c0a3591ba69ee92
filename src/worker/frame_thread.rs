//! Frames beside a training: on a thread and a pool of their own, so that device and operating system share what there is between
//! the two, and no frame waits for anything that a training does on the host.

use std::io;
use std::thread::JoinHandle;

use tokio_util::sync::CancellationToken;

use crate::worker::frame_server::FrameServer;

/// Starts the thread. It ends after `ended` is cancelled, with the frame that it is at.
///
/// Must be called inside a tokio runtime.
///
/// # Errors
/// When the operating system refuses a thread.
pub(super) fn start(mut frames: FrameServer, ended: CancellationToken) -> io::Result<JoinHandle<()>> {
    let pool = rayon::ThreadPoolBuilder::new().thread_name(|i| format!("frames-{i}"));
    let pool = pool.build().map_err(io::Error::other)?;
    let runtime = tokio::runtime::Handle::current();
    let serve = move || {
        while !ended.is_cancelled() {
            runtime.block_on(async {
                tokio::select! {
                    () = ended.cancelled() => {}
                    () = frames.arrival() => {}
                }
            });
            pool.install(|| frames.serve_waiting());
        }
    };
    std::thread::Builder::new().name("relume-frames".to_owned()).spawn(serve)
}
