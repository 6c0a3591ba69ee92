//! Names of stored resources.

use serde::{Deserialize, Serialize};

/// Kind of a stored resource.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
pub enum ResourceKind {
    /// An archive of photographs with camera poses.
    Capture,
    /// An uploaded environment map.
    Environment,
    /// A training.
    Job,
    /// The result of a training.
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

/// Name of a stored resource.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ResourceName {
    /// Kind.
    pub kind: ResourceKind,
    /// Identifier.
    pub id: String,
}

impl ResourceName {
    /// Creates a name.
    pub fn new(kind: ResourceKind, id: impl Into<String>) -> Self {
        Self { kind, id: id.into() }
    }
}

impl std::fmt::Display for ResourceName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.kind.name(), self.id)
    }
}
