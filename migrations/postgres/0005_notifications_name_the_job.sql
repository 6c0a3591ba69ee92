-- A notification on `relume_jobs` names the job whose history goes on, so that only its listeners query the tables.
DROP TRIGGER events_are_told ON events;

CREATE OR REPLACE FUNCTION tell_of_events() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('relume_jobs', NEW.job_id);
    RETURN NULL;
END;
$$;

CREATE TRIGGER events_are_told AFTER INSERT ON events FOR EACH ROW EXECUTE FUNCTION tell_of_events();
