-- The secret that a webhook had before, which signs beside the new one until its receiver has taken that over.
ALTER TABLE webhooks ADD COLUMN former_secret BLOB;
ALTER TABLE webhooks ADD COLUMN former_until_ms INTEGER;
