-- How many servers in succession ended during the validation of the upload's capture, without having been stopped.
ALTER TABLE uploads ADD COLUMN interrupted_validations BIGINT NOT NULL DEFAULT 0;
