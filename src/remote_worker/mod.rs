//! Workers with a process of their own that know nothing of a server but its API: neither its database nor its files.
//!
//! [`RemoteJobs`] is the source of jobs of such a worker. What it fetches stays in a [`FileCache`].

mod errors;
mod file_cache;
mod observer;
mod remote_claim;
mod remote_jobs;

pub use file_cache::FileCache;
pub use observer::{Observer, WorkerEvent};
pub use remote_jobs::RemoteJobs;
