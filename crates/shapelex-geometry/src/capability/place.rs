//! Places of shapes by name: a parameter of a curve, a pair of parameters of a surface, a landmark.

use super::domain::Domain;
use crate::field_fault::FieldFault;
use crate::influence::weights;
use crate::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::sparse::SparseRows;

/// A place of a shape: the parameter `u` of a curve, `u` and `v` of a surface, or the index of a landmark, from 0.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(untagged))]
pub enum Place {
    /// `u` of a curve, or the index of a landmark.
    One(f64),
    /// `u` and `v` of a surface.
    Two([f64; 2]),
}

/// Written by hand: the derived error of an untagged enum names neither the place nor the fault.
#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for Place {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct PlaceVisitor;
        impl<'de> serde::de::Visitor<'de> for PlaceVisitor {
            type Value = Place;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(
                    "a parameter of a curve, a pair of parameters of a surface, or the index of a landmark",
                )
            }

            fn visit_f64<E: serde::de::Error>(self, u: f64) -> Result<Place, E> {
                Ok(Place::One(u))
            }

            fn visit_i64<E: serde::de::Error>(self, u: i64) -> Result<Place, E> {
                Ok(Place::One(u as f64))
            }

            fn visit_u64<E: serde::de::Error>(self, u: u64) -> Result<Place, E> {
                Ok(Place::One(u as f64))
            }

            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, list: A) -> Result<Place, A::Error> {
                serde::Deserialize::deserialize(serde::de::value::SeqAccessDeserializer::new(list))
                    .map(Place::Two)
            }
        }
        deserializer.deserialize_any(PlaceVisitor)
    }
}

impl Place {
    /// `u`, or the index of a landmark.
    pub fn first(self) -> f64 {
        match self {
            Self::One(u) | Self::Two([u, _]) => u,
        }
    }
}

impl ShapeSpace {
    /// Faults of places that shapes of this space do not have, by index.
    pub fn place_faults(&self, places: &[Place]) -> Vec<FieldFault> {
        let domain = self.domain();
        let last = self.representation().size() - 1;
        let fault = |place: &Place| match (domain, *place) {
            (Domain::Points, Place::One(index))
                if index.fract() == 0.0 && (0.0..=last as f64).contains(&index) =>
            {
                None
            }
            (Domain::Points, Place::One(index)) => {
                Some(format!("expected the index of a landmark, 0 to {last}, got {index}"))
            }
            (Domain::Points, Place::Two(_)) => Some("expected the index of a landmark, got a pair".into()),
            (domain, Place::One(u)) if domain.is_line() => domain.line_fault(u),
            (domain, Place::Two(_)) if domain.is_line() => {
                Some("expected the parameter u of a curve, got a pair".into())
            }
            (domain, Place::Two(pair)) if domain.is_sheet() => {
                domain.pair_faults(&[pair]).into_iter().next().map(|fault| fault.detail)
            }
            (domain, Place::One(_)) if domain.is_sheet() => {
                Some("expected a pair [u, v], got a number".into())
            }
            _ => Some("expected a curve, a surface or landmarks: other shapes have no parameters".into()),
        };
        let faults = places.iter().enumerate().filter_map(|(i, place)| Some((i, fault(place)?)));
        faults.map(|(i, detail)| FieldFault::new(i.to_string(), detail)).collect()
    }

    /// Points of a shape (`N × d` control points) at places, `d` coordinates for each in the unit of the control points; `None` if
    /// it has no such places. Cost: that of [`Self::weights_at`], and the same for each coordinate.
    pub fn points_at(&self, control_points: &Matrix, places: &[Place]) -> Option<Vec<Vec<f64>>> {
        let weights = self.weights_at(places)?;
        let columns: Vec<Vec<f64>> =
            control_points.column_iter().map(|column| weights.apply_column(column.as_slice())).collect();
        Some((0..places.len()).map(|i| columns.iter().map(|column| column[i]).collect()).collect())
    }

    /// Points at places as weighted sums of control points: a row for each place, a column for each of the `N` control points; `None`
    /// if shapes have no such places.
    ///
    /// Cost: the supports of the generators at each place, whatever the number of control points.
    pub fn weights_at(&self, places: &[Place]) -> Option<SparseRows> {
        let size = self.representation().size();
        let mut rows = SparseRows::new(size, places.len(), 4 * places.len());
        for place in places {
            let weights = match place {
                Place::One(index) if self.domain() == Domain::Points => {
                    Some(*index as usize).filter(|index| *index < size).map(|index| vec![(index, 1.0)])?
                }
                Place::One(u) if self.line().is_some() => weights(self, &[*u]),
                Place::Two(uv) if self.surface().is_some() => weights(self, uv),
                _ => return None,
            };
            let row: Vec<(u32, f64)> = weights.into_iter().map(|(k, weight)| (k as u32, weight)).collect();
            rows.push(&row);
        }
        Some(rows)
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample::Parameters;
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::Representation;
    use crate::surface::Topology;
    use crate::surface::seam::Seam;

    /// Weighted sums of control points are the points that the evaluation of curves and surfaces gives.
    #[test]
    fn points_at_places_are_those_of_the_evaluation() {
        let generator = GeneratorKind::Trigonometric {};
        let topology = Topology::Sphere;
        let representations = [
            Representation::ClosedCurve { dimension: 2, control_points: 8, generator: generator.clone() },
            Representation::OpenCurve { dimension: 3, intervals: 6, generator },
            Representation::Surface {
                topology,
                seam: Seam::Straight,
                control_points: [6, 5],
                generators: topology.usual_generators(),
            },
        ];
        let at = [0.0, 0.13, 0.5, 0.987, 1.0];
        for representation in representations {
            let space = ShapeSpace::new(&representation).unwrap();
            let (size, d) = (representation.size(), representation.dimension());
            let control_points = Matrix::from_fn(size, d, |k, c| (7.0 * (3 * k + c) as f64).sin());
            let pairs = at.map(|u| [u, 1.0 - u]);
            let (places, parameters) = match space.line() {
                Some(_) => (at.map(Place::One), Parameters::At(at.to_vec())),
                None => (pairs.map(Place::Two), Parameters::Pairs(pairs.to_vec())),
            };
            let found = space.points_at(&control_points, &places).unwrap();
            let evaluation = space.evaluate(&control_points, &parameters, 0, false).unwrap();
            let (_, wanted) = &evaluation.derivatives[0];
            for (i, point) in found.iter().enumerate() {
                for (c, x) in point.iter().enumerate() {
                    let wanted = wanted[c * at.len() + i];
                    assert!((x - wanted).abs() < 1e-13, "{representation:?} {i}: {x} {wanted}");
                }
            }
        }
    }

    #[test]
    fn only_places_that_a_shape_has_are_taken() {
        let landmarks = ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: 3 }).unwrap();
        let generator = GeneratorKind::Trigonometric {};
        let curve = Representation::ClosedCurve { dimension: 2, control_points: 8, generator };
        let curve = ShapeSpace::new(&curve).unwrap();
        let places = [Place::One(2.0), Place::One(0.5), Place::Two([0.1, 0.2]), Place::One(f64::NAN)];
        let faulty = |space: &ShapeSpace| -> Vec<String> {
            space.place_faults(&places).into_iter().map(|fault| fault.field).collect()
        };
        assert_eq!(faulty(&landmarks), ["1", "2", "3"]);
        assert_eq!(faulty(&curve), ["2"]);
        let points = Matrix::from_row_slice(3, 2, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(landmarks.points_at(&points, &[Place::One(2.0)]).unwrap(), [[4.0, 5.0]]);
        assert!(landmarks.points_at(&points, &[Place::One(3.0)]).is_none());
    }
}
