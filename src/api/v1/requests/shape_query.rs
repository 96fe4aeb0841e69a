//! Query parameters that select shapes of a cohort, beside those of the route itself.
//!
//! A condition is named after its attribute, with an operator unless it is equality: `label=a`, `labels.age.gte=30`. Values of
//! one name are alternatives: `labels.site=zrh&labels.site=gva`. Brackets stand for dots, as clients write that are generated
//! from the OpenAPI document: `labels[site]=zrh`, `labels[age.gte]=30`. Generators that know no maps in queries have the conditions
//! as a list of texts: `condition=labels.site=zrh`.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;

use crate::api::extract::{TWICE, unknown_parameter};
use crate::api::problem::Problem;
use crate::domain::attribute::Attribute;
use crate::domain::filter::{OPERATORS, ShapeFilter};
use crate::service::app::ServiceError;
use crate::service::cohorts::attributes::filter_faults;
use crate::store::Order;
use crate::wire::checked::{Checked, take_or_default};
use crate::wire::fault::Fault;
use crate::wire::json;
use crate::wire::words::plain_sentence;

/// Query parameters of a shape filter, for the OpenAPI document.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` reads them")]
pub(in crate::api::v1) struct FilterQuery {
    /// Only shapes with one of these labels. Every condition also has the operators `ne`, `gte`, `gt`, `lte` and `lt`:
    /// `label.ne=control`.
    label: Option<Vec<String>>,
    /// Only shapes of one of these subjects.
    subject: Option<Vec<String>>,
    /// Only shapes with one of these external ids.
    external_id: Option<Vec<String>>,
    /// Only shapes whose attributes have these values: `labels[site]=zrh`, also written `labels.site=zrh`. Repeat a name for
    /// alternatives. With an operator: `labels[age.gte]=30`, compared as numbers if the bound is a number, else as texts.
    #[param(style = DeepObject, explode, value_type = Option<BTreeMap<String, String>>, example = json!({}))]
    labels: Option<BTreeMap<String, String>>,
    /// Only shapes with these measures (`points`, `centroid_size`, `length`, `area`, `volume`, `self_intersecting`,
    /// `clockwise`, `fit_mean`, `fit_largest`, `fit_area`):
    /// `measures[area.gte]=2`, also written `measures.area.gte=2`.
    #[param(style = DeepObject, explode, value_type = Option<BTreeMap<String, String>>, example = json!({}))]
    measures: Option<BTreeMap<String, String>>,
    /// Only shapes of this time of creation, in RFC 3339: `created_at[gte]=2026-01-31T00:00:00Z`, also written
    /// `created_at.gte=…`.
    #[param(style = DeepObject, explode, value_type = Option<BTreeMap<String, String>>, example = json!({}))]
    created_at: Option<BTreeMap<String, String>>,
    /// Only shapes that have these attributes: `has=labels.site`.
    has: Option<Vec<String>>,
    /// Only shapes that pass these conditions, each a name and a value as in a parameter: `condition=labels.site=zrh`,
    /// `condition=labels.age.gte=30`. For clients that cannot write `labels` as a map.
    condition: Option<Vec<String>>,
}

/// The parameter whose values are conditions.
const CONDITION: &str = "condition";

/// Query parameters: conditions of a filter, and others by name, each at most once.
#[derive(Debug)]
pub(in crate::api::v1) struct Parameters {
    others: BTreeMap<String, String>,
    filter: ShapeFilter,
    /// Name of the first condition, as it was written.
    first_condition: Option<String>,
}

impl Parameters {
    /// Collects conditions, and other parameters by name.
    ///
    /// # Errors
    /// A parameter other than a condition given twice: neither value takes precedence; more conditions than a filter has; values
    /// that cannot be compared.
    pub(in crate::api::v1) fn read(pairs: Vec<(String, String)>) -> Result<Self, Problem> {
        let (mut others, mut filter, mut first_condition) = (BTreeMap::new(), ShapeFilter::default(), None);
        for (name, value) in pairs {
            let wrong = |detail: &str| Problem::of_parameter(name.clone(), detail);
            if name == "has" {
                filter.has.insert(Attribute::try_from(value).map_err(|detail| wrong(&detail))?);
            } else if name == CONDITION {
                let stated = value.split_once('=').and_then(|(name, value)| Some((condition(name)?, value)));
                let expected = || {
                    let detail = format!(
                        "expected the name of an attribute, perhaps an operator, and a value, such as labels.age.gte=30, got '{value}'"
                    );
                    wrong(&detail)
                };
                let ((attribute, operator), value) = stated.ok_or_else(expected)?;
                filter.condition(attribute).add(operator, value.to_owned()).map_err(wrong)?;
            } else if let Some((attribute, operator)) = condition(&name) {
                filter.condition(attribute).add(operator, value).map_err(wrong)?;
            } else {
                if others.contains_key(&name) {
                    return Err(wrong(TWICE));
                }
                others.insert(name, value);
                continue;
            }
            first_condition.get_or_insert(name);
        }
        if let Some(detail) = filter.excess() {
            return Err(ServiceError::Query(detail).into());
        }
        let fault =
            |(attribute, detail): (Attribute, String)| Fault::of_parameter(attribute.to_string(), detail);
        let faults: Vec<Fault> = filter.faults().into_iter().map(fault).collect();
        if !faults.is_empty() {
            return Err(ServiceError::Parameters(faults).into());
        }
        Ok(Self { others, filter, first_condition })
    }

    /// Takes the value of one parameter.
    pub(in crate::api::v1) fn take(&mut self, name: &str) -> Option<String> {
        self.others.remove(name)
    }

    /// Takes one parameter that is a whole number.
    ///
    /// # Errors
    /// Another text.
    pub(in crate::api::v1) fn take_count(&mut self, name: &str) -> Result<Option<usize>, Problem> {
        let Some(text) = self.take(name) else { return Ok(None) };
        let wrong =
            || Problem::of_parameter(name, format!("expected a non-negative whole number, got '{text}'"));
        text.parse().map(Some).map_err(|_| wrong())
    }

    /// Takes the order of a list: an attribute, after a minus sign if large values come first.
    ///
    /// # Errors
    /// A name that is not an attribute.
    pub(in crate::api::v1) fn take_order(&mut self) -> Result<Option<Order>, Problem> {
        let Some(text) = self.take("order") else { return Ok(None) };
        let (descending, name) = text.strip_prefix('-').map_or((false, text.as_str()), |name| (true, name));
        let attribute = Attribute::try_from(name.to_owned());
        let attribute = attribute.map_err(|detail| Problem::of_parameter("order", detail))?;
        Ok(Some(Order { attribute, descending }))
    }

    /// Takes one parameter whose value is one of a list of words.
    ///
    /// # Errors
    /// Another word.
    pub(in crate::api::v1) fn take_word<T: DeserializeOwned>(
        &mut self,
        name: &str,
    ) -> Result<Option<T>, Problem> {
        let Some(word) = self.take(name) else { return Ok(None) };
        json::from_value(&word.into())
            .map(Some)
            .map_err(|error| Problem::of_parameter(name, plain_sentence(&error.to_string())))
    }

    /// Takes one parameter that is `true` or `false`; default: false.
    ///
    /// # Errors
    /// Another word.
    pub(in crate::api::v1) fn take_flag(&mut self, name: &str) -> Result<bool, Problem> {
        Ok(self.take_choice(name)?.unwrap_or(false))
    }

    /// Takes one parameter that is `true` or `false`, if it is given.
    ///
    /// # Errors
    /// Another word.
    pub(in crate::api::v1) fn take_choice(&mut self, name: &str) -> Result<Option<bool>, Problem> {
        match self.take(name).as_deref() {
            None => Ok(None),
            Some("false") => Ok(Some(false)),
            Some("true") => Ok(Some(true)),
            Some(other) => Err(Problem::of_parameter(name, format!("expected true or false, got '{other}'"))),
        }
    }

    /// Takes the shape filter.
    pub(in crate::api::v1) fn take_filter(&mut self) -> ShapeFilter {
        self.first_condition = None;
        std::mem::take(&mut self.filter)
    }

    /// Refuses the parameters that are left: a misspelt filter must not be ignored.
    ///
    /// # Errors
    /// The first of them.
    pub(in crate::api::v1) fn refuse_rest(&self) -> Result<(), Problem> {
        match self.others.keys().chain(&self.first_condition).next() {
            None => Ok(()),
            Some(name) => Err(unknown_parameter(name)),
        }
    }
}

/// Attribute and operator of a condition by its name; none for other names.
fn condition(name: &str) -> Option<(Attribute, &'static str)> {
    let dotted = dotted(name);
    let name = dotted.as_deref().unwrap_or(name);
    let (attribute, operator) = match name.rsplit_once('.') {
        Some((attribute, last)) => match OPERATORS.into_iter().find(|operator| *operator == last) {
            // `labels.eq` is the attribute of this name.
            Some(operator) if Attribute::parse(attribute).is_some() => (attribute, operator),
            _ => (name, "eq"),
        },
        None => (name, "eq"),
    };
    Some((Attribute::parse(attribute)?, operator))
}

/// The name with dots for brackets: `labels.age.gte` of `labels[age][gte]` and `labels[age.gte]`; none for other names. An
/// attribute whose name has brackets is written with a dot.
fn dotted(name: &str) -> Option<String> {
    let (root, rest) = name.split_once('[')?;
    if !["label", "subject", "external_id", "labels", "measures", "created_at"].contains(&root) {
        return None;
    }
    let parts: Vec<&str> = rest.strip_suffix(']')?.split("][").collect();
    let last_is_operator = |parts: &[&str]| parts.last().is_some_and(|last| OPERATORS.contains(last));
    let is_plain = parts.iter().all(|part| !part.is_empty() && !part.contains(['[', ']']));
    (is_plain && (parts.len() == 1 || parts.len() == 2 && last_is_operator(&parts)))
        .then(|| format!("{root}.{}", parts.join(".")))
}

/// Filter of a body, with the faults of its values.
pub(in crate::api::v1) fn take_filter(
    field: Option<Checked<ShapeFilter>>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<ShapeFilter> {
    let filter = take_or_default(field, pointer, errors)?;
    errors.extend(filter_faults(&filter, pointer));
    Some(filter)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(pairs: &[(&str, &str)]) -> Result<(ShapeFilter, Vec<String>), Problem> {
        let pairs = pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        let mut parameters = Parameters::read(pairs)?;
        let filter = parameters.take_filter();
        Ok((filter, parameters.others.into_keys().collect()))
    }

    #[test]
    fn dots_and_brackets_name_the_same_attribute() {
        let (dots, rest) =
            read(&[("label", "a"), ("labels.site", "zrh"), ("labels.a.b", "1"), ("labels.age.gte", "3")])
                .unwrap();
        assert_eq!((dots.label.clone(), &dots.subject, rest.len()), (Some("a".into()), &None, 0));
        assert_eq!(dots.labels.keys().collect::<Vec<_>>(), ["a.b", "age", "site"]);
        assert_eq!(dots.labels["age"].gte.as_deref(), Some("3"));
        for age in ["labels[age][gte]", "labels[age.gte]"] {
            let (brackets, rest) =
                read(&[("label", "a"), ("labels[site]", "zrh"), ("labels[a.b]", "1"), (age, "3")]).unwrap();
            assert_eq!((brackets, rest.len()), (dots.clone(), 0));
        }
    }

    #[test]
    fn conditions_are_also_texts_of_a_list() {
        let named =
            read(&[("labels.site", "a=b"), ("labels.site", "c"), ("labels.age.gte", "3"), ("label.ne", "x")])
                .unwrap();
        let texts = ["labels.site=a=b", "labels[site]=c", "labels.age.gte=3", "label.ne=x"];
        assert_eq!(read(&texts.map(|text| ("condition", text))).unwrap(), named);
        for wrong in ["labels.site", "colour=red", "=a", "measures.area.gte=large", "limit=3"] {
            let problem = read(&[("condition", wrong)]).unwrap_err();
            assert!(format!("{problem:?}").contains("expected"), "{wrong}: {problem:?}");
        }
    }

    #[test]
    fn values_of_one_name_are_alternatives() {
        let (filter, _) = read(&[
            ("label", "a"),
            ("label", "b"),
            ("labels.site", "x"),
            ("labels[site]", "y"),
            ("label.ne", "c"),
        ])
        .unwrap();
        let label = filter.label.unwrap();
        assert_eq!((label.one_of, label.none_of), (vec!["a".into(), "b".into()], vec!["c".into()]));
        assert_eq!(filter.labels["site"].one_of, ["x", "y"]);
    }

    #[test]
    fn an_attribute_may_be_called_like_an_operator() {
        let (filter, _) = read(&[("labels.gte", "a"), ("labels.size.gte.eq", "b")]).unwrap();
        assert_eq!(filter.labels["gte"].only_value(), Some("a"));
        assert_eq!(filter.labels["size.gte"].only_value(), Some("b"));
    }

    #[test]
    fn brackets_belong_to_an_attribute_only_around_it() {
        let (filter, rest) = read(&[("labels.a[b]", "1"), ("labels[a][b]", "2"), ("labels[a", "3")]).unwrap();
        assert_eq!(filter.labels.keys().collect::<Vec<_>>(), ["a[b]"]);
        assert_eq!(rest, ["labels[a", "labels[a][b]"]);
    }

    #[test]
    fn long_filters_are_refused() {
        let names: Vec<String> = (0..101).map(|k| format!("labels.k{k}")).collect();
        let pairs: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), "v")).collect();
        assert!(read(&pairs[..100]).is_ok() && read(&pairs).is_err());
        assert!(
            read(&[("external_id", "a"); 10_000]).is_ok() && read(&[("external_id", "a"); 10_001]).is_err()
        );
    }

    #[test]
    fn wrong_conditions_are_refused() {
        for pairs in [
            [("labels.age.gte", "1"), ("labels.age.gte", "2")],
            [("measures.area.gte", "large"), ("label", "a")],
            [("created_at.lt", "yesterday"), ("label", "a")],
            [("has", "colour"), ("label", "a")],
            [("limit", "1"), ("limit", "2")],
            [("label", "a\0"), ("subject", "b")],
        ] {
            assert!(read(&pairs).is_err(), "{pairs:?}");
        }
        let (_, rest) = read(&[("measures.mass", "1"), ("colour", "red")]).unwrap();
        assert_eq!(rest, ["colour", "measures.mass"]);
    }
}
