//! Remote workers: processes that use only the API of a server, neither its database nor its files.
//!
//! [`RemoteJobs`] is the job source of a remote worker. It caches downloads in a [`FileCache`].

mod errors;
mod file_cache;
mod observer;
mod remote_claim;
mod remote_jobs;

pub use file_cache::FileCache;
pub use observer::{Observer, WorkerEvent};
pub use remote_jobs::RemoteJobs;
