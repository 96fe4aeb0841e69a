//! TPS: landmarks and curves of specimens, as tpsDig and its relatives write them.
//!
//! ```text
//! LM=2              number of landmarks in the plane; LM3= in space
//! 1.5 2
//! NA NA             a missing one
//! CURVES=1          number of curves; OUTLINES= for closed ones
//! POINTS=2
//! 0 0
//! 1 0
//! IMAGE=a.jpg
//! ID=a              ends nothing: the next LM= does
//! SCALE=0.02        length of a pixel
//! ```

mod read;
mod write;

use super::format::Format;
use super::record::Kind;

/// TPS.
pub(super) static FORMAT: Format = Format {
    id: "tps",
    name: "TPS",
    media_types: &["application/x-tps"],
    extensions: &["tps"],
    recognise: |head| {
        let start = head.trim_ascii_start();
        ["LM=", "LM3="]
            .iter()
            .any(|key| start.get(..key.len()).is_some_and(|start| start.eq_ignore_ascii_case(key.as_bytes())))
    },
    kinds: &[Kind::Landmarks, Kind::Curve],
    options: &["scale", "curves", "missing", "closed"],
    read: Some(read::read),
    open: Some(write::open),
};

#[cfg(test)]
mod tests {
    use super::super::record::Geometry;
    use super::super::testing::{check_truncations, converted, fault, records};
    use super::super::{Curves, Limits, ReadOptions, Scale};
    use super::*;

    const TWO: &str = concat!(
        "LM=3\n1.5 2\nNA NA\n-1 0.1\nCURVES=2\nPOINTS=2\n0 0\n1 0\nPOINTS=1\n7 7\nOUTLINES=1\nPOINTS=3\n0 0\n1 0\n0 1\n",
        "IMAGE=C:\\x\\a.jpg\nID=a b\nCOMMENT=one\nCOMMENT=two\nVARIABLES=2\n3.5\nSCALE=0.5\nWHO=me\n\n",
        "LM3=1\n1 2 3\nID=c\n\n",
    );

    fn options(scale: Option<Scale>, curves: Option<Curves>) -> ReadOptions {
        ReadOptions { scale, curves, ..ReadOptions::default() }
    }

    #[test]
    fn a_file_is_written_as_it_was_read() {
        let leave = options(Some(Scale::Leave), None);
        let (found, summary) = records(&FORMAT, TWO, &leave).expect("a valid file");
        assert_eq!((found.len(), summary.warnings), (5, vec![]));
        let names: Vec<_> = found.iter().filter_map(|record| record.name.as_deref()).collect();
        assert_eq!(names, ["a b", "a b curve 1", "a b curve 2", "a b curve 3", "c"]);
        assert_eq!(found[3].geometry.kind(), Kind::Curve);
        assert!(matches!(found[3].geometry, Geometry::Curve { closed: true, .. }));
        assert_eq!(found[0].metadata["variables"], serde_json::json!(["2", "3.5"]));
        assert_eq!(converted(&FORMAT, &found), TWO);
    }

    #[test]
    fn scales_are_applied_if_every_specimen_has_one() {
        let one = "LM=1\n3 -4\nSCALE=0.5\nID=a\nLM=1\n1 1\n";
        let (found, summary) = records(&FORMAT, one, &ReadOptions::default()).expect("a valid file");
        assert_eq!(converted(&FORMAT, &found), "LM=1\n3 -4\nID=a\nSCALE=0.5\n\nLM=1\n1 1\n\n");
        let expected = "1 of 2 specimens have SCALE=: coordinates are those of the file; the first without begins in line 5";
        assert_eq!(summary.warnings, [expected]);
        let both = format!("{one}SCALE=2");
        let (found, summary) = records(&FORMAT, &both, &ReadOptions::default()).expect("a valid file");
        assert_eq!(converted(&FORMAT, &found), "LM=1\n1.5 -2\nID=a\n\nLM=1\n2 2\n\n");
        assert_eq!(summary.properties["scale"], "applied");
        assert_eq!(found[0].metadata["scale_applied"], 0.5);
        let apply = options(Some(Scale::Apply), None);
        assert_eq!(fault(&FORMAT, one, &apply), "line 5: expected SCALE= in every specimen, got one without");
    }

    #[test]
    fn curves_are_given_as_asked() {
        let lengths = |curves| {
            let (found, summary) = records(&FORMAT, TWO, &options(None, Some(curves))).expect("a valid file");
            let points = |record: &super::super::Record| match &record.geometry {
                Geometry::Landmarks(points) | Geometry::Curve { points, .. } => points.len(),
                _ => 0,
            };
            let dropped: u64 = summary.dropped.iter().map(|dropped| dropped.count).sum();
            (found.iter().map(points).collect::<Vec<_>>(), dropped)
        };
        assert_eq!(lengths(Curves::Separate), (vec![3, 2, 1, 3, 1], 0));
        assert_eq!(lengths(Curves::Append), (vec![9, 1], 0));
        assert_eq!(lengths(Curves::Skip), (vec![3, 1], 3));
        assert_eq!(lengths(Curves::Only), (vec![2, 1, 3], 2));
    }

    #[test]
    fn metadata_that_would_be_keys_are_refused_by_name() {
        let (mut found, _) =
            records(&FORMAT, "LM=1\n1 2\nID=a\n", &ReadOptions::default()).expect("a valid file");
        found[0].metadata.insert("variables".into(), serde_json::json!(["1", "LM=3"]));
        let error = super::super::testing::written(&FORMAT, &found, &super::super::WriteOptions::default());
        let expected = "expected one line of values without '=' in variables, got 'LM=3'";
        assert!(error.expect_err("a key").to_string().ends_with(expected));
        found[0].metadata =
            [("other".into(), serde_json::json!({"LM": "3", "WHO": "me"}))].into_iter().collect();
        assert_eq!(converted(&FORMAT, &found), "LM=1\n1 2\nID=a\nWHO=me\n\n");
    }

    #[test]
    fn negative_points_are_missing_if_asked() {
        let text = "LM=2\n-1 -1\n5 3\n";
        let (found, summary) = records(&FORMAT, text, &ReadOptions::default()).expect("a valid file");
        assert_eq!(
            (converted(&FORMAT, &found).as_str(), summary.warnings.len()),
            ("LM=2\n-1 -1\n5 3\n\n", 1)
        );
        for missing in ["negative", "-1"] {
            let options = ReadOptions { missing: Some(missing.into()), ..ReadOptions::default() };
            let (found, summary) = records(&FORMAT, text, &options).expect("a valid file");
            assert_eq!(
                (converted(&FORMAT, &found).as_str(), summary.warnings.len()),
                ("LM=2\nNA NA\n5 3\n\n", 0)
            );
        }
        let options = ReadOptions { missing: Some("x".into()), ..ReadOptions::default() };
        assert_eq!(fault(&FORMAT, text, &options), "expected a number or 'negative' as missing, got 'x'");
    }

    #[test]
    fn faults_name_their_line() {
        for (text, message) in [
            ("x", "line 1: expected LM= or LM3= at the start of a specimen, got 'x'"),
            ("LM=-1\n", "line 1: expected a whole number, got '-1'"),
            ("LM=99999999999999999999\n", "line 1: expected a whole number, got '99999999999999999999'"),
            ("LM=9999999999\n", "line 1: expected at most 4194304 points of a shape, got 9999999999"),
            ("LM=2\n1 2\n", "line 2: expected 2 points, got the end of the file after 1"),
            ("LM=2\n1 2\nID=a\n", "line 3: expected 2 points, got 'ID=a' after 1"),
            ("LM=2\n1 2\n1 2 3\n", "line 3: expected 2 coordinates, got 3"),
            ("LM=1\n1\n", "line 2: expected 2 coordinates, got 1"),
            ("LM3=1\n1 2\n", "line 2: expected 3 coordinates, got 2"),
            ("LM=1\n1 inf\n", "line 2: expected a number, got 'inf'"),
            ("LM=1\n1 NA\n", "line 2: expected all coordinates of a point or none, got 1 of 2 in point 0"),
            ("LM=1\n1 2\nSCALE=0\n", "line 3: expected a positive SCALE=, got 0"),
            ("LM=1\n1 2\n3 4\n", "line 3: expected KEY=value or LM=, got '3 4'"),
            ("LM=0\nCURVES=1\nID=a\n", "line 3: expected POINTS=, got 'ID=a'"),
            (
                "LM=1\n1e300 1\nSCALE=1e300\n",
                "item 0, line 1: expected coordinates within ±1e100, got inf in point 0",
            ),
        ] {
            assert_eq!(fault(&FORMAT, text, &ReadOptions::default()), message);
        }
        check_truncations(&FORMAT, TWO.as_bytes());
        let limits = Limits { points: 8, ..Limits::default() };
        let error =
            super::super::testing::records_within(&FORMAT, TWO.as_bytes(), &ReadOptions::default(), limits)
                .expect_err("too many points");
        assert_eq!(error.to_string(), "line 12: expected at most 8 points of a shape, got 9");
    }
}
