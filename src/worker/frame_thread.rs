//! Rendering threads beside the training thread. They have separate thread pools, so that the device and the operating system
//! share the hardware between rendering and training, and no frame waits for the host work of a training.

use std::io;
use std::thread::JoinHandle;

use tokio_util::sync::CancellationToken;

use crate::worker::frame_server::FrameServer;

/// Number of rendering threads for a GPU: one records a frame while the other waits for the device. A frame of the CPU engine
/// uses all processors.
const ON_A_GPU: usize = 2;

/// Starts the threads. After `ended` is cancelled they finish their current frames and exit.
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

/// Starts one thread with its own pool. A thread of a shared pool that waits for a part of a frame could steal the work of
/// another frame and wait for a lock that it holds itself.
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
