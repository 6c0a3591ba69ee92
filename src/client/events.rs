//! Server-sent events, as far as this service uses them.

use futures::{Stream, TryStreamExt};
use serde_json::Value;
use tokio_util::bytes::Bytes;

use crate::client::ClientError;

/// One event of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobEvent {
    /// Its number; numbers only grow.
    pub seq: i64,
    /// `state`, `progress`, `checkpoint` or `warning`.
    pub kind: String,
    /// What it says.
    pub data: Value,
}

/// Events from the bytes of a stream.
pub(super) fn parse(
    bytes: impl Stream<Item = Result<Bytes, ClientError>>,
) -> impl Stream<Item = Result<JobEvent, ClientError>> {
    let start = (Box::pin(bytes), Vec::new());
    futures::stream::try_unfold(start, |(mut bytes, mut buffer)| async move {
        loop {
            while let Some(block) = take_block(&mut buffer) {
                if let Some(event) = event(&block)? {
                    return Ok(Some((event, (bytes, buffer))));
                }
            }
            match bytes.try_next().await? {
                Some(chunk) => buffer.extend_from_slice(&chunk),
                None => return Ok(None),
            }
        }
    })
}

/// Removes the first complete block, which ends with an empty line.
fn take_block(buffer: &mut Vec<u8>) -> Option<Vec<u8>> {
    let end = buffer.windows(2).position(|pair| pair == b"\n\n")?;
    Some(buffer.drain(..end + 2).collect())
}

/// The event in a block; a block of comments has none.
fn event(block: &[u8]) -> Result<Option<JobEvent>, ClientError> {
    let unexpected = |what: &str| ClientError::Unexpected(format!("event: {what}"));
    let text = std::str::from_utf8(block).map_err(|e| unexpected(&e.to_string()))?;
    let field = |name: &str| {
        text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':').map(str::trim_start))
    };
    let Some(data) = field("data") else { return Ok(None) };
    let seq = field("id").and_then(|id| id.parse().ok()).ok_or_else(|| unexpected("has no number"))?;
    let data = serde_json::from_str(data).map_err(|e| unexpected(&e.to_string()))?;
    Ok(Some(JobEvent { seq, kind: field("event").unwrap_or("message").to_owned(), data }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn events_survive_any_split_of_the_stream() {
        let text = ": hello\n\nid: 1\nevent: state\ndata: {\"state\":\"queued\"}\n\nid: 2\nevent: progress\ndata: {}\n\n";
        for size in [1, 2, 7, 1000] {
            let chunks: Vec<_> =
                text.as_bytes().chunks(size).map(|c| Ok(Bytes::copy_from_slice(c))).collect();
            let events: Vec<_> = parse(futures::stream::iter(chunks)).try_collect().await.unwrap();
            let seen: Vec<_> = events.iter().map(|e| (e.seq, e.kind.as_str())).collect();
            assert_eq!(seen, [(1, "state"), (2, "progress")], "chunks of {size}");
        }
    }
}
