-- Files that a job works on, in pieces. They come with the job and go when it ends.
CREATE TABLE job_file (
    job      TEXT   COLLATE "C" NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    name     TEXT   COLLATE "C" NOT NULL,
    piece    BIGINT NOT NULL,
    checksum BYTEA  NOT NULL,
    data     BYTEA  NOT NULL,
    PRIMARY KEY (job, name, piece)
);
