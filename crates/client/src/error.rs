//! Errors of the client.

use relume_api::Problem;

/// Errors of the client.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The server refused the request; the problem states the reason.
    #[error("{}: {} ({})", .0.title, .0.detail.as_deref().unwrap_or_default(), .0.status)]
    Problem(Box<Problem>),
    /// The server could not be reached, or the connection broke.
    #[error("transport: {0}")]
    Transport(#[from] reqwest::Error),
    /// The response does not follow the API.
    #[error("unexpected response: {0}")]
    Unexpected(String),
    /// The server's address is not a URL.
    #[error("address: {0}")]
    Address(String),
    /// A local file could not be read or written.
    #[error("file: {0}")]
    File(#[from] std::io::Error),
}

impl ClientError {
    /// The problem, if the server refused the request.
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Problem(problem) => Some(problem),
            _ => None,
        }
    }
}

impl From<sse_stream::Error> for ClientError {
    fn from(error: sse_stream::Error) -> Self {
        let sse_stream::Error::Body(source) = error else { return Self::Unexpected(error.to_string()) };
        match source.downcast::<reqwest::Error>() {
            Ok(transport) => Self::Transport(*transport),
            Err(other) => Self::Unexpected(other.to_string()),
        }
    }
}

/// The result of a call.
pub(super) type Result<T> = std::result::Result<T, ClientError>;
