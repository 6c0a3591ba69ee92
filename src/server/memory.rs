//! The memory budget of requests. Decoding, encoding and large bodies reserve memory before they begin.
//!
//! A request may hold the permit of its body while it waits for that of its frame. Bodies have a separate pool, so that no
//! request waits for a permit of another waiting request.

use std::sync::Arc;
use std::time::Duration;

use axum::http::StatusCode;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::server::machine;
use crate::server::problem::Problem;
use relume_spec::rendering::{Output, Quality};

/// Bytes of one semaphore permit.
const UNIT: u64 = 1 << 20;
/// Minimum budget, bytes. With less not even a small frame fits.
const MIN_BUDGET: u64 = 64 << 20;
/// Reservations of at most this fraction of the small pool are small. They never wait for larger ones.
const SMALL: u64 = 8;
/// Maximum size of a body without a reservation, bytes.
const SMALL_BODY: u64 = 65_536;
/// Maximum time for which a reservation waits for others.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(20);
/// Bytes per value of a frame's planes, including the file.
const FRAME_VALUE: u64 = 9;
/// Bytes per pixel in a band of the CPU engine, for a pass that blends only colour.
const COLOUR_PIXEL: u64 = 16;
/// Bytes per pixel of a pass with all channels, and of another pass for the light of one dominant light.
const FULL_PIXEL: u64 = 48 * 4 + 20 * 4;

/// The memory budget.
pub(super) struct MemoryBudget {
    bodies: MemoryPool,
    small: MemoryPool,
    large: MemoryPool,
}

/// A part of the budget.
struct MemoryPool {
    bytes: u64,
    free: Arc<Semaphore>,
}

/// Reserved memory, until this is dropped.
#[derive(Debug)]
pub(super) struct MemoryPermit(#[allow(dead_code, reason = "given back when dropped")] OwnedSemaphorePermit);

impl MemoryBudget {
    /// A budget of `total` bytes, at least 64 MiB.
    pub(super) fn new(total: u64) -> Self {
        let total = total.max(MIN_BUDGET);
        let (bodies, small) = (total / 4, total / 8);
        Self {
            bodies: MemoryPool::new(bodies),
            small: MemoryPool::new(small),
            large: MemoryPool::new(total - bodies - small),
        }
    }

    /// Reserves `bytes` for decoding or a frame. Waits for other requests if they do not fit now.
    ///
    /// # Errors
    /// 413 if they can never fit, 503 if they did not fit in time.
    pub(super) async fn reserve(&self, bytes: u64) -> Result<MemoryPermit, Problem> {
        let pool = if bytes <= self.small.bytes / SMALL { &self.small } else { &self.large };
        pool.reserve(bytes).await
    }

    /// Reserves memory for a JSON body of `length` bytes: as received, as text, and decoded. Small bodies reserve nothing.
    ///
    /// # Errors
    /// As [`Self::reserve`].
    pub(super) async fn reserve_body(&self, length: u64) -> Result<MemoryPermit, Problem> {
        let bytes = if length <= SMALL_BODY { 0 } else { length.saturating_mul(3) };
        self.bodies.reserve(bytes).await
    }
}

impl MemoryPool {
    fn new(bytes: u64) -> Self {
        let units = usize::try_from(bytes / UNIT).unwrap_or(usize::MAX);
        Self { bytes, free: Arc::new(Semaphore::new(units.min(Semaphore::MAX_PERMITS))) }
    }

    async fn reserve(&self, bytes: u64) -> Result<MemoryPermit, Problem> {
        if bytes > self.bytes {
            let detail = format!(
                "the request needs about {} MiB of memory; this server allows {} MiB for such requests",
                bytes.div_ceil(UNIT),
                self.bytes / UNIT
            );
            let title = "The request needs too much memory";
            return Err(Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "needs-memory", title).detail(detail));
        }
        let units = u32::try_from(bytes.div_ceil(UNIT)).unwrap_or(u32::MAX);
        match tokio::time::timeout(ACQUIRE_TIMEOUT, self.free.clone().acquire_many_owned(units)).await {
            Ok(permit) => permit.map(MemoryPermit).map_err(Problem::internal),
            Err(_) => {
                let title = "Other requests use the memory that this request needs";
                Err(Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", title).retry_after(5))
            }
        }
    }
}

/// Half of the memory available to this process, bytes.
pub(super) fn default_budget() -> u64 {
    machine::memory() / 2
}

/// Bytes per pixel of a band of the frame under lamps: sums and parts of two planes, and strips.
const LAMP_PIXEL: u64 = 80;
/// Bytes per point of the ground.
const GROUND_POINT: u64 = 128;
/// Bytes of the pictures of a model from which the ground is computed together.
const GROUND_PICTURES: u64 = 32 << 20;

/// Bytes of a frame from its G-buffer to its file, with lamps or the ground if they are requested.
pub(super) fn frame_bytes(pixels: u64, outputs: &[Output], has_lamps: bool) -> u64 {
    let values: usize = outputs.iter().map(|o| o.channels()).sum();
    let is_colour = !has_lamps && outputs.iter().all(|o| matches!(o, Output::Rgb | Output::Alpha));
    let of_pass = if is_colour { COLOUR_PIXEL } else { FULL_PIXEL };
    let (values, on_cpu) = (values as u64 + 1, pixels.min(Quality::CPU_BAND_COST) * of_pass);
    // A band of a device is returned as floats.
    let ground = if outputs.iter().any(|o| o.is_of_ground()) { ground_bytes(pixels) } else { 0 };
    let lamps = if has_lamps { pixels.min(Quality::CPU_BAND_COST) * LAMP_PIXEL } else { 0 };
    ground + lamps + pixels * FRAME_VALUE * values + on_cpu.max(pixels.min(Quality::BAND_COST) * 4 * values)
}

/// Bytes for the ground of a frame: its points, and a group of pictures of the model.
fn ground_bytes(pixels: u64) -> u64 {
    pixels.min(1 << 19) * GROUND_POINT + GROUND_PICTURES
}

/// Bytes for the stream of a model with a file of `size` bytes: the file, the model, its columns, the stream.
pub(super) fn stream_bytes(size: u64) -> u64 {
    4 * size
}

/// Bytes for an export of a model with a file of `size` bytes: the file, the model twice, the exported file. A mesh of `cells`
/// also needs its distances, its textures and the views for them.
pub(super) fn export_bytes(size: u64, cells: usize) -> u64 {
    let cells = cells as u64;
    let mesh = if cells == 0 { 0 } else { (256 << 20) + 12 * cells.pow(3) + 2048 * cells.pow(2) };
    5 * size + mesh
}

/// Bytes for an export with a limit of a model with a file of `size` bytes: as [`export_bytes`], two models with fewer Gaussians, and the splats of the views in
/// which they are compared.
pub(super) fn limited_export_bytes(size: u64) -> u64 {
    export_bytes(size, 0) + 4 * size + (64 << 20)
}

/// Bytes for a light matrix of `lobes` with images of at most `width` pixels, of a model with a file of `size` bytes: the model and what its surfaces
/// hide from each other, the tables of the lobes, a group of lobes at the Gaussians, and a strip of the images for each thread.
pub(super) fn light_matrix_bytes(size: u64, lobes: u32, width: u32) -> u64 {
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as u64;
    let group = (9 * size).min(640 << 20);
    14 * size + group + u64::from(lobes) * (384 << 10) + threads * u64::from(width) * (16 << 10)
}

/// Bytes for the replacement of a model with a file of `size` bytes: the file, the model, and the two new files.
pub(super) fn rewrite_bytes(size: u64) -> u64 {
    4 * size
}

/// Bytes for the stream of a light: tables and a map in columns and bytes, and the light of each Gaussian.
pub(super) fn light_bytes(gaussians: i64) -> u64 {
    (8 << 20) + 100 * gaussians.max(0).unsigned_abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn requests_over_the_budget_answer_413_and_others_wait() {
        let budget = MemoryBudget::new(1 << 30);
        let never = budget.reserve(1 << 30).await.unwrap_err();
        assert_eq!((never.status, never.kind.ends_with("needs-memory")), (413, true));
        let permit = budget.reserve(500 << 20).await.unwrap();
        let busy = budget.reserve(500 << 20).await.unwrap_err();
        assert_eq!((busy.status, busy.retry_after), (503, Some(5)));
        let waiting = budget.reserve(500 << 20);
        let (second, ()) = tokio::join!(waiting, async {
            tokio::time::sleep(ACQUIRE_TIMEOUT / 2).await;
            drop(permit);
        });
        second.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn small_memory_requests_do_not_wait_for_large_ones() {
        let budget = MemoryBudget::new(1 << 30);
        let _large = budget.reserve(640 << 20).await.unwrap();
        let small: Vec<_> = futures::future::join_all((0..8).map(|_| budget.reserve(16 << 20))).await;
        assert!(small.iter().all(Result::is_ok));
        assert!(budget.reserve(16 << 20).await.is_err(), "the control: this pool is also limited");
    }

    #[tokio::test(start_paused = true)]
    async fn request_bodies_do_not_use_the_memory_budget_of_frames() {
        let budget = MemoryBudget::new(64 << 20);
        let bodies: Vec<_> = futures::future::join_all((0..5).map(|_| budget.reserve_body(1 << 20))).await;
        assert!(bodies.iter().all(Result::is_ok));
        assert!(budget.reserve_body(1 << 20).await.is_err(), "the control: bodies are limited");
        budget.reserve(40 << 20).await.unwrap();
        budget.reserve_body(SMALL_BODY).await.unwrap();
    }

    #[test]
    fn memory_estimates_match_measured_sizes() {
        let all = [Output::Rgb, Output::Albedo, Output::Normal, Output::Depth, Output::Alpha];
        let large = frame_bytes(4096 * 4096, &all, false);
        // Measured: 2,185 MiB for a whole process with a model of 60,000 Gaussians.
        assert!((1900 << 20..2200u64 << 20).contains(&large), "{large}");
        assert!(
            frame_bytes(256 * 256, &[Output::Rgb], false) < 4 << 20,
            "a thumbnail is small for any budget"
        );
        let plain = frame_bytes(2048 * 2048, &[Output::Rgb], false);
        assert!(frame_bytes(2048 * 2048, &[Output::Rgb], true) > plain + (16 << 20), "lamps need memory");
        let shadow = frame_bytes(2048 * 2048, &[Output::Shadow], false);
        assert!(
            shadow > frame_bytes(2048 * 2048, &[Output::Normal], false) + (64 << 20),
            "and so does the ground"
        );
        assert!(default_budget() > MIN_BUDGET);
        // A stream has 62 bytes per Gaussian and as many floats, with 140 floats per Gaussian in the file; a light has 16 bytes
        // and ten floats.
        assert!(stream_bytes(560_000) > 560_000 + 560_000 + 1000 * (62 + 40 * 4));
        assert!(
            light_bytes(1000) - light_bytes(0) >= 1000 * (16 + 2 * 40) && light_bytes(-1) == light_bytes(0)
        );
    }
}
