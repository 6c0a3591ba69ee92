//! The state of the server as a client knows it from answers alone, which must hold after a kill.

use std::collections::BTreeSet;

use relume_api::captures::CaptureState;
use relume_api::jobs::JobState;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Capture,
    /// Photographs without poses.
    Photographs,
    Environment,
    Upload,
    Job,
    Model,
    Export,
    Webhook,
    Key,
}

/// Whether a resource exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    Kept,
    Deleted,
    /// A deletion was requested but not answered.
    Either,
}

/// A resource that the server has confirmed.
#[derive(Debug, Clone)]
pub struct Thing {
    pub kind: Kind,
    pub id: String,
    pub fate: Fate,
    /// Possible names: the last confirmed name, and later names without an answer. Empty: unknown.
    pub names: BTreeSet<Option<String>>,
    /// The final state of a job, once it was observed.
    pub ended: Option<JobState>,
    /// The final state of the validation of photographs, once it was observed.
    pub validation: Option<CaptureState>,
    /// True after a confirmed cancellation of the job, or after a request to delete the photographs.
    pub stopping: bool,
    /// The capture of a job, the model of an export.
    pub parent: String,
    /// Possible reflectances of the calibration of a model, percent: the last confirmed one, and later ones without an answer.
    pub reflectances: BTreeSet<Option<i32>>,
    /// The complete key, for a key.
    pub secret: String,
    /// Confirmed bytes of an upload.
    pub offset: usize,
    /// All bytes of an upload.
    pub archive: Vec<u8>,
}

impl Thing {
    pub fn new(kind: Kind, id: impl ToString) -> Self {
        Self {
            kind,
            id: id.to_string(),
            fate: Fate::Kept,
            names: [None].into(),
            ended: None,
            validation: None,
            stopping: false,
            parent: String::new(),
            reflectances: [None].into(),
            secret: String::new(),
            offset: 0,
            archive: Vec::new(),
        }
    }

    /// Records an observation; an error if it contradicts the known state.
    pub fn settle(&mut self, found: bool) -> Result<(), String> {
        match (self.fate, found) {
            (Fate::Kept, false) => Err(format!("{:?} {} is lost", self.kind, self.id)),
            (Fate::Deleted, true) => Err(format!("{:?} {} is back", self.kind, self.id)),
            (_, true) => {
                self.fate = Fate::Kept;
                Ok(())
            }
            (_, false) => {
                self.fate = Fate::Deleted;
                Ok(())
            }
        }
    }

    /// As [`Thing::settle`], for the name.
    pub fn settle_name(&mut self, found: Option<String>) -> Result<(), String> {
        if !self.names.is_empty() && !self.names.contains(&found) {
            return Err(format!(
                "{:?} {} is called {found:?}, not one of {:?}",
                self.kind, self.id, self.names
            ));
        }
        self.names = [found].into();
        Ok(())
    }

    /// As [`Thing::settle`], for the state of a job.
    pub fn settle_state(&mut self, found: JobState) -> Result<(), String> {
        let wrong = |why: &str| Err(format!("job {} is {} {why}", self.id, found.name()));
        if self.ended.is_some_and(|ended| ended != found) {
            return wrong("and had ended otherwise");
        }
        let stops = [JobState::Cancelling, JobState::Cancelled, JobState::Failed];
        if self.stopping && !stops.contains(&found) {
            return wrong("and was to stop");
        }
        self.ended = Some(found).filter(|state| state.is_terminal());
        Ok(())
    }
}
