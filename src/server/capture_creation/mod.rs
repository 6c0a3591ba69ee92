//! Makes captures of complete uploads, synchronously or after a 202 answer (RFC 7240, `respond-async`).
//!
//! The states of an asynchronous creation are those of its upload in the database, so a server that starts continues it:
//!
//! ```text
//! received -- the tenant has a capture of this content --> that capture is the answer
//!    |
//!    | recorded with the identifier of its capture, answered 202
//!    v
//! validating -- the object store is unreachable --> validating again, after a pause
//!    |    \---- the server stops ----------------> validating, on the next server
//!    |    \---- the upload is deleted -----------> gone
//!    |
//!    +-- valid --> ready: a capture; the upload is removed
//!    +-- invalid --> invalid: the upload has the problem, and is kept until it expires
//! ```
//!
//! Photographs without poses get their poses in the state `validating`. A synchronous creation has no state in the database:
//! it ends as a capture or as an error.

mod asynchronous;
mod background;
mod existing;
mod publish;
mod unfinished;
mod validate;

pub(super) use asynchronous::{AsyncOptions, AsyncOutcome, begin, prefers_async};
pub(super) use background::resume;
pub(super) use existing::{CaptureLookup, look_up};
pub(super) use publish::create;
pub(super) use unfinished::{unavailable_reason, view};
pub(super) use validate::validate;
