//! The job state machine, leases and events.
//!
//! ```text
//! queued ──claim──▶ running ──publish──▶ succeeded or rejected
//!   │  ▲              │ │ └──fail──────▶ failed
//!   │  └──release─────┘ └──cancel──▶ cancelling ──▶ cancelled
//!   └──cancel──────────────────────────────────────▶ cancelled
//! ```
//!
//! [`Jobs`] has the operations of clients on jobs; [`Lease`] those of a worker on its job. The state is in the database. A change
//! is also announced on a [`tokio::sync::watch`] channel, so that listeners know when to query the database.

mod changes;
mod clock;
mod deletion;
mod heartbeat;
mod inputs;
mod lease;
mod model_publication;
mod queue;

pub use clock::{Clock, DatabaseClock, Ids, ManualClock, RandomIds, SequentialIds, SystemClock};
pub use inputs::InputFile;
pub use lease::Lease;
pub use queue::{Jobs, LeasePolicy, Origin};
