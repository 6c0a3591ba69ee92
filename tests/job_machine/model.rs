//! A model of the job state machine: plain data and rules, without a database.

use std::collections::BTreeMap;

use relume::store::{LeaseStatus, Release};
use relume_api::jobs::JobState;

/// Steps of every job.
pub const TOTAL: i64 = 100;
/// Attempts without a new checkpoint after which a job fails.
pub const MOST_IDLE: i64 = 3;
/// Duration of a lease without a heartbeat.
pub const LEASE_MS: i64 = 60_000;
/// Time for which an idempotency key is remembered.
const KEY_MS: i64 = 24 * 3600 * 1000;
/// PSNR that a job with a quality gate requires.
pub const WANTED_PSNR: f64 = 28.0;

/// A deliberate mistake of the model, which the comparison must detect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrong {
    /// A job that was asked to stop may still publish.
    CancelledPublishes,
    /// A worker that has lost the lease may still write.
    StaleLeaseWrites,
    /// The oldest job runs first, independent of its priority.
    OldestFirst,
    /// A shutdown counts as an attempt without a checkpoint.
    ShutdownCounts,
    /// An idempotency key is remembered for ever.
    KeysLast,
    /// A job that has ended may be cancelled.
    EndedIsCancelled,
}

impl Wrong {
    pub const ALL: [Self; 6] = [
        Self::CancelledPublishes,
        Self::StaleLeaseWrites,
        Self::OldestFirst,
        Self::ShutdownCounts,
        Self::KeysLast,
        Self::EndedIsCancelled,
    ];
}

/// A worker's claim: the number of the job and of the attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Claim {
    pub job: usize,
    pub attempt: i64,
}

/// A job as the database should have it.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    pub state: JobState,
    pub priority: i64,
    pub attempts: i64,
    pub idle: i64,
    pub step: i64,
    pub checkpoint: Option<i64>,
    pub error: Option<String>,
    pub deleted: bool,
    pub leased: bool,
    pub models: i64,
}

/// Properties of a job that the database does not show.
#[derive(Debug, Clone)]
struct Hidden {
    gated: bool,
    /// The order among the jobs of one priority.
    turn: i64,
    lease_until_ms: i64,
}

/// An event: the job, the type, and the state in it.
pub type Event = (usize, String, Option<String>);

/// The result of a submission.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Submission {
    Created,
    Replayed(usize),
    IdempotencyKeyReused,
    PredecessorDeleted,
}

/// The result of a cancellation or deletion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    Done,
    TooLate,
    NotFound,
}

#[derive(Default)]
pub struct Model {
    wrong: Option<Wrong>,
    pub now_ms: i64,
    pub jobs: Vec<Job>,
    /// Events since this list was last emptied.
    pub events: Vec<Event>,
    hidden: Vec<Hidden>,
    /// Per idempotency key: its request, the job that it created, and the time.
    keys: BTreeMap<&'static str, (&'static str, usize, i64)>,
}

impl Model {
    /// An empty queue at time `now_ms`.
    pub fn new(wrong: Option<Wrong>, now_ms: i64) -> Self {
        Self { wrong, now_ms, ..Self::default() }
    }

    fn is(&self, wrong: Wrong) -> bool {
        self.wrong == Some(wrong)
    }

    fn tell(&mut self, job: usize, kind: &str, state: Option<JobState>) {
        self.events.push((job, kind.to_owned(), state.map(|state| state.name().to_owned())));
    }

    /// Changes a job's state and adds the event. Without a worker the job has no lease.
    fn turn(&mut self, job: usize, state: JobState) {
        let it = &mut self.jobs[job];
        it.state = state;
        it.leased = matches!(state, JobState::Running | JobState::Cancelling);
        self.tell(job, "state", Some(state));
    }

    pub fn submit(
        &mut self,
        priority: i64,
        gated: bool,
        key: Option<(&'static str, &'static str)>,
        retry_of: Option<usize>,
    ) -> Submission {
        let (now, last) = (self.now_ms, self.is(Wrong::KeysLast));
        self.keys.retain(|_, (_, _, at)| last || *at >= now - KEY_MS);
        if let Some((key, request)) = key
            && let Some((known, job, _)) = self.keys.get(key)
        {
            return if *known == request {
                Submission::Replayed(*job)
            } else {
                Submission::IdempotencyKeyReused
            };
        }
        if retry_of.is_some_and(|job| self.jobs[job].deleted) {
            return Submission::PredecessorDeleted;
        }
        let (job, turn) = (self.jobs.len(), self.next_turn(priority));
        self.jobs.push(Job {
            state: JobState::Queued,
            priority,
            attempts: 0,
            idle: 0,
            step: 0,
            checkpoint: None,
            error: None,
            deleted: false,
            leased: false,
            models: 0,
        });
        self.hidden.push(Hidden { gated, turn, lease_until_ms: 0 });
        self.turn(job, JobState::Queued);
        if let Some((key, request)) = key {
            self.keys.insert(key, (request, job, now));
        }
        Submission::Created
    }

    pub fn claim(&mut self) -> Option<Claim> {
        let by_age = self.is(Wrong::OldestFirst);
        let place = |job: &usize| {
            let (priority, turn) = (-self.jobs[*job].priority, self.hidden[*job].turn);
            if by_age { (0, 0, *job) } else { (priority, turn, *job) }
        };
        let waiting = (0..self.jobs.len()).filter(|job| self.jobs[*job].state == JobState::Queued);
        let job = waiting.min_by_key(place)?;
        self.jobs[job].attempts += 1;
        self.jobs[job].idle += 1;
        self.hidden[job].lease_until_ms = self.now_ms + LEASE_MS;
        self.turn(job, JobState::Running);
        Some(Claim { job, attempt: self.jobs[job].attempts })
    }

    /// Whether a claim is still valid.
    pub fn status(&self, claim: Claim) -> LeaseStatus {
        let job = &self.jobs[claim.job];
        let stands = job.attempts == claim.attempt || self.is(Wrong::StaleLeaseWrites);
        match job.state {
            JobState::Running if stands => LeaseStatus::Held,
            JobState::Cancelling if stands => LeaseStatus::Cancelling,
            _ => LeaseStatus::Lost,
        }
    }

    pub fn progress(&mut self, claim: Claim, step: i64) -> LeaseStatus {
        let status = self.status(claim);
        if status != LeaseStatus::Lost {
            self.jobs[claim.job].step = step;
            self.hidden[claim.job].lease_until_ms = self.now_ms + LEASE_MS;
            self.tell(claim.job, "progress", None);
        }
        status
    }

    pub fn checkpoint(&mut self, claim: Claim, step: i64) -> LeaseStatus {
        let status = self.status(claim);
        if status != LeaseStatus::Lost {
            let job = &mut self.jobs[claim.job];
            (job.checkpoint, job.idle) = (Some(step), 0);
            self.tell(claim.job, "checkpoint", None);
        }
        status
    }

    pub fn warn(&mut self, claim: Claim) -> LeaseStatus {
        let status = self.status(claim);
        if status != LeaseStatus::Lost {
            self.tell(claim.job, "warning", None);
        }
        status
    }

    pub fn release(&mut self, claim: Claim, release: Release) -> LeaseStatus {
        if self.status(claim) != LeaseStatus::Held {
            return LeaseStatus::Lost;
        }
        let given_back = match release {
            Release::AttemptFailed => 0,
            Release::Shutdown if self.is(Wrong::ShutdownCounts) => 0,
            Release::Shutdown | Release::Outage | Release::NoRoom | Release::Preempted => 1,
        };
        let job = &mut self.jobs[claim.job];
        job.idle = (job.idle - given_back).max(0);
        if release == Release::NoRoom {
            job.step = job.checkpoint.unwrap_or(0);
            self.tell(claim.job, "warning", None);
        }
        self.turn(claim.job, JobState::Queued);
        LeaseStatus::Held
    }

    pub fn publish(&mut self, claim: Claim, psnr: f64) -> LeaseStatus {
        match self.status(claim) {
            LeaseStatus::Cancelling if self.is(Wrong::CancelledPublishes) => {}
            LeaseStatus::Held => {}
            refused => return refused,
        }
        let misses = self.hidden[claim.job].gated && psnr < WANTED_PSNR;
        self.jobs[claim.job].step = TOTAL;
        self.jobs[claim.job].models += 1;
        self.turn(claim.job, if misses { JobState::Rejected } else { JobState::Succeeded });
        LeaseStatus::Held
    }

    /// The worker ends a job as failed (with a code) or as cancelled.
    pub fn end(&mut self, claim: Claim, code: Option<&str>) -> LeaseStatus {
        if self.status(claim) == LeaseStatus::Lost {
            return LeaseStatus::Lost;
        }
        self.jobs[claim.job].error = code.map(str::to_owned);
        self.turn(claim.job, if code.is_some() { JobState::Failed } else { JobState::Cancelled });
        LeaseStatus::Held
    }

    pub fn cancel(&mut self, job: usize) -> Answer {
        if self.jobs[job].deleted {
            return Answer::NotFound;
        }
        match self.jobs[job].state {
            JobState::Queued => self.turn(job, JobState::Cancelled),
            JobState::Running => self.turn(job, JobState::Cancelling),
            JobState::Cancelling | JobState::Cancelled => {}
            _ if self.is(Wrong::EndedIsCancelled) => self.turn(job, JobState::Cancelled),
            _ => return Answer::TooLate,
        }
        Answer::Done
    }

    pub fn delete(&mut self, job: usize, cascade: bool) -> Answer {
        let state = self.jobs[job].state;
        let runs = matches!(state, JobState::Running | JobState::Cancelling);
        if self.jobs[job].deleted {
            return Answer::NotFound;
        }
        if runs && !cascade {
            return Answer::TooLate;
        }
        self.jobs[job].deleted = true;
        match state {
            JobState::Queued => self.turn(job, JobState::Cancelled),
            JobState::Running => self.turn(job, JobState::Cancelling),
            _ => {}
        }
        Answer::Done
    }

    pub fn set_priority(&mut self, job: usize, priority: i64) -> bool {
        let waits = self.jobs[job].state == JobState::Queued;
        if waits && self.jobs[job].priority != priority {
            self.hidden[job].turn = self.next_turn(priority);
            self.jobs[job].priority = priority;
        }
        waits
    }

    /// The turn after those of the waiting and running jobs of a priority. All jobs are of one tenant.
    fn next_turn(&self, priority: i64) -> i64 {
        let waits = |job: &Job| matches!(job.state, JobState::Queued | JobState::Running);
        let jobs = self.jobs.iter().zip(&self.hidden);
        let turns =
            jobs.filter(|(job, _)| waits(job) && job.priority == priority).map(|(_, hidden)| hidden.turn);
        turns.max().map_or(0, |last| last + 1)
    }

    /// Reclaims the expired leases, or all; returns their number.
    pub fn reclaim(&mut self, all: bool) -> usize {
        let mut taken = 0;
        for job in 0..self.jobs.len() {
            if !self.jobs[job].leased || (!all && self.hidden[job].lease_until_ms >= self.now_ms) {
                continue;
            }
            taken += 1;
            if self.jobs[job].state == JobState::Cancelling {
                self.turn(job, JobState::Cancelled);
            } else if self.jobs[job].idle >= MOST_IDLE {
                self.jobs[job].error = Some("attempts_exhausted".to_owned());
                self.turn(job, JobState::Failed);
            } else {
                self.turn(job, JobState::Queued);
            }
        }
        taken
    }

    /// Whether a checkpoint of a job is on disk; `None` for a deleted job.
    pub fn keeps_file(&self, job: usize) -> Option<bool> {
        let it = &self.jobs[job];
        (!it.deleted).then(|| it.checkpoint.is_some() && !it.state.is_terminal())
    }
}
