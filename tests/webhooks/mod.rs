//! Webhooks: queued with the end of a job, signed, delivered at least once, and only to permitted addresses.

mod delivery;
mod outbox;
mod process;
mod receiver;
mod records;

pub use receiver::for_all;
