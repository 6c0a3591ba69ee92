-- Hash of the checkpoint's bytes, lower-case hex; NULL for checkpoints from before there was this column.
ALTER TABLE jobs ADD COLUMN checkpoint_sha256 TEXT;
