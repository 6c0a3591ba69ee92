//! Requests a file and reads it, within the limits of a policy.

use axum::body::Bytes;
use axum::http::{Request, StatusCode};
use futures::{Stream, StreamExt};
use http_body_util::{BodyStream, Empty};
use tokio::time::{Instant, timeout, timeout_at};

use crate::server::fetching::policy::{FetchOrigin, FetchPolicy};
use crate::server::outbound::{self, Answer, OutboundTarget, Tls};
use crate::server::problem::Problem;

/// The policy for fetching, and TLS.
pub(in crate::server) struct Fetcher {
    policy: FetchPolicy,
    tls: Tls,
}

impl Fetcher {
    pub(in crate::server) fn new(policy: FetchPolicy) -> Self {
        Self { policy, tls: Tls::default() }
    }

    /// The target of a URL, if the policy permits it.
    pub(super) fn target(&self, url: &str) -> Result<OutboundTarget, Problem> {
        let refused = |why: &str| Problem::invalid_field("/url", why);
        let target = OutboundTarget::parse(url, true).map_err(|why| refused(&why))?;
        match self.policy.origins.contains(&FetchOrigin::of(&target)) {
            true => Ok(target),
            false if self.policy.origins.is_empty() => {
                Err(refused("fetching is not configured on this server"))
            }
            false => Err(refused(
                "its scheme, host and port are not among the origins from which this server fetches",
            )),
        }
    }

    /// The response with the file.
    pub(super) async fn ask(&self, target: &OutboundTarget) -> Result<Answer, Problem> {
        let request = Request::builder().body(Empty::<Bytes>::new()).map_err(Problem::internal)?;
        let asked = outbound::ask(target, self.policy.allow_private, &self.tls, request);
        let answer = timeout(self.policy.stall, asked).await;
        let answer =
            answer.map_err(|_| failed("the host did not answer in time"))?.map_err(|why| failed(&why))?;
        match answer.response.status() {
            StatusCode::OK => Ok(answer),
            status if status.is_redirection() => {
                Err(failed(&format!("the host answered {}; redirects are not followed", status.as_u16())))
            }
            status => Err(failed(&format!("the host answered {}", status.as_u16()))),
        }
    }

    /// The bytes of the file, or the reason why no more arrive, within the time limit since `begun`.
    pub(super) fn bytes(
        &self,
        answer: Answer,
        begun: Instant,
    ) -> impl Stream<Item = Result<Bytes, String>> + use<> {
        let (until, stall) = (begun + self.policy.timeout, self.policy.stall);
        futures::stream::try_unfold(answer, move |mut answer| async move {
            let mut body = BodyStream::new(answer.response.body_mut());
            let late = || "the rest of the file did not arrive in time".to_owned();
            let next = timeout_at(until.min(Instant::now() + stall), body.next());
            match next.await.map_err(|_| late())? {
                None => Ok(None),
                Some(Err(error)) => Err(format!("the connection broke: {error}")),
                Some(Ok(frame)) => Ok(Some((frame.into_data().unwrap_or_default(), answer))),
            }
        })
    }
}

/// The problem for a file that could not be fetched.
pub(super) fn failed(why: &str) -> Problem {
    Problem::new(StatusCode::BAD_GATEWAY, "fetch-failed", "The server could not fetch the file").detail(why)
}
