//! Frames beside a training: on threads and pools of their own, so that device and operating system share what there is between
//! the two, and no frame waits for anything that a training does on the host.

use std::io;
use std::thread::JoinHandle;

use tokio_util::sync::CancellationToken;

use crate::worker::frame_server::FrameServer;

/// Threads of a GPU: one records a frame while the other waits for its own. A frame of the CPU engine takes all processors.
const ON_A_GPU: usize = 2;

/// Starts the threads. They end after `ended` is cancelled, with the frames that they are at.
///
/// Must be called inside a tokio runtime.
///
/// # Errors
/// When the operating system refuses a thread.
pub(super) fn start(frames: FrameServer, ended: CancellationToken) -> io::Result<Vec<JoinHandle<()>>> {
    let more = if frames.is_on_gpu() { ON_A_GPU - 1 } else { 0 };
    let shared: Vec<_> = (0..more).map(|_| frames.shared()).collect();
    shared.into_iter().chain([frames]).map(|frames| serve(frames, ended.clone())).collect()
}

/// Starts one thread. Its pool is its own: a thread of a shared one, waiting for its part of a frame, would take up another frame and
/// wait for what it holds itself.
fn serve(mut frames: FrameServer, ended: CancellationToken) -> io::Result<JoinHandle<()>> {
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
