-- What is deleted is marked first. Its row stays until its files are removed (swept_ms) and no other row refers to it.
ALTER TABLE captures ADD COLUMN deleted_ms INTEGER;
ALTER TABLE captures ADD COLUMN swept_ms INTEGER;
ALTER TABLE environments ADD COLUMN deleted_ms INTEGER;
ALTER TABLE jobs ADD COLUMN deleted_ms INTEGER;
ALTER TABLE jobs ADD COLUMN swept_ms INTEGER;
-- When the model of the job was deleted.
ALTER TABLE jobs ADD COLUMN model_deleted_ms INTEGER;
ALTER TABLE models ADD COLUMN deleted_ms INTEGER;

CREATE INDEX jobs_to_sweep ON jobs (deleted_ms) WHERE deleted_ms IS NOT NULL AND swept_ms IS NULL;
CREATE INDEX jobs_swept ON jobs (swept_ms) WHERE swept_ms IS NOT NULL;
CREATE INDEX jobs_of_capture ON jobs (capture_id);
CREATE INDEX jobs_retried ON jobs (retry_of);
CREATE INDEX models_of_capture ON models (capture_id);
CREATE INDEX captures_deleted ON captures (id) WHERE deleted_ms IS NOT NULL;
CREATE INDEX environments_deleted ON environments (id) WHERE deleted_ms IS NOT NULL;
CREATE INDEX models_deleted ON models (id) WHERE deleted_ms IS NOT NULL;
