-- Keys of programs: the digest of each, never its text. None is ever removed: as long as there is one, nobody is let in without.

CREATE TABLE api_key (
    id            TEXT   COLLATE "C" PRIMARY KEY,
    tenant        TEXT   COLLATE "C" NOT NULL,
    name          TEXT   NOT NULL,
    role          TEXT   NOT NULL,
    cohorts       TEXT,
    digest        BYTEA  NOT NULL,
    created_at_ms BIGINT NOT NULL,
    expires_at_ms BIGINT,
    revoked_at_ms BIGINT,
    used_at_ms    BIGINT
);
CREATE INDEX api_key_tenant ON api_key (tenant, id);
