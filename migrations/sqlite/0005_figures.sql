-- What a job asks of its model, and what was found: JSON objects.
ALTER TABLE jobs ADD COLUMN quality_gate TEXT NOT NULL DEFAULT '{}';
ALTER TABLE jobs ADD COLUMN figures TEXT;

-- One more state. SQLite cannot change a CHECK; its documentation gives this way for constraints that say nothing of what is
-- stored. Rows, columns, indexes and references stay as they are, and another state is refused as before.
PRAGMA writable_schema = ON;
UPDATE sqlite_schema
    SET sql = replace(sql, '''succeeded'', ''failed''', '''succeeded'', ''rejected'', ''failed''')
    WHERE type = 'table' AND name = 'jobs';
PRAGMA writable_schema = RESET;

DROP TRIGGER jobs_terminal_states_never_change;
CREATE TRIGGER jobs_terminal_states_never_change
BEFORE UPDATE OF state ON jobs
WHEN OLD.state IN ('succeeded', 'rejected', 'failed', 'cancelled') AND NEW.state <> OLD.state
BEGIN
    SELECT RAISE (ABORT, 'a terminal job state never changes');
END;
