//! Query parameters that select shapes of a cohort, beside those of the route itself.
//!
//! An attribute is named in one of two forms with one meaning: `labels.site=zrh`, or `labels[site]=zrh` as clients write
//! that are generated from the OpenAPI document, where `labels` is a `deepObject`.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;

use crate::api::extract::{TWICE, unknown_parameter};
use crate::api::problem::Problem;
use crate::domain::shape::ShapeFilter;
use crate::formats::checked::plain_sentence;

/// Query parameters of a shape filter, for the OpenAPI document.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct FilterQuery {
    /// Only shapes with this label.
    #[allow(dead_code, reason = "only for the document; `Parameters` reads it")]
    label: Option<String>,
    /// Only shapes of this subject.
    #[allow(dead_code, reason = "only for the document; `Parameters` reads it")]
    subject: Option<String>,
    /// Only shapes whose attributes have these values: `labels[site]=zrh`, also written `labels.site=zrh`.
    #[allow(dead_code, reason = "only for the document; `Parameters` reads it")]
    #[param(style = DeepObject, explode, value_type = Option<BTreeMap<String, String>>, example = json!({}))]
    labels: Option<BTreeMap<String, String>>,
}

/// Prefix of the names of attributes.
const ATTRIBUTE: &str = "labels.";

/// Query parameters by name, each at most once.
#[derive(Debug)]
pub(super) struct Parameters(BTreeMap<String, String>);

impl Parameters {
    /// Collects the parameters by name; attributes have the name `labels.{attribute}` in both forms.
    ///
    /// # Errors
    /// A parameter given twice: neither value takes precedence.
    pub(super) fn once_each(pairs: Vec<(String, String)>) -> Result<Self, Problem> {
        let mut parameters = BTreeMap::new();
        for (name, value) in pairs {
            let name = dotted(&name).unwrap_or(name);
            if parameters.contains_key(&name) {
                return Err(Problem::of_parameter(name, TWICE));
            }
            parameters.insert(name, value);
        }
        Ok(Self(parameters))
    }

    /// Takes the value of one parameter.
    pub(super) fn take(&mut self, name: &str) -> Option<String> {
        self.0.remove(name)
    }

    /// Takes one parameter whose value is one of a list of words.
    ///
    /// # Errors
    /// Another word.
    pub(super) fn take_word<T: DeserializeOwned>(&mut self, name: &str) -> Result<Option<T>, Problem> {
        let Some(word) = self.take(name) else { return Ok(None) };
        serde_json::from_value(word.into())
            .map(Some)
            .map_err(|error| Problem::of_parameter(name, plain_sentence(&error.to_string())))
    }

    /// Takes one parameter that is `true` or `false`; default: false.
    ///
    /// # Errors
    /// Another word.
    pub(super) fn take_flag(&mut self, name: &str) -> Result<bool, Problem> {
        match self.take(name).as_deref() {
            None | Some("false") => Ok(false),
            Some("true") => Ok(true),
            Some(other) => Err(Problem::of_parameter(name, format!("expected true or false, got '{other}'"))),
        }
    }

    /// Takes the shape filter: `label`, `subject` and the attributes.
    pub(super) fn take_filter(&mut self) -> ShapeFilter {
        let attributes: Vec<String> =
            self.0.keys().filter(|name| name.starts_with(ATTRIBUTE)).cloned().collect();
        let labels = attributes.into_iter().filter_map(|name| {
            let value = self.take(&name)?;
            Some((name[ATTRIBUTE.len()..].to_owned(), value))
        });
        let labels = labels.collect();
        ShapeFilter { label: self.take("label"), subject: self.take("subject"), labels }
    }

    /// Refuses the parameters that are left: a misspelt filter must not be ignored.
    ///
    /// # Errors
    /// The first of them.
    pub(super) fn refuse_rest(&self) -> Result<(), Problem> {
        match self.0.keys().next() {
            None => Ok(()),
            Some(name) => Err(unknown_parameter(name)),
        }
    }
}

/// The name `labels.{attribute}` of `labels[{attribute}]`; none for other names. An attribute whose name has brackets is
/// written with a dot.
fn dotted(name: &str) -> Option<String> {
    let attribute = name.strip_prefix("labels[")?.strip_suffix(']')?;
    (!attribute.contains(['[', ']'])).then(|| format!("{ATTRIBUTE}{attribute}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(pairs: &[(&str, &str)]) -> Result<(ShapeFilter, Vec<String>), Problem> {
        let pairs = pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        let mut parameters = Parameters::once_each(pairs)?;
        let filter = parameters.take_filter();
        Ok((filter, parameters.0.into_keys().collect()))
    }

    #[test]
    fn dots_and_brackets_name_the_same_attribute() {
        let (dots, rest) = read(&[("label", "a"), ("labels.site", "zrh"), ("labels.a.b", "1")]).unwrap();
        assert_eq!((dots.label.as_deref(), &dots.subject, rest.len()), (Some("a"), &None, 0));
        let wanted = [("a.b", "1"), ("site", "zrh")].map(|(name, value)| (name.to_owned(), value.to_owned()));
        assert_eq!(dots.labels, wanted.into());
        let (brackets, rest) =
            read(&[("label", "a"), ("labels[site]", "zrh"), ("labels[a.b]", "1")]).unwrap();
        assert_eq!((brackets, rest.len()), (dots, 0));
    }

    #[test]
    fn brackets_belong_to_an_attribute_only_around_it() {
        let (filter, rest) = read(&[("labels.a[b]", "1"), ("labels[a][b]", "2"), ("labels[a", "3")]).unwrap();
        assert_eq!(filter.labels.into_iter().collect::<Vec<_>>(), [("a[b]".to_owned(), "1".to_owned())]);
        assert_eq!(rest, ["labels[a", "labels[a][b]"]);
    }

    #[test]
    fn an_attribute_is_given_once_in_either_form() {
        for names in [["labels.site", "labels[site]"], ["labels[site]", "labels[site]"], ["label", "label"]] {
            assert!(read(&names.map(|name| (name, "zrh"))).is_err(), "{names:?}");
        }
    }
}
