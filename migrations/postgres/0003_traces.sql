-- The trace of the request that made a job, as a W3C `traceparent`: what its attempts are spans of.
ALTER TABLE jobs ADD COLUMN traceparent TEXT;
