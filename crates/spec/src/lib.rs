//! Settings of trainings ([`training`]) and of frames ([`rendering`]), and the validation report of a
//! capture, as plain data.
//!
//! The command line, the types of the HTTP API and the trainer share these types, so that each setting is
//! declared once.

mod capture_report;
pub mod rendering;
pub mod training;

pub use capture_report::{CaptureReport, NoteKind, PhotographNote};
