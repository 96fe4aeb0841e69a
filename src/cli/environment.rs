//! Variables of the environment whose names begin like those of settings. A misspelt one is refused: a setting that has no effect, such as
//! the one that makes the audit trail mandatory, would be found out too late.

use std::collections::BTreeSet;

/// Beginning of the names of settings.
const PREFIX: &str = "SHAPELEX_";
/// Names that are not settings: of the build, of the engine and its script, and of the tests of the page.
const OTHERS: [&str; 10] = [
    "SHAPELEX_BINARY",
    "SHAPELEX_COMMIT",
    "SHAPELEX_ENGINE_AUTHORITY",
    "SHAPELEX_ENGINE_BUILD",
    "SHAPELEX_ENGINE_CERTIFICATE",
    "SHAPELEX_ENGINE_KEY",
    "SHAPELEX_ENGINE_LOG",
    "SHAPELEX_ENGINE_METRICS",
    "SHAPELEX_ENGINE_PYTHON",
    "SHAPELEX_TOKEN",
];
/// Beginnings of the names of tests, benches and fuzz targets, and of variables of the build script, which `cargo run` hands on.
const FAMILIES: [&str; 4] = ["SHAPELEX_BUILD_", "SHAPELEX_TEST_", "SHAPELEX_BENCH_", "SHAPELEX_FUZZ_"];

/// Refuses variables that begin like settings and are none of `settings`, with the most similar name.
///
/// # Errors
/// One sentence about all of them.
pub(super) fn check(
    variables: impl Iterator<Item = (String, String)>,
    settings: &BTreeSet<String>,
) -> Result<(), String> {
    let unknown: BTreeSet<String> = variables
        .filter(|(name, value)| name.starts_with(PREFIX) && !is_of_a_cluster(name, value))
        .map(|(name, _)| name)
        .filter(|name| !settings.contains(name) && !OTHERS.contains(&name.as_str()))
        .filter(|name| !FAMILIES.iter().any(|family| name.starts_with(family)))
        .collect();
    if unknown.is_empty() {
        return Ok(());
    }
    let of_one = |name: &String| match settings.iter().min_by_key(|setting| edits(name, setting)) {
        Some(nearest) => format!("{name} (did you mean {nearest}?)"),
        None => name.clone(),
    };
    let listed: Vec<String> = unknown.iter().map(of_one).collect();
    Err(format!("expected variables of the environment that name settings, got {}", listed.join(", ")))
}

/// Whether a cluster sets the variable for a service whose name begins with `shapelex`: Kubernetes gives every container the addresses of
/// the services beside it, such as `SHAPELEX_PORT=tcp://10.0.0.7:8080`.
fn is_of_a_cluster(name: &str, value: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let of_port = name.split_once("_PORT_").is_some_and(|(_, rest)| {
        let mut parts = rest.split('_');
        parts.next().is_some_and(is_number)
            && parts.next().is_some_and(|kind| ["TCP", "UDP", "SCTP"].contains(&kind))
    });
    let is_link = name.ends_with("_PORT") && value.contains("://");
    of_port || is_link || name.ends_with("_SERVICE_HOST") || name.contains("_SERVICE_PORT")
}

/// Number of single letters to insert, remove or replace that turn one word into the other.
fn edits(from: &str, to: &str) -> usize {
    let mut row: Vec<usize> = (0..=to.len()).collect();
    for (i, letter) in from.bytes().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, other) in to.bytes().enumerate() {
            let replaced = diagonal + usize::from(letter != other);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[to.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(variables: &[(&str, &str)]) -> Result<(), String> {
        let settings = ["SHAPELEX_THREADS", "SHAPELEX_LISTEN", "SHAPELEX_AUDIT_REQUIRED"].map(str::to_owned);
        let variables = variables.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
        check(variables, &settings.into())
    }

    #[test]
    fn a_misspelt_variable_is_refused_with_the_nearest_name() {
        let refused = checked(&[("SHAPELEX_THREDS", "2"), ("SHAPELEX_AUDIT_REQUIRE", "true"), ("HOME", "/")]);
        assert_eq!(
            refused.unwrap_err(),
            "expected variables of the environment that name settings, got SHAPELEX_AUDIT_REQUIRE (did you mean \
             SHAPELEX_AUDIT_REQUIRED?), SHAPELEX_THREDS (did you mean SHAPELEX_THREADS?)"
        );
        assert!(checked(&[("SHAPELEX_PORT", "8080")]).is_err(), "no address of a cluster");
    }

    #[test]
    fn settings_and_what_others_set_are_accepted() {
        let accepted = [
            ("SHAPELEX_THREADS", "2"),
            ("SHAPELEX_TEST_DATABASE_URL", "postgres://"),
            ("SHAPELEX_BUILD_LINE", "0.1.0"),
            ("SHAPELEX_ENGINE_KEY", "key.pem"),
            ("SHAPELEX_PORT", "tcp://10.0.0.7:8080"),
            ("SHAPELEX_PORT_8080_TCP_ADDR", "10.0.0.7"),
            ("SHAPELEX_SERVICE_HOST", "10.0.0.7"),
            ("SHAPELEX_ENGINE_SERVICE_PORT_GRPC", "50050"),
        ];
        assert_eq!(checked(&accepted), Ok(()));
    }

    #[test]
    fn edits_are_counted() {
        for (from, to, wanted) in
            [("", "abc", 3), ("abc", "abc", 0), ("abc", "ac", 1), ("kitten", "sitting", 3)]
        {
            assert_eq!(edits(from, to), wanted, "{from} {to}");
        }
    }
}
