//! Preemption: a running job returns to the queue with its checkpoint, so that others get their turn.

use crate::store::sql::{self, Sql, Tx};
use crate::store::{Store, StoreError};
use relume_api::{JobId, TenantId};

/// Time that a job waits before it preempts another, milliseconds. Idle workers claim it within this time.
const MIN_WAIT_MS: i64 = 1000;

impl Store {
    /// Whether a job waits that should run before the job leased with `token`, and that its worker can run: a job of a higher priority, or
    /// one of the same priority of another tenant that has no running job.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn should_yield(&self, job: &JobId, token: &str, now_ms: i64) -> Result<bool, StoreError> {
        let query = sql::query_scalar(SHOULD_YIELD).bind(job).bind(token).bind(now_ms - MIN_WAIT_MS);
        Ok(query.fetch_one(self.pool()).await?)
    }
}

/// Moves the running job leased with `token`, and the queued jobs of its tenant, behind the first job of the same priority that should run
/// before it, if there is one. The jobs of the tenant keep their order.
pub(super) async fn move_behind_others(tx: &mut Tx, job: &JobId, token: &str) -> Result<(), StoreError> {
    let query = sql::query_as(FIRST_RIVAL).bind(job).bind(token).bind(i64::MAX);
    let rival: Option<(TenantId, i64, i64, i64)> = query.fetch_optional(&mut *tx).await?;
    let Some((tenant, priority, turn, first)) = rival.filter(|(_, _, turn, first)| first >= turn) else {
        return Ok(());
    };
    let query = sql::query(
        "UPDATE jobs SET turn = turn + $4
         WHERE (state = 'queued' OR id = $1) AND tenant = $2 AND priority = $3",
    );
    query.bind(job).bind(&tenant).bind(priority).bind(first + 1 - turn).execute(tx).await?;
    Ok(())
}

/// The jobs that should run before the job `mine` and have waited since `$3`. Jobs of unregistered workers have no row in `workers`; such
/// workers can run all jobs that require no labels.
macro_rules! rivals {
    ($before:literal, $has_all:literal, $after:literal) => {
        concat!(
            $before,
            " FROM jobs AS mine
                 JOIN jobs AS waiting ON waiting.state = 'queued'
                 LEFT JOIN workers ON workers.id = mine.worker
             WHERE mine.id = $1 AND mine.lease_token = $2 AND mine.state = 'running'
                 AND waiting.created_ms <= $3
                 AND (waiting.device <> 'gpu' OR COALESCE(workers.has_gpu, TRUE))
                 AND NOT COALESCE(workers.draining, FALSE)
                 AND (waiting.priority > mine.priority
                      OR waiting.priority = mine.priority AND waiting.tenant <> mine.tenant
                         AND NOT EXISTS (SELECT 1 FROM jobs AS others
                             WHERE others.tenant = waiting.tenant AND others.state IN ('running', 'cancelling')))
                 AND ",
            $has_all,
            $after
        )
    };
    ($before:literal, $after:literal) => {
        Sql::each(
            rivals!(
                $before,
                "NOT EXISTS (SELECT 1 FROM json_each(waiting.requires) AS wanted WHERE wanted.value NOT IN
                     (SELECT value FROM json_each(COALESCE(workers.labels, '[]'))))",
                $after
            ),
            rivals!($before, "waiting.requires <@ COALESCE(workers.labels, '[]')", $after),
        )
    };
}

const SHOULD_YIELD: Sql = rivals!("SELECT EXISTS (SELECT 1", ")");

/// Tenant, priority and turn of the job, and the first turn of its rivals of the same priority.
const FIRST_RIVAL: Sql = rivals!(
    "SELECT mine.tenant, mine.priority, mine.turn, MIN(waiting.turn)",
    " AND waiting.priority = mine.priority GROUP BY mine.tenant, mine.priority, mine.turn"
);
