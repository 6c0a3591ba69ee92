-- The key that made a key, if one did: what it made ends with it.
ALTER TABLE keys ADD COLUMN made_by TEXT REFERENCES keys (id);

CREATE INDEX keys_made_by ON keys (made_by) WHERE made_by IS NOT NULL;
