-- See the same step of the embedded database for the reasons.

ALTER TABLE shape ADD COLUMN clockwise BIGINT;
ALTER TABLE shape ADD COLUMN fit_mean DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN fit_largest DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN fit_area DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN given_start DOUBLE PRECISION;
ALTER TABLE shape ADD COLUMN given_reversed BIGINT;
