-- Keys of programs: the digest of each, never its text. None is ever removed: as long as there is one, nobody is let in without.

CREATE TABLE api_key (
    id            TEXT    PRIMARY KEY,
    tenant        TEXT    NOT NULL,
    name          TEXT    NOT NULL,
    role          TEXT    NOT NULL,
    cohorts       TEXT,
    digest        BLOB    NOT NULL,
    created_at_ms INTEGER NOT NULL,
    expires_at_ms INTEGER,
    revoked_at_ms INTEGER,
    used_at_ms    INTEGER
) STRICT;
CREATE INDEX api_key_tenant ON api_key (tenant, id);
