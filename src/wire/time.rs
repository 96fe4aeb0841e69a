//! Times as text.

use jiff::Timestamp;

/// Milliseconds since 1970 as RFC 3339 in UTC; the number itself beyond the years that RFC 3339 can write.
pub fn rfc3339(ms: i64) -> String {
    Timestamp::from_millisecond(ms).map_or_else(|_| ms.to_string(), |time| time.to_string())
}

#[cfg(test)]
mod tests {
    use super::rfc3339;

    #[test]
    fn times_are_in_utc_with_the_milliseconds_that_count() {
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00Z");
        assert_eq!(rfc3339(1_800_000_000_250), "2027-01-15T08:00:00.25Z");
        assert_eq!(rfc3339(i64::MAX), i64::MAX.to_string());
    }
}
