//! List of all tables that a store keeps, which a test compares with the schema.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde_json::Value;

use super::super::engine::{Query, Row};
use super::super::error::StoreError;

/// Type of a column, the same in both databases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Integer,
    Real,
    Text,
    Bytes,
}

/// A stored table.
#[derive(Debug)]
pub(super) struct Table {
    pub(super) name: &'static str,
    /// Number of leading columns that form the primary key, by which rows are read in order.
    pub(super) key: usize,
    pub(super) columns: &'static [(&'static str, Kind)],
    /// Whether the database numbers the rows; the counter is kept too, so that no number is assigned twice.
    pub(super) counted: bool,
    /// Number of rows read at once; 1 for large rows.
    pub(super) page: i64,
    /// Condition for the rows that are kept, if not all are.
    pub(super) condition: Option<&'static str>,
}

/// Page size for small rows.
const MANY: i64 = 512;
/// Page size for rows of about a megabyte.
const FEW: i64 = 4;

/// Excludes chunks of unfinished uploads and of removed cohorts.
const CHUNK_LIVES: &str = "cohort IS NOT NULL AND revision IS NOT NULL";
const OF_LIVING_CHUNK: &str =
    "chunk_id IN (SELECT id FROM chunk WHERE cohort IS NOT NULL AND revision IS NOT NULL)";

/// Tables that are not kept, because their content concerns one database only.
#[cfg(test)]
pub(super) const PASSING: &[&str] = &["probe", "_sqlx_migrations", "sqlite_sequence"];

use Kind::{Bytes, Integer, Real, Text};

/// All tables that are kept, each after those it refers to.
pub(super) const TABLES: &[Table] = &[
    Table {
        name: "cohort",
        key: 1,
        columns: &[
            ("number", Integer),
            ("id", Text),
            ("handle", Text),
            ("tenant", Text),
            ("name", Text),
            ("description", Text),
            ("representation", Text),
            ("correspondence", Text),
            ("direction", Text),
            ("mirror", Text),
            ("length_unit", Text),
            ("revision", Integer),
            ("shapes", Integer),
            ("created_at_ms", Integer),
            ("updated_at_ms", Integer),
            ("deleted_at_ms", Integer),
            ("former_rules", Text),
        ],
        counted: true,
        page: MANY,
        condition: None,
    },
    Table {
        name: "chunk",
        key: 1,
        columns: &[
            ("id", Integer),
            ("cohort", Integer),
            ("upload", Text),
            ("revision", Integer),
            ("created_at_ms", Integer),
            ("rows", Integer),
            ("width", Integer),
        ],
        counted: true,
        page: MANY,
        condition: Some(CHUNK_LIVES),
    },
    Table {
        name: "chunk_data",
        key: 1,
        columns: &[("chunk_id", Integer), ("checksum", Bytes), ("weights", Bytes), ("points", Bytes)],
        counted: false,
        page: FEW,
        condition: Some(OF_LIVING_CHUNK),
    },
    Table {
        name: "shape",
        key: 2,
        columns: &[
            ("chunk_id", Integer),
            ("position", Integer),
            ("cohort", Integer),
            ("id", Text),
            ("external_id", Text),
            ("subject", Text),
            ("label", Text),
            ("deleted_revision", Integer),
            ("digest", Bytes),
            ("labels", Text),
            ("metadata", Text),
            ("first_stored_ms", Integer),
            ("points", Integer),
            ("centroid_size", Real),
            ("length", Real),
            ("area", Real),
            ("volume", Real),
            ("self_intersecting", Integer),
            ("clockwise", Integer),
            ("fit_mean", Real),
            ("fit_largest", Real),
            ("fit_area", Real),
            ("given_start", Real),
            ("given_reversed", Integer),
        ],
        counted: false,
        page: MANY,
        condition: Some(OF_LIVING_CHUNK),
    },
    Table {
        name: "job",
        key: 1,
        columns: &[
            ("id", Text),
            ("tenant", Text),
            ("cohort", Text),
            ("kind", Text),
            ("parameters", Text),
            ("status", Text),
            ("progress", Real),
            ("phase", Text),
            ("objective", Real),
            ("attempt", Integer),
            ("run_at_ms", Integer),
            ("lease_owner", Text),
            ("lease_until_ms", Integer),
            ("created_at_ms", Integer),
            ("started_at_ms", Integer),
            ("finished_at_ms", Integer),
            ("result", Text),
            ("problem", Text),
        ],
        counted: false,
        page: FEW,
        condition: None,
    },
    Table {
        name: "job_output",
        key: 1,
        columns: &[
            ("number", Integer),
            ("job", Text),
            ("bytes", Integer),
            ("checksum", Bytes),
            ("head", Text),
            ("data", Bytes),
        ],
        counted: true,
        page: 1,
        condition: None,
    },
    Table {
        name: "job_output_part",
        key: 3,
        columns: &[
            ("job", Text),
            ("attempt", Integer),
            ("part", Integer),
            ("checksum", Bytes),
            ("data", Bytes),
        ],
        counted: false,
        page: FEW,
        condition: None,
    },
    Table {
        name: "job_file",
        key: 3,
        columns: &[("job", Text), ("name", Text), ("piece", Integer), ("checksum", Bytes), ("data", Bytes)],
        counted: false,
        page: FEW,
        condition: None,
    },
    Table {
        name: "dictionary_name",
        key: 1,
        columns: &[("handle", Text), ("versions", Integer)],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "dictionary",
        key: 1,
        columns: &[
            ("id", Text),
            ("handle", Text),
            ("tenant", Text),
            ("name", Text),
            ("version", Integer),
            ("cohort", Text),
            ("summary", Text),
            ("provenance", Text),
            ("digest", Text),
            ("created_at_ms", Integer),
            ("deleted_at_ms", Integer),
        ],
        counted: false,
        page: FEW,
        condition: None,
    },
    Table {
        name: "dictionary_data",
        key: 1,
        columns: &[("dictionary", Text), ("content", Bytes), ("state", Bytes), ("state_checksum", Bytes)],
        counted: false,
        page: 1,
        condition: None,
    },
    Table {
        name: "dictionary_alias",
        key: 2,
        columns: &[
            ("handle", Text),
            ("alias", Text),
            ("tenant", Text),
            ("dictionary", Text),
            ("moves", Integer),
            ("moved_at_ms", Integer),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "assessment",
        key: 3,
        columns: &[
            ("cohort", Integer),
            ("dictionary", Text),
            ("shape", Text),
            ("revision", Integer),
            ("assessed_at_ms", Integer),
            ("class", Text),
            ("is_outlier", Integer),
            ("body", Text),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "receipt",
        key: 2,
        columns: &[
            ("tenant", Text),
            ("key", Text),
            ("fingerprint", Bytes),
            ("outcome", Text),
            ("created_at_ms", Integer),
        ],
        counted: false,
        page: FEW,
        condition: None,
    },
    Table {
        name: "change_sequence",
        key: 1,
        columns: &[("tenant", Text), ("last", Integer)],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "change",
        key: 2,
        columns: &[
            ("tenant", Text),
            ("sequence", Integer),
            ("at_ms", Integer),
            ("kind", Text),
            ("object", Text),
            ("cohort", Text),
            ("revision", Integer),
            ("shapes", Integer),
            ("shape_ids", Text),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "erasure",
        key: 2,
        columns: &[("tenant", Text), ("subject", Bytes), ("erased_at_ms", Integer), ("state", Text)],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "subject_secret",
        key: 1,
        columns: &[("tenant", Text), ("secret", Bytes)],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "hook",
        key: 1,
        columns: &[
            ("id", Text),
            ("tenant", Text),
            ("url", Text),
            ("description", Text),
            ("kinds", Text),
            ("cohort", Text),
            ("secret", Bytes),
            ("status", Text),
            ("reason", Text),
            ("position", Integer),
            ("attempts", Integer),
            ("failing_since_ms", Integer),
            ("due_ms", Integer),
            ("delivered_at_ms", Integer),
            ("created_at_ms", Integer),
            ("lease_owner", Text),
            ("lease_until_ms", Integer),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "hook_failure",
        key: 4,
        columns: &[
            ("hook", Text),
            ("at_ms", Integer),
            ("sequence", Integer),
            ("attempt", Integer),
            ("status", Integer),
            ("detail", Text),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "audit",
        key: 2,
        columns: &[
            ("tenant", Text),
            ("sequence", Integer),
            ("at_ms", Integer),
            ("caller", Text),
            ("subject", Text),
            ("operation", Text),
            ("method", Text),
            ("route", Text),
            ("objects", Text),
            ("status", Integer),
            ("request_id", Text),
            ("remote", Text),
            ("digest", Bytes),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "api_key",
        key: 1,
        columns: &[
            ("id", Text),
            ("tenant", Text),
            ("name", Text),
            ("role", Text),
            ("cohorts", Text),
            ("digest", Bytes),
            ("created_at_ms", Integer),
            ("expires_at_ms", Integer),
            ("revoked_at_ms", Integer),
            ("used_at_ms", Integer),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
    Table {
        name: "audit_head",
        key: 1,
        columns: &[
            ("tenant", Text),
            ("sequence", Integer),
            ("digest", Bytes),
            ("removed_sequence", Integer),
            ("removed_digest", Bytes),
        ],
        counted: false,
        page: MANY,
        condition: None,
    },
];

impl Table {
    /// Names of the first `count` columns as an SQL list.
    pub(super) fn names(&self, count: usize) -> String {
        let names: Vec<&str> = self.columns[..count].iter().map(|(name, _)| *name).collect();
        names.join(", ")
    }
}

/// Value in a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cell {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
    Bytes(Vec<u8>),
}

impl Cell {
    /// Reads the value of a column.
    pub(super) fn read(row: &Row, name: &str, kind: Kind) -> Result<Self, StoreError> {
        let cell = match kind {
            Integer => row.get::<Option<i64>>(name)?.map(Self::Integer),
            Real => row.get::<Option<f64>>(name)?.map(Self::Real),
            Text => row.get::<Option<String>>(name)?.map(Self::Text),
            Bytes => row.get::<Option<Vec<u8>>>(name)?.map(Self::Bytes),
        };
        Ok(cell.unwrap_or(Self::Null))
    }

    /// Appends the value to a statement, as a value of the kind.
    pub(super) fn push_to(&self, query: &mut Query<'_>, kind: Kind) {
        match (self, kind) {
            (Self::Integer(number), _) => query.push_bind(*number),
            (Self::Real(number), _) => query.push_bind(*number),
            (Self::Text(text), _) => query.push_bind(text.as_str()),
            (Self::Bytes(bytes), _) => query.push_bind(bytes.as_slice()),
            (Self::Null, Integer) => query.push_bind(None::<i64>),
            (Self::Null, Real) => query.push_bind(None::<f64>),
            (Self::Null, Text) => query.push_bind(None::<&str>),
            (Self::Null, Bytes) => query.push_bind(None::<&[u8]>),
        };
    }

    /// Value as written in an export, with bytes in base64.
    pub(super) fn to_json(&self) -> Value {
        match self {
            Self::Null => Value::Null,
            Self::Integer(number) => Value::from(*number),
            Self::Real(number) => Value::from(*number),
            Self::Text(text) => Value::from(text.as_str()),
            Self::Bytes(bytes) => Value::from(BASE64.encode(bytes)),
        }
    }

    /// Reads a value of the kind written by [`Cell::to_json`]; `None` if it is of another kind.
    pub(super) fn from_json(value: Value, kind: Kind) -> Option<Self> {
        match (value, kind) {
            (Value::Null, _) => Some(Self::Null),
            (Value::Number(number), Integer) => number.as_i64().map(Self::Integer),
            (Value::Number(number), Real) => number.as_f64().map(Self::Real),
            (Value::String(text), Text) => Some(Self::Text(text)),
            (Value::String(text), Bytes) => BASE64.decode(text).ok().map(Self::Bytes),
            _ => None,
        }
    }

    /// Approximate size in bytes.
    pub(super) fn size(&self) -> usize {
        match self {
            Self::Null | Self::Integer(_) | Self::Real(_) => size_of::<i64>(),
            Self::Text(text) => text.len(),
            Self::Bytes(bytes) => bytes.len(),
        }
    }
}
