-- What the capture that is being made of an upload is called.
ALTER TABLE uploads ADD COLUMN name TEXT;
ALTER TABLE uploads ADD COLUMN external_id TEXT;
ALTER TABLE uploads ADD COLUMN labels TEXT NOT NULL DEFAULT '{}';
