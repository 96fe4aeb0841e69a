-- The row is the queue: a job is claimed by setting an owner and the end of the lease, and every later write of
-- the claimant names owner and attempt.

CREATE TABLE job (
    id             TEXT    NOT NULL PRIMARY KEY,
    kind           TEXT    NOT NULL,
    parameters     TEXT    NOT NULL,
    status         TEXT    NOT NULL,
    progress       REAL    NOT NULL,
    phase          TEXT,
    objective      REAL,
    attempt        INTEGER NOT NULL,
    run_at_ms      INTEGER NOT NULL,
    lease_owner    TEXT,
    lease_until_ms INTEGER,
    created_at_ms  INTEGER NOT NULL,
    started_at_ms  INTEGER,
    finished_at_ms INTEGER,
    result         TEXT,
    problem        TEXT
) STRICT;
CREATE INDEX job_status ON job (status, id);
CREATE INDEX job_finished ON job (finished_at_ms, id) WHERE finished_at_ms IS NOT NULL;
