//! A typed client of the service.
//!
//! ```no_run
//! # async fn example() -> Result<(), relume_client::ClientError> {
//! use relume_api::jobs::NewJob;
//! use relume_client::Client;
//!
//! let client = Client::new("http://127.0.0.1:7878", None)?;
//! let capture = client.upload_capture("scan.zip".as_ref()).await?;
//! let job = client.create_job(&NewJob { capture: capture.id, ..NewJob::default() }, None).await?;
//! let done = client.wait(&job.id, |event| println!("{}", event.kind)).await?;
//! println!("model {:?}", done.model);
//! # Ok(()) }
//! ```

mod captures;
mod connection;
mod deletion;
mod download;
mod environments;
mod error;
mod events;
mod exports;
mod jobs;
mod keys;
mod models;
mod uploads;
mod usage;
mod webhooks;
pub mod work;

pub use connection::Client;
pub use download::Download;
pub use error::ClientError;
pub use events::JobEvent;
