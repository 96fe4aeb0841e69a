-- `handle` is what must be unique: `tenant/name` of what lives, the id of what lies in the trash, whose name is free again.

ALTER TABLE cohort RENAME COLUMN name TO handle;
ALTER TABLE cohort ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';
ALTER TABLE cohort ADD COLUMN name TEXT NOT NULL DEFAULT '';
ALTER TABLE cohort ADD COLUMN deleted_at_ms INTEGER;
UPDATE cohort SET name = handle, handle = 'default/' || handle;
CREATE INDEX cohort_tenant ON cohort (tenant, id);
CREATE INDEX cohort_deleted ON cohort (deleted_at_ms) WHERE deleted_at_ms IS NOT NULL;

ALTER TABLE dictionary_name RENAME COLUMN name TO handle;
UPDATE dictionary_name SET handle = 'default/' || handle;
ALTER TABLE dictionary RENAME COLUMN name TO handle;
ALTER TABLE dictionary ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';
ALTER TABLE dictionary ADD COLUMN name TEXT NOT NULL DEFAULT '';
ALTER TABLE dictionary ADD COLUMN deleted_at_ms INTEGER;
UPDATE dictionary SET name = handle, handle = 'default/' || handle;
CREATE INDEX dictionary_tenant ON dictionary (tenant, id);
CREATE INDEX dictionary_deleted ON dictionary (deleted_at_ms) WHERE deleted_at_ms IS NOT NULL;

ALTER TABLE job ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';
ALTER TABLE job ADD COLUMN cohort TEXT;
UPDATE job SET cohort = parameters ->> '$.cohort';
CREATE INDEX job_tenant ON job (tenant, id);
