//! What a client knows of the server from its answers alone, and what it must find after a kill.

use std::collections::BTreeSet;

use relume_api::jobs::JobState;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Capture,
    Environment,
    Upload,
    Job,
    Model,
    Webhook,
    Key,
}

/// Whether a thing is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    Kept,
    Deleted,
    /// It was to be deleted and no answer came.
    Either,
}

/// A thing that the server has answered for.
#[derive(Debug, Clone)]
pub struct Thing {
    pub kind: Kind,
    pub id: String,
    pub fate: Fate,
    /// What it may be called: the last name that was answered for, and those without an answer. Empty: not known.
    pub names: BTreeSet<Option<String>>,
    /// How a job ended, once that was seen.
    pub ended: Option<JobState>,
    /// A job was asked to stop and the server said yes.
    pub stopping: bool,
    /// The capture of a job.
    pub parent: String,
    /// What the bearer of a key sends.
    pub secret: String,
    /// Bytes of an upload that were answered for.
    pub offset: usize,
    /// The whole of an upload.
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
            stopping: false,
            parent: String::new(),
            secret: String::new(),
            offset: 0,
            archive: Vec::new(),
        }
    }

    /// Takes what was found for what is so from now on; an error when it cannot be.
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

    /// As [`Thing::settle`], of its name.
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

    /// As [`Thing::settle`], of the state of a job.
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
