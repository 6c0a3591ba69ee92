//! Receives a fetched file to disk.

use axum::http::header;
use futures::StreamExt;
use tokio::time::Instant;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::content_length;
use crate::server::fetching::fetcher::failed;
use crate::server::problem::Problem;
use crate::store::StagedUpload;

/// Fetches a file of at most `limit` bytes. After an error, or if the future is dropped, nothing of it is left.
pub(in crate::server) async fn receive(
    app: &AppState,
    caller: &Caller,
    url: &str,
    limit: u64,
) -> Result<StagedUpload, Problem> {
    let fetcher = &app.fetcher;
    let begun = Instant::now();
    let target = fetcher.target(url)?;
    let answer = fetcher.ask(&target).await?;
    let declared = content_length(answer.response.headers()).unwrap_or(0);
    if declared > limit {
        return Err(Problem::too_large(limit));
    }
    if answer.response.headers().contains_key(header::CONTENT_ENCODING) {
        return Err(failed("the host sent a content encoding that the server did not request"));
    }
    app.store.admit_bytes_of(&caller.tenant, declared).await?;
    app.store.admit_bytes(declared).await.map_err(|error| caller.problem_for(error))?;
    let mut broken = None;
    let body = fetcher.bytes(answer, begun).map(|piece| piece.inspect_err(|why| broken = Some(why.clone())));
    let name: String = app.jobs.fresh_id();
    let received = app.store.receive(&caller.tenant, &name, body, limit).await;
    match broken {
        Some(why) => Err(failed(&why)),
        None => received.map_err(|error| caller.problem_for(error)),
    }
}
