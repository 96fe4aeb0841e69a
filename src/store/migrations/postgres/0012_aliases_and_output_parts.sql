-- Names for versions, which can be moved; see the embedded database.
CREATE TABLE dictionary_alias (
    handle      TEXT   COLLATE "C" NOT NULL,
    alias       TEXT   COLLATE "C" NOT NULL,
    tenant      TEXT   COLLATE "C" NOT NULL,
    dictionary  TEXT   COLLATE "C" NOT NULL REFERENCES dictionary (id) ON DELETE CASCADE,
    moves       BIGINT NOT NULL,
    moved_at_ms BIGINT NOT NULL,
    PRIMARY KEY (handle, alias)
);
CREATE INDEX dictionary_alias_version ON dictionary_alias (dictionary);
