//! Names of what a server keeps.

use serde::{Deserialize, Serialize};

/// A kind of thing that a server keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub enum ResourceKind {
    /// An archive of photographs.
    Capture,
    /// An uploaded environment map.
    Environment,
    /// A training.
    Job,
    /// What a training produced.
    Model,
}

impl ResourceKind {
    /// The kind's name in the API.
    pub fn name(self) -> &'static str {
        match self {
            Self::Capture => "capture",
            Self::Environment => "environment",
            Self::Job => "job",
            Self::Model => "model",
        }
    }
}

/// The name of one thing that a server keeps.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct ResourceName {
    /// Its kind.
    pub kind: ResourceKind,
    /// Its identifier.
    pub id: String,
}

impl ResourceName {
    /// A name.
    pub fn new(kind: ResourceKind, id: impl Into<String>) -> Self {
        Self { kind, id: id.into() }
    }
}

impl std::fmt::Display for ResourceName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.kind.name(), self.id)
    }
}
