-- Passes of a job are computed by its process or by the engine, and not in parts by other replicas.
DROP TABLE task;
DROP TABLE pass;
