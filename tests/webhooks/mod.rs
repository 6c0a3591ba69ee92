//! Webhooks: entered with the end of a job, signed, delivered at least once, and only where they may go.

mod delivery;
mod outbox;
mod process;
mod receiver;
mod records;

pub use receiver::for_all;
