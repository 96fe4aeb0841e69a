//! Tables of points: CSV with one shape or one point a row.
//!
//! ```text
//! id,label,age,x1,y1,x2,y2        wide: one shape a row
//! a,f,12,0,0,1.5,2
//!
//! id,label,x,y                    long: one point a row
//! a,f,0,0
//! a,f,1.5,2
//! ```
//!
//! Separated by commas, semicolons or tabs, whichever the first line has most of. An empty field, `NA` and `NaN` are missing.

mod attributes;
mod columns;
mod read;
mod write;

pub use attributes::{AttributeRow, attribute_rows};

use super::format::Format;
use super::record::Kind;

/// Tables of points.
pub(super) static FORMAT: Format = Format {
    id: "csv",
    name: "CSV",
    media_types: &["text/csv", "text/tab-separated-values"],
    extensions: &["csv", "tsv"],
    recognise: |_| false,
    kinds: &[Kind::Landmarks, Kind::Curve],
    options: &["columns", "missing", "dimension", "closed", "decimal", "attributes"],
    read: Some(read::read),
    open: Some(write::open),
};

/// Letters of the coordinates.
const AXES: [&str; 3] = ["x", "y", "z"];

#[cfg(test)]
mod tests {
    use super::super::record::Geometry;
    use super::super::testing::{check_truncations, fault, records, records_within, written};
    use super::super::{Columns, Layout, Limits, ReadOptions, Record, WriteOptions};
    use super::*;
    use crate::value::Value;

    const WIDE: &str =
        "id,label,age,left,x1,y1,x2,y2\na,f,12.5,true,0,0.1,1.5,-2\n\"b, c\",,,false,NA,NA,1,1\n";
    const CURVES: &str = "id,label,closed,side,point,x,y,z\na,f,true,\"l \"\"x\"\"\",1,0,0,0\na,f,true,\"l \"\"x\"\"\",2,1,0,0.5\nb,,false,,1,7,7,7\n";

    fn read(text: &str) -> Vec<Record> {
        records(&FORMAT, text, &ReadOptions::default()).expect("a valid table").0
    }

    fn columns(text: &str) -> ReadOptions {
        serde_json::from_str(text).expect("options")
    }

    fn coordinates(record: &Record) -> &[f64] {
        match &record.geometry {
            Geometry::Landmarks(points) | Geometry::Curve { points, .. } => points.coordinates(),
            _ => &[],
        }
    }

    #[test]
    fn tables_are_written_as_they_were_read() {
        let found = read(WIDE);
        assert_eq!(
            found[0].labels,
            [("age".into(), Value::Number(12.5)), ("left".into(), Value::Bool(true))].into()
        );
        assert_eq!(
            (found[1].name.as_deref(), found[1].label.as_deref(), found[1].labels.len()),
            (Some("b, c"), None, 1)
        );
        let (text, summary) = written(&FORMAT, &found, &WriteOptions::default()).expect("written");
        assert_eq!((text.as_str(), summary.dropped.len()), (WIDE, 0));
        let found = read(CURVES);
        assert!(matches!(found[0].geometry, Geometry::Curve { closed: true, .. }));
        let long = WriteOptions { layout: Some(Layout::Long), ..WriteOptions::default() };
        assert_eq!(written(&FORMAT, &found, &long).expect("written").0, CURVES);
        // The other layout holds the same.
        let (text, _) = written(&FORMAT, &read(WIDE), &long).expect("written");
        assert_eq!(written(&FORMAT, &read(&text), &WriteOptions::default()).expect("written").0, WIDE);
    }

    #[test]
    fn headers_of_other_programs_are_recognised() {
        for header in
            ["x1,y1,x2,y2", "X1,Y1,X2,Y2", "1.X,1.Y,2.X,2.Y", "LM0_x,LM0_y,LM1_x,LM1_y", "x_0;y_0;x_1;y_1"]
        {
            let separator = if header.contains(';') { ";" } else { "," };
            let text = format!("\u{feff}{header}\r\n{}\r\n", ["1", "2", "3", "4"].join(separator));
            assert_eq!(coordinates(&read(&text)[0]), [1.0, 2.0, 3.0, 4.0], "{header}");
        }
        // Names of attributes may have other separators.
        for table in [
            "id,a;;;;;;;;b,x1,y1,x2,y2\ns,v,1,2,3,4\n",
            "id;a,,,,,,,,b;x1;y1;x2;y2\ns;v;1;2;3;4\n",
            "id,\";x;y;z\n\",x1,y1,x2,y2\ns,v,1,2,3,4\n",
        ] {
            assert_eq!(coordinates(&read(table)[0]), [1.0, 2.0, 3.0, 4.0], "{table}");
        }
        // The index of pandas beside ids.
        let found = read(",id,x1,y1\n0,a,1,2\n");
        assert_eq!(
            (found[0].name.as_deref(), &found[0].labels),
            (Some("a"), &[("column_1".into(), Value::Number(0.0))].into())
        );
        // Columns by landmark and axis, in any order, and names of rows of R.
        let found = read("\"\",x1,x2,y1,y2,sex\nA,1,3,2,4,f\n");
        assert_eq!(
            (coordinates(&found[0]), found[0].name.as_deref()),
            (&[1.0, 2.0, 3.0, 4.0][..], Some("A"))
        );
        let options = columns(r#"{"dimension":2}"#);
        let morphoj =
            "Id\tCentroid Size\tProcCoord1\tProcCoord2\tProcCoord3\tProcCoord4\nA\t2.5\t1\t2\t3\t4\n";
        let (found, _) = records(&FORMAT, morphoj, &options).expect("a valid table");
        assert_eq!(
            (coordinates(&found[0]), &found[0].labels["Centroid Size"]),
            (&[1.0, 2.0, 3.0, 4.0][..], &Value::Number(2.5))
        );
    }

    #[test]
    fn decimal_commas_are_recognised_or_asked_for() {
        let german = "id;Größe;Datum;x1;y1;x2;y2\na;12,5;1.2.2026;495,0;-1,25e2;0,5;7\nb;3;;1;2;3;4\n";
        let (found, summary) = records(&FORMAT, german, &ReadOptions::default()).expect("a valid table");
        assert_eq!(coordinates(&found[0]), [495.0, -125.0, 0.5, 7.0]);
        assert_eq!(found[0].labels["Größe"], Value::Number(12.5));
        assert_eq!(found[0].labels["Datum"], Value::Text("1.2.2026".into()));
        assert_eq!(summary.properties["decimal"], "comma");
        let given = |decimal: &str| columns(&format!(r#"{{"decimal":"{decimal}"}}"#));
        let quoted = "x1,y1\n\"1,5\",2\n";
        let (found, _) = records(&FORMAT, quoted, &given("comma")).expect("a valid table");
        assert_eq!(coordinates(&found[0]), [1.5, 2.0]);
        // Texts with commas are not numbers, and points are not commas.
        let points = "id;note;x1;y1\na;1,2,3;1.5;2\n";
        assert_eq!(coordinates(&read(points)[0]), [1.5, 2.0]);
        for (text, options, message) in [
            (
                quoted,
                given("point"),
                "item 0, column 'x1', line 2: expected a number, got '1,5' (decimal=comma reads decimal commas)",
            ),
            (
                "x1;y1\n1,5;2.5\n",
                ReadOptions::default(),
                "item 0, column 'y1', line 2: expected a number with a decimal comma (option decimal), got '2.5'",
            ),
            (
                "x1;y1\n1,5;2,5,1\n",
                ReadOptions::default(),
                "item 0, column 'y1', line 2: expected a number, got '2,5,1'",
            ),
        ] {
            assert_eq!(fault(&FORMAT, text, &options), message);
        }
    }

    #[test]
    fn attributes_are_taken_by_patterns() {
        let options = columns(r#"{"attributes":"age, l*"}"#);
        let text = "id,age,left,Length,depth,x1,y1\na,1,true,3,4,0,0\nb,1,true,3,4,0,0\n";
        let (found, summary) = records(&FORMAT, text, &options).expect("a valid table");
        assert_eq!(found[1].labels.keys().collect::<Vec<_>>(), ["Length", "age", "left"]);
        let dropped = &summary.dropped[0];
        assert_eq!(
            (dropped.what.as_str(), dropped.count, dropped.names[0].as_str()),
            ("attributes that are not selected", 2, "depth")
        );
    }

    #[test]
    fn columns_are_mapped_as_asked() {
        let text = "who,what,px,py,n,m\na,f,1,2,1,x\na,f,3,4,2,y\nb,g,5,6,1,z\n";
        let options = columns(
            r#"{"columns":{"id":"WHO","label":"what","coordinates":["px","py"],"point":"n","attributes":[]},"closed":true}"#,
        );
        let (found, summary) = records(&FORMAT, text, &options).expect("a valid table");
        assert_eq!(
            (found.len(), found[1].label.as_deref(), coordinates(&found[0])),
            (2, Some("g"), &[1.0, 2.0, 3.0, 4.0][..])
        );
        assert!(matches!(found[0].geometry, Geometry::Curve { closed: true, .. }));
        assert_eq!(summary.dropped[0].names, ["m"]);
        let wide = columns(r#"{"columns":{"coordinates":["c*"]},"dimension":3}"#);
        let (found, _) = records(&FORMAT, "c1,c2,c3,d\n1,2,3,4\n", &wide).expect("a valid table");
        assert_eq!(
            (coordinates(&found[0]), &found[0].labels["d"]),
            (&[1.0, 2.0, 3.0][..], &Value::Number(4.0))
        );
        for (options, message) in [
            (
                r#"{"columns":{"id":"x","coordinates":["px","py"]}}"#,
                "expected a column 'x' as id, got 'who', 'what', 'px', 'py', 'n', 'm'",
            ),
            (
                "{}",
                "line 1: expected columns of coordinates such as x1, y1 or x, y, got 'who', 'what', 'px', 'py', 'n', 'm'",
            ),
            (
                r#"{"columns":{"coordinates":["p*"]}}"#,
                "expected the option dimension beside a pattern of columns, got none",
            ),
            (
                r#"{"columns":{"coordinates":["p*"]},"dimension":3}"#,
                "expected a multiple of 3 columns of coordinates, got 2",
            ),
        ] {
            assert_eq!(fault(&FORMAT, text, &columns(options)), message);
        }
    }

    #[test]
    fn rows_of_curves_may_end_early() {
        let found = read("closed,x1,y1,x2,y2,x3,y3\nTRUE,0,0,1,0,,\n0,0,0,1,0,2,0\n,0,0,1,0,,\n");
        assert_eq!(found.iter().map(|record| coordinates(record).len()).collect::<Vec<_>>(), [4, 6, 6]);
        assert_eq!(found[2].geometry.kind(), Kind::Landmarks);
    }

    #[test]
    fn names_of_points_and_changing_attributes_are_told() {
        let text = "id,point,x,y,depth\na,nose,0,0,1\na,chin,1,1,2\n";
        let (found, summary) = records(&FORMAT, text, &ReadOptions::default()).expect("a valid table");
        assert_eq!(found[0].metadata["landmark_names"], serde_json::json!(["nose", "chin"]));
        let dropped = &summary.dropped[0];
        assert_eq!(
            (dropped.what.as_str(), dropped.names[0].as_str()),
            ("values that differ within a shape", "depth")
        );
    }

    #[test]
    fn faults_name_line_and_column() {
        for (text, message) in [
            ("", "line 0: expected a header, got the end of the file"),
            ("x1,y1\n1\n", "item 0, line 2: expected 2 fields as in the header, got 1"),
            ("x1,y1\n1,x\n", "item 0, column 'y1', line 2: expected a number, got 'x'"),
            (
                "x1,y1\n1,\n",
                "item 0, line 2: expected all coordinates of a point or none, got 1 of 2 in point 0",
            ),
            ("x1,y1\n1,1e101\n", "item 0, line 2: expected coordinates within ±1e100, got 1e101 in point 0"),
            ("x1,y1,x2\n", "line 1: expected a column y2, got none"),
            ("x1,y1,X1\n", "line 1: expected one column x1, got two"),
            ("x1,y1,x3,y3\n", "line 1: expected a column x2, got none"),
            (
                "id,x,y\na,1,2\nb,1,2\na,1,2\n",
                "item 2, line 4: expected the rows of shape 'a' side by side, got more after others",
            ),
            (
                "id,point,x,y\na,1,1,2\na,3,1,2\n",
                "item 0, line 2: expected points numbered in order, got 3 after 1",
            ),
            (
                "closed,x1,y1\nmaybe,1,2\n",
                "item 0, column 'closed', line 2: expected true or false, got 'maybe'",
            ),
        ] {
            assert_eq!(fault(&FORMAT, text, &ReadOptions::default()), message);
        }
        check_truncations(&FORMAT, WIDE.as_bytes());
        check_truncations(&FORMAT, CURVES.as_bytes());
        // An open quotation mark makes one field of the rest: it is not held beyond the limit.
        let endless = format!("x1,y1\n1,\"{}", "2\n".repeat(200_000));
        let limits = Limits { held: 1 << 20, ..Limits::default() };
        let error = records_within(&FORMAT, endless.as_bytes(), &ReadOptions::default(), limits)
            .expect_err("too long");
        assert_eq!(
            (error.kind, error.detail.as_str()),
            (super::super::FaultKind::TooLarge, "expected rows of at most 65536 bytes, got a longer one")
        );
    }

    #[test]
    fn attributes_with_the_name_of_another_column_are_counted() {
        let mut found = read(WIDE);
        for name in ["x7", "Label", "subject", " ", "closed", "Z"] {
            found[0].labels.insert(name.into(), Value::Number(1.0));
        }
        let (text, summary) = written(&FORMAT, &found, &WriteOptions::default()).expect("written");
        assert_eq!((text.as_str(), summary.dropped.len()), (WIDE, 1));
        let dropped = &summary.dropped[0];
        assert_eq!((dropped.what.as_str(), dropped.count), ("labels without a column", 6));
    }

    #[test]
    fn shapes_that_do_not_fit_are_refused_by_name() {
        let mut found = read("id,x1,y1\na,1,2\nb,1,2\n");
        found[1] = read("id,x1,y1,x2,y2\nb,1,2,3,4\n").remove(0);
        let error = written(&FORMAT, &found, &WriteOptions::default()).expect_err("another size");
        let expected = "shape 'b': expected 1 points of 2 coordinates as in the first shape, got 2 of 2";
        assert!(error.to_string().ends_with(expected), "{error}");
        found[0].name = Some("b".into());
        let long = WriteOptions { layout: Some(Layout::Long), ..WriteOptions::default() };
        let error = written(&FORMAT, &found, &long).expect_err("the same name");
        assert!(
            error.to_string().ends_with("expected another name than that of the shape before, got the same"),
            "{error}"
        );
        assert_eq!(columns("{}").columns, None::<Columns>);
    }
}
