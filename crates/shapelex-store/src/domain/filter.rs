//! Conditions that select shapes of a cohort, the same in queries and bodies.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::attribute::{Attribute, LARGEST_WHOLE, Measure};

#[cfg(feature = "schema")]
mod schema;

/// Filter that selects shapes of a cohort; all conditions must hold.
#[derive(Debug, Clone, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ShapeFilter {
    /// Condition on the external id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub external_id: Option<Condition>,
    /// Condition on the class label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<Condition>,
    /// Condition on the subject.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<Condition>,
    /// Conditions on attributes. Values are compared as texts, and as numbers where both are numbers.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, Condition>,
    /// Conditions on measures.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub measures: BTreeMap<Measure, Condition>,
    /// Condition on the time of creation, in RFC 3339.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub created_at: Option<Condition>,
    /// Attributes that the shapes have, by name.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    #[cfg_attr(feature = "schema", schema(value_type = Vec<String>, required = false))]
    pub has: BTreeSet<Attribute>,
}

/// Maximum number of conditions of a filter: each is a part of one statement of the store, whose depth is bounded.
pub const MAX_CONDITIONS: usize = 100;

/// Maximum number of values in all conditions of a filter: each is bound up to twice, and a statement of SQLite takes 32 766.
pub const MAX_VALUES: usize = 10_000;

impl ShapeFilter {
    /// The filter that selects every shape.
    pub const fn everything() -> Self {
        Self {
            external_id: None,
            label: None,
            subject: None,
            labels: BTreeMap::new(),
            measures: BTreeMap::new(),
            created_at: None,
            has: BTreeSet::new(),
        }
    }

    /// Whether it selects every shape.
    pub fn is_everything(&self) -> bool {
        self.conditions().next().is_none() && self.has.is_empty()
    }

    /// The conditions with their attributes.
    pub fn conditions(&self) -> impl Iterator<Item = (Attribute, &Condition)> {
        let own = [
            (Attribute::ExternalId, &self.external_id),
            (Attribute::Label, &self.label),
            (Attribute::Subject, &self.subject),
            (Attribute::CreatedAt, &self.created_at),
        ];
        let own = own.into_iter().filter_map(|(name, condition)| Some((name, condition.as_ref()?)));
        let labels = self.labels.iter().map(|(name, condition)| (Attribute::Labels(name.clone()), condition));
        let measures =
            self.measures.iter().map(|(measure, condition)| (Attribute::Measure(*measure), condition));
        own.chain(labels).chain(measures)
    }

    /// Attributes that the filter names.
    pub fn attributes(&self) -> BTreeSet<Attribute> {
        self.conditions().map(|(attribute, _)| attribute).chain(self.has.iter().cloned()).collect()
    }

    /// The condition on an attribute, made if there is none.
    pub fn condition(&mut self, attribute: Attribute) -> &mut Condition {
        match attribute {
            Attribute::ExternalId => self.external_id.get_or_insert_default(),
            Attribute::Label => self.label.get_or_insert_default(),
            Attribute::Subject => self.subject.get_or_insert_default(),
            Attribute::CreatedAt => self.created_at.get_or_insert_default(),
            Attribute::Labels(name) => self.labels.entry(name).or_default(),
            Attribute::Measure(measure) => self.measures.entry(measure).or_default(),
        }
    }

    /// The fault, if it has more conditions or values than a filter may have.
    pub fn excess(&self) -> Option<String> {
        let operators = |(_, condition): (Attribute, &Condition)| condition.operators();
        let values = |(_, condition): (Attribute, &Condition)| condition.values().count();
        let counts = [
            ("conditions", MAX_CONDITIONS, self.conditions().map(operators).sum::<usize>() + self.has.len()),
            ("values", MAX_VALUES, self.conditions().map(values).sum()),
        ];
        let (what, most, found) = counts.into_iter().find(|(_, most, found)| found > most)?;
        Some(format!("expected a filter of at most {most} {what}, got {found}"))
    }

    /// Names that no attribute has, and values that cannot be compared with those of their attribute: the attribute, and the
    /// fault.
    pub fn faults(&self) -> Vec<(Attribute, String)> {
        let of = |(attribute, condition): (Attribute, &Condition)| {
            let texts = condition.values().chain(attribute.label_name());
            if texts.into_iter().any(|text| text.contains('\0')) {
                return Some((attribute, "expected text without the character U+0000".into()));
            }
            let wanted = match attribute {
                Attribute::CreatedAt => "a time in RFC 3339, as 2026-01-31T12:00:00Z",
                Attribute::Measure(measure) if measure.is_flag() => "true or false",
                _ => "a finite number",
            };
            let value = condition.values().find(|value| !is_comparable(&attribute, value))?;
            Some((attribute, format!("expected {wanted}, got '{value}'")))
        };
        self.conditions().filter_map(of).collect()
    }
}

fn is_comparable(attribute: &Attribute, value: &str) -> bool {
    match attribute {
        Attribute::Measure(measure) if measure.is_flag() => matches!(value, "true" | "false"),
        _ => !attribute.is_numeric() || number_of(attribute, value).is_some(),
    }
}

/// The number that a value of a filter stands for: milliseconds of a time. Whole numbers that doubles do not tell from their
/// neighbours are compared by their digits, so that identifiers are never mixed up.
pub fn number_of(attribute: &Attribute, value: &str) -> Option<f64> {
    if *attribute == Attribute::CreatedAt {
        let time: jiff::Timestamp = value.parse().ok()?;
        return Some(time.as_millisecond() as f64);
    }
    let digits = value.strip_prefix(['-', '+']).unwrap_or(value);
    let is_held = |digits: &str| digits.parse().is_ok_and(|whole: u64| whole <= LARGEST_WHOLE);
    if !attribute.is_numeric() && digits.bytes().all(|byte| byte.is_ascii_digit()) && !is_held(digits) {
        return None;
    }
    value.parse().ok().filter(|number: &f64| number.is_finite())
}

/// Condition on one attribute. Values are texts, as they are written in a query.
#[derive(Debug, Clone, PartialEq, Eq, Default, Hash)]
pub struct Condition {
    /// The attribute has one of these values; empty: any.
    pub one_of: Vec<String>,
    /// The attribute has none of these values, or is missing.
    pub none_of: Vec<String>,
    /// The attribute is at least this.
    pub gte: Option<String>,
    /// The attribute is above this.
    pub gt: Option<String>,
    /// The attribute is at most this.
    pub lte: Option<String>,
    /// The attribute is below this.
    pub lt: Option<String>,
}

/// Words of a condition, for the names of parameters.
pub const OPERATORS: [&str; 6] = ["eq", "ne", "gte", "gt", "lte", "lt"];

impl Condition {
    /// Adds a value under one of [`OPERATORS`].
    ///
    /// # Errors
    /// A bound that is given twice.
    pub fn add(&mut self, operator: &str, value: String) -> Result<(), &'static str> {
        let bound = match operator {
            "eq" => {
                self.one_of.push(value);
                return Ok(());
            }
            "ne" => {
                self.none_of.push(value);
                return Ok(());
            }
            "gte" => &mut self.gte,
            "gt" => &mut self.gt,
            "lte" => &mut self.lte,
            _ => &mut self.lt,
        };
        match bound.replace(value) {
            None => Ok(()),
            Some(_) => Err("expected the bound once, got it twice"),
        }
    }

    /// The bounds, with their operators in SQL.
    pub fn bounds(&self) -> impl Iterator<Item = (&'static str, &str)> {
        let bounds = [(">=", &self.gte), (">", &self.gt), ("<=", &self.lte), ("<", &self.lt)];
        bounds.into_iter().filter_map(|(operator, bound)| Some((operator, bound.as_deref()?)))
    }

    /// The value, if the condition is that the attribute has this one.
    pub fn only_value(&self) -> Option<&str> {
        match self.one_of.as_slice() {
            [only] if self.none_of.is_empty() && self.bounds().next().is_none() => Some(only),
            _ => None,
        }
    }

    /// Number of operators that it has values for.
    fn operators(&self) -> usize {
        let lists = [&self.one_of, &self.none_of].into_iter().filter(|list| !list.is_empty());
        lists.count() + self.bounds().count()
    }

    fn values(&self) -> impl Iterator<Item = &str> {
        let listed = self.one_of.iter().chain(&self.none_of).map(String::as_str);
        listed.chain(self.bounds().map(|(_, bound)| bound))
    }
}

impl<T: Into<String>> From<T> for Condition {
    fn from(value: T) -> Self {
        Self { one_of: vec![value.into()], ..Self::default() }
    }
}

/// One value as it is, a list of values as a list, anything else as an object of operators.
impl Serialize for Condition {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if let Some(value) = self.only_value() {
            return serializer.serialize_str(value);
        }
        let mut map = serializer.serialize_map(None)?;
        for (operator, values) in [("eq", &self.one_of), ("ne", &self.none_of)] {
            match values.as_slice() {
                [] => {}
                [value] => map.serialize_entry(operator, value)?,
                values => map.serialize_entry(operator, values)?,
            }
        }
        for (operator, bound) in [("gte", &self.gte), ("gt", &self.gt), ("lte", &self.lte), ("lt", &self.lt)]
        {
            if let Some(bound) = bound {
                map.serialize_entry(operator, bound)?;
            }
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Condition {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ConditionVisitor)
    }
}

struct ConditionVisitor;

impl<'de> Visitor<'de> for ConditionVisitor {
    type Value = Condition;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value, a list of values, or an object of the operators eq, ne, gte, gt, lte, lt")
    }

    fn visit_str<E>(self, value: &str) -> Result<Condition, E> {
        Ok(value.into())
    }

    fn visit_bool<E>(self, value: bool) -> Result<Condition, E> {
        Ok(value.to_string().into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Condition, E> {
        Ok(value.to_string().into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Condition, E> {
        Ok(value.to_string().into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Condition, E> {
        Ok(serde_json::Value::from(value).to_string().into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Condition, A::Error> {
        let mut condition = Condition::default();
        while let Some(FilterValue(value)) = values.next_element()? {
            condition.one_of.push(value);
        }
        if condition.one_of.is_empty() {
            return Err(serde::de::Error::custom("expected at least one value, got an empty list"));
        }
        Ok(condition)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Condition, A::Error> {
        let mut condition = Condition::default();
        while let Some(operator) = entries.next_key::<String>()? {
            if !OPERATORS.contains(&operator.as_str()) {
                let wanted = OPERATORS.join(", ");
                let detail = format!("expected one of the operators {wanted}, got '{operator}'");
                return Err(serde::de::Error::custom(detail));
            }
            let FilterValues(values) = entries.next_value()?;
            for value in values {
                condition.add(&operator, value).map_err(serde::de::Error::custom)?;
            }
        }
        if condition == Condition::default() {
            return Err(serde::de::Error::custom("expected an operator with a value, got none"));
        }
        Ok(condition)
    }
}

/// One value of a filter: a string, a number or a Boolean.
struct FilterValue(String);

impl<'de> Deserialize<'de> for FilterValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let FilterValues(mut values) = FilterValues::deserialize(deserializer)?;
        match (values.pop(), values.is_empty()) {
            (Some(value), true) => Ok(Self(value)),
            _ => Err(serde::de::Error::custom("expected a string, a number or a Boolean, got a list")),
        }
    }
}

/// One value of a filter, or several.
struct FilterValues(Vec<String>);

impl<'de> Deserialize<'de> for FilterValues {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Values;
        impl<'de> Visitor<'de> for Values {
            type Value = FilterValues;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a string, a number, a Boolean or a list of them")
            }

            fn visit_str<E>(self, value: &str) -> Result<FilterValues, E> {
                Ok(FilterValues(vec![value.into()]))
            }

            fn visit_bool<E>(self, value: bool) -> Result<FilterValues, E> {
                Ok(FilterValues(vec![value.to_string()]))
            }

            fn visit_i64<E>(self, value: i64) -> Result<FilterValues, E> {
                Ok(FilterValues(vec![value.to_string()]))
            }

            fn visit_u64<E>(self, value: u64) -> Result<FilterValues, E> {
                Ok(FilterValues(vec![value.to_string()]))
            }

            fn visit_f64<E>(self, value: f64) -> Result<FilterValues, E> {
                Ok(FilterValues(vec![serde_json::Value::from(value).to_string()]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<FilterValues, A::Error> {
                let mut values = Vec::new();
                while let Some(FilterValue(value)) = list.next_element()? {
                    values.push(value);
                }
                Ok(FilterValues(values))
            }
        }
        deserializer.deserialize_any(Values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(text: serde_json::Value) -> Result<ShapeFilter, String> {
        serde_json::from_value(text).map_err(|error| error.to_string())
    }

    #[test]
    fn conditions_have_a_short_and_a_long_form() {
        let filter = read(json!({
            "label": "a", "subject": ["s", "t"], "has": ["labels.site"],
            "labels": {"age": {"gte": 30, "lt": 50.5}, "smoker": true, "site": {"ne": ["x", 3]}}
        }))
        .unwrap();
        assert_eq!(filter.label.as_ref().unwrap().only_value(), Some("a"));
        assert_eq!(filter.subject.as_ref().unwrap().one_of, ["s", "t"]);
        let age = &filter.labels["age"];
        assert_eq!((age.gte.as_deref(), age.lt.as_deref()), (Some("30"), Some("50.5")));
        assert_eq!(filter.labels["site"].none_of, ["x", "3"]);
        let written = serde_json::to_value(&filter).unwrap();
        assert_eq!(written["label"], "a");
        assert_eq!(read(written).unwrap(), filter);
    }

    #[test]
    fn wrong_conditions_say_what_is_expected() {
        for (text, wanted) in [
            (json!({"label": {"like": "a"}}), "operators eq, ne"),
            (json!({"label": []}), "at least one value"),
            (json!({"label": {}}), "an operator with a value"),
            (json!({"label": {"gte": [1, 2]}}), "the bound once"),
            (json!({"has": ["colour"]}), "'labels.<attribute>'"),
            (json!({"colour": "red"}), "unknown field `colour`"),
            (json!({"measures": {"mass": 1}}), "unknown variant `mass`"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(wanted), "{error}");
        }
    }

    #[test]
    fn values_must_be_comparable() {
        let faults = |text| read(text).unwrap().faults();
        assert!(faults(json!({"measures": {"area": {"gte": 2}, "self_intersecting": false}})).is_empty());
        assert!(faults(json!({"created_at": {"gte": "2026-01-31T00:00:00Z"}})).is_empty());
        assert_eq!(faults(json!({"measures": {"area": "big"}}))[0].0, Attribute::Measure(Measure::Area));
        assert_eq!(faults(json!({"created_at": {"lt": "today"}}))[0].0, Attribute::CreatedAt);
        assert_eq!(faults(json!({"measures": {"self_intersecting": 1}})).len(), 1);
    }
}
