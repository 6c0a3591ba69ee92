//! The events of a job, from server-sent events.

use futures::{Stream, TryStreamExt};
use serde_json::Value;
use sse_stream::{Sse, SseByteStream};
use tokio_util::bytes::Bytes;

use crate::error::ClientError;

/// One event of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobEvent {
    /// The event's number; numbers increase within a job.
    pub seq: i64,
    /// `state`, `progress`, `checkpoint` or `warning`.
    pub kind: String,
    /// The event's data.
    pub data: Value,
}

/// Parses events from the bytes of a stream.
pub(super) fn parse<E: std::error::Error + Send + Sync + 'static>(
    bytes: impl Stream<Item = Result<Bytes, E>>,
) -> impl Stream<Item = Result<JobEvent, ClientError>> {
    SseByteStream::new(Box::pin(bytes))
        .map_err(ClientError::from)
        .try_filter_map(|block| std::future::ready(event(block)))
}

/// The event in a block; `None` for a block without data, e.g. a comment.
fn event(block: Sse) -> Result<Option<JobEvent>, ClientError> {
    let unexpected = |what: &str| ClientError::Unexpected(format!("event: {what}"));
    let Some(data) = block.data else { return Ok(None) };
    let seq = block
        .id
        .and_then(|id| id.parse().ok())
        .ok_or_else(|| unexpected("the id is missing or not a number"))?;
    let data = serde_json::from_str(&data).map_err(|e| unexpected(&e.to_string()))?;
    Ok(Some(JobEvent { seq, kind: block.event.unwrap_or_else(|| "message".to_owned()), data }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn events_are_parsed_for_any_chunk_size() {
        let text = ": hello\n\nid: 1\nevent: state\ndata: {\"state\":\"queued\"}\n\nid: 2\nevent: progress\ndata: {}\n\n";
        for size in [1, 2, 7, 1000] {
            let chunks: Vec<_> = text
                .as_bytes()
                .chunks(size)
                .map(|c| Ok::<_, std::io::Error>(Bytes::copy_from_slice(c)))
                .collect();
            let events: Vec<_> = parse(futures::stream::iter(chunks)).try_collect().await.unwrap();
            let seen: Vec<_> = events.iter().map(|e| (e.seq, e.kind.as_str())).collect();
            assert_eq!(seen, [(1, "state"), (2, "progress")], "chunks of {size}");
        }
    }
}
