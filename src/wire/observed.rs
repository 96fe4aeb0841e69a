//! The part of a shape that is seen, as JSON.
//!
//! ```json
//! [true, true, false, true]
//! [[0.1, 0.4], [0.6, 0.9]]
//! ```

use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, SeqAccess, Visitor};
use utoipa::ToSchema;

use super::fault::Fault;
use crate::analysis::region::Region;
use crate::geometry::representation::ShapeSpace;

/// An entry of `observed`: whether a control point counts, or an arc.
#[derive(Debug, serde::Serialize, ToSchema)]
#[serde(untagged)]
pub enum ObservedEntry {
    /// Whether a control point counts.
    Control(bool),
    /// First and last parameter.
    Arc([f64; 2]),
}

/// The part of a shape that counts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observed {
    /// Whether each control point counts.
    pub(super) mask: Vec<bool>,
    /// First and last parameter of arcs.
    pub(super) arcs: Vec<[f64; 2]>,
}

impl Observed {
    /// Whether the whole shape counts: true for every control point.
    pub fn is_whole(&self) -> bool {
        self.arcs.is_empty() && self.mask.iter().all(|counts| *counts)
    }
}

impl Observed {
    /// Faults of arcs of shapes of `space`, with pointers relative to the list.
    pub(super) fn arc_faults(&self, space: &ShapeSpace) -> Vec<Fault> {
        if !space.domain().is_line() {
            let detail = "expected true and false for each control point: only curves have arcs";
            return vec![Fault::new("", detail)];
        }
        let closed = space.representation().is_closed();
        let is_proper = |[from, to]: &[f64; 2]| {
            let bounded = from.abs() <= 1e6 && to.abs() <= 1e6 && from != to;
            bounded && (closed || (0.0 <= *from && from < to && *to <= 1.0))
        };
        let range =
            if closed { "two different parameters" } else { "two parameters between 0 and 1, ascending" };
        let improper = self.arcs.iter().enumerate().filter(|(_, arc)| !is_proper(arc));
        let fault = |(i, [from, to]): (usize, &[f64; 2])| {
            Fault::new(format!("/{i}"), format!("expected {range}, got {from} and {to}"))
        };
        improper.map(fault).collect()
    }

    /// The part of shapes of `space` as a region: arcs of curves, otherwise true and false for each place.
    ///
    /// # Errors
    /// All faults, with pointers relative to the list.
    pub fn region(&self, space: &ShapeSpace) -> Result<Region, Vec<Fault>> {
        let fault = |detail: String| Err(vec![Fault::new("", detail)]);
        if !self.arcs.is_empty() {
            if !self.mask.is_empty() {
                return fault("expected either true and false, or arcs, got both".into());
            }
            let faults = self.arc_faults(space);
            return if faults.is_empty() { Ok(Region::of_arcs(space, &self.arcs)) } else { Err(faults) };
        }
        if space.domain().is_line() {
            return fault("expected arcs [from, to] of the curves, got none".into());
        }
        let places = Region::place_count(space);
        if self.mask.len() != places {
            let found = self.mask.len();
            return fault(format!(
                "expected {places} entries, true or false for each place of a shape, got {found}"
            ));
        }
        Ok(Region::of_mask(space, &self.mask))
    }
}

/// Written by hand: the derived error of untagged entries names no place.
impl<'de> Deserialize<'de> for ObservedEntry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct EntryVisitor;
        impl<'de> Visitor<'de> for EntryVisitor {
            type Value = ObservedEntry;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("true or false for a control point, or an arc [from, to]")
            }

            fn visit_bool<E: serde::de::Error>(self, counts: bool) -> Result<ObservedEntry, E> {
                Ok(ObservedEntry::Control(counts))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<ObservedEntry, A::Error> {
                Deserialize::deserialize(serde::de::value::SeqAccessDeserializer::new(list))
                    .map(ObservedEntry::Arc)
            }
        }
        deserializer.deserialize_any(EntryVisitor)
    }
}

/// Read entry by entry: a mask takes a byte for each.
impl<'de> Deserialize<'de> for Observed {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ObservedVisitor;
        impl<'de> Visitor<'de> for ObservedVisitor {
            type Value = Observed;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of true and false, or of arcs")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Observed, A::Error> {
                let mut observed = Observed::default();
                while let Some(entry) = list.next_element()? {
                    match entry {
                        ObservedEntry::Control(counts) => observed.mask.push(counts),
                        ObservedEntry::Arc(arc) => observed.arcs.push(arc),
                    }
                }
                Ok(observed)
            }
        }
        deserializer.deserialize_seq(ObservedVisitor)
    }
}
