-- The hash of the photographs without poses that a capture was made of.
ALTER TABLE captures ADD COLUMN made_of TEXT;
CREATE INDEX captures_made_of ON captures (tenant, made_of) WHERE made_of IS NOT NULL;
