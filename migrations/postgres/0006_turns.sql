-- Tenants take turns: jobs of one priority run in the order of their turns (src/store/jobs.rs).
ALTER TABLE jobs ADD COLUMN turn BIGINT NOT NULL DEFAULT 0;
UPDATE jobs SET turn = numbered.turn
    FROM (SELECT id, ROW_NUMBER() OVER (PARTITION BY tenant, priority ORDER BY created_ms, id) - 1 AS turn
          FROM jobs WHERE state = 'queued') AS numbered
    WHERE jobs.id = numbered.id;
DROP INDEX jobs_queue;
CREATE INDEX jobs_queue ON jobs (priority DESC, turn, created_ms, id) WHERE state = 'queued';
CREATE INDEX jobs_turns ON jobs (tenant, priority, turn) WHERE state IN ('queued', 'running');
