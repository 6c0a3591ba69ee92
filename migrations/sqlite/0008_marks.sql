-- What people and their programs call things. Labels are a JSON object; environments have a name already.
ALTER TABLE captures ADD COLUMN name TEXT;
ALTER TABLE captures ADD COLUMN external_id TEXT;
ALTER TABLE captures ADD COLUMN labels TEXT NOT NULL DEFAULT '{}';
ALTER TABLE environments ADD COLUMN external_id TEXT;
ALTER TABLE environments ADD COLUMN labels TEXT NOT NULL DEFAULT '{}';
ALTER TABLE jobs ADD COLUMN name TEXT;
ALTER TABLE jobs ADD COLUMN external_id TEXT;
ALTER TABLE jobs ADD COLUMN labels TEXT NOT NULL DEFAULT '{}';
ALTER TABLE models ADD COLUMN name TEXT;
ALTER TABLE models ADD COLUMN external_id TEXT;
ALTER TABLE models ADD COLUMN labels TEXT NOT NULL DEFAULT '{}';

CREATE INDEX captures_by_external_id ON captures (tenant, external_id) WHERE external_id IS NOT NULL;
CREATE INDEX environments_by_external_id ON environments (tenant, external_id) WHERE external_id IS NOT NULL;
CREATE INDEX jobs_by_external_id ON jobs (tenant, external_id) WHERE external_id IS NOT NULL;
CREATE INDEX models_by_external_id ON models (tenant, external_id) WHERE external_id IS NOT NULL;
