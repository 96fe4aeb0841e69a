//! Repeatability against the vectors of `tests/vectors/models/mixed.json` (1e-10), and its laws.

use serde_json::Value;
use shapelex_analysis::models::anova::Testing;
use shapelex_analysis::models::error::ModelError;
use shapelex_analysis::models::repeatability::records::RepeatabilityRecord;
use shapelex_analysis::models::repeatability::{RepeatabilityQuestion, of_vectors};
use shapelex_analysis::watch::Unwatched;
use shapelex_numeric::dense::Matrix;

use super::models::{close, load, response, texts};

struct Case {
    subjects: Vec<String>,
    replicates: Option<Vec<String>>,
    groups: Option<Vec<String>>,
    vectors: Matrix,
}

impl Case {
    fn new(value: &Value) -> Self {
        let replicates = value["replicate"].is_array().then(|| texts(&value["replicate"]));
        let (subjects, vectors) = (texts(&value["subject"]), response(&value["y"]));
        Self { subjects, replicates, groups: None, vectors }
    }

    fn question(&self, draws: usize) -> RepeatabilityQuestion<'_> {
        RepeatabilityQuestion {
            subjects: &self.subjects,
            replicates: self.replicates.as_deref(),
            groups: self.groups.as_deref(),
            samples: 1,
            draws,
            testing: Testing { permutations: 199, ..Testing::default() },
        }
    }

    fn found(&self, draws: usize) -> RepeatabilityRecord {
        let weights = vec![1.0; self.subjects.len()];
        of_vectors(&self.vectors, &weights, &self.question(draws), &Unwatched).unwrap()
    }

    /// The same with shapes in another order.
    fn ordered(&self, order: &[usize]) -> Self {
        let of = |texts: &Vec<String>| order.iter().map(|&k| texts[k].clone()).collect();
        Self {
            subjects: of(&self.subjects),
            replicates: self.replicates.as_ref().map(of),
            groups: self.groups.as_ref().map(of),
            vectors: self.vectors.select_columns(order),
        }
    }
}

#[test]
fn intraclass_correlations_are_those_of_the_vectors() {
    let vectors = load("mixed.json");
    for name in ["unbalanced", "balanced"] {
        let (found, wanted) = (Case::new(&vectors[name]).found(0), &vectors[name]["icc"]);
        let number = |field: &str| wanted[field].as_f64().unwrap();
        for (found, field) in [
            (found.mean_square_between, "ms_subject"),
            (found.mean_square_within, "ms_within"),
            (found.shapes_per_subject, "n0"),
            (found.icc.unwrap().value, "icc"),
            (found.variance_between, "variance_subject"),
            (found.variance_within, "variance_within"),
        ] {
            close(found, number(field), 1e-10, &format!("{name} {field}"));
        }
        assert_eq!((found.icc.unwrap().low, found.draws), (None, 0));
    }
    let found = Case::new(&vectors["balanced"]).found(0);
    let wanted = &vectors["balanced"]["icc"];
    close(found.agreement.unwrap().value, wanted["icc_agreement"].as_f64().unwrap(), 1e-10, "agreement");
    close(
        found.consistency.unwrap().value,
        wanted["icc_consistency"].as_f64().unwrap(),
        1e-10,
        "consistency",
    );
    let [subject, replicate] = found.measurement_error.as_slice() else { panic!("{found:?}") };
    close(replicate.signal_to_noise.unwrap(), wanted["snr_replicate"].as_f64().unwrap(), 1e-10, "SNR");
    close(replicate.term.mean_square.unwrap(), wanted["ms_replicate"].as_f64().unwrap(), 1e-10, "MS");
    let within = 12.0 * wanted["ms_within"].as_f64().unwrap();
    close(replicate.eta_squared.unwrap(), replicate.term.sum_of_squares / within, 1e-10, "η²");
    assert_eq!(subject.eta_squared, None);
    // Exchanges within six subjects of three; subjects by all residuals.
    assert_eq!(
        (format!("{:?}", replicate.term.exchange), format!("{:?}", subject.term.exchange)),
        ("Within".into(), "Free".into())
    );
    assert!(subject.term.p.unwrap() < 0.02 && replicate.term.p.unwrap() > 0.05, "{found:?}");
}

#[test]
fn neither_the_order_of_the_shapes_nor_copies_of_all_matter() {
    let case = Case::new(&load("mixed.json")["balanced"]);
    let found = case.found(200);
    let order: Vec<usize> = (0..18).map(|k| k * 7 % 18).collect();
    let other = case.ordered(&order).found(200);
    for (a, b) in [(found.icc, other.icc), (found.agreement, other.agreement)] {
        close(b.unwrap().value, a.unwrap().value, 1e-12, "another order");
    }
    let bounded = found.icc.unwrap();
    assert!(bounded.low.unwrap() < bounded.value && bounded.value < bounded.high.unwrap(), "{bounded:?}");
    // The draws are those of the seed.
    assert_eq!(case.found(200), found);
    // Every shape twice: no scatter between the copies, so that the mean square within halves but for its degrees of freedom.
    let twice = case.ordered(&(0..36).map(|k| k / 2).collect::<Vec<_>>()).found(0);
    close(twice.shapes_per_subject, 6.0, 1e-12, "n0");
    close(twice.mean_square_between, 2.0 * found.mean_square_between, 1e-10, "between");
    close(twice.mean_square_within, 2.0 * found.mean_square_within * 12.0 / 30.0, 1e-10, "within");
    assert!(
        twice.agreement.is_none() && twice.warnings.iter().any(|text| text.contains("once")),
        "{twice:?}"
    );
}

#[test]
fn equal_replicates_are_repeated_perfectly() {
    let mut case = Case::new(&load("mixed.json")["balanced"]);
    for k in 0..18 {
        let first = case.vectors.column(k / 3 * 3).into_owned();
        case.vectors.set_column(k, &first);
    }
    let found = case.found(20);
    close(found.icc.unwrap().value, 1.0, 1e-12, "icc");
    close(found.consistency.unwrap().value, 1.0, 1e-12, "consistency");
    assert_eq!(found.measurement_error[1].signal_to_noise, None, "{found:?}");
}

#[test]
fn a_device_that_moves_all_shapes_is_named() {
    let mut case = Case::new(&load("mixed.json")["balanced"]);
    (0..18).filter(|k| k % 3 == 2).for_each(|k| case.vectors[(0, k)] += 3.0);
    let found = case.found(0);
    let replicate = &found.measurement_error[1];
    assert!(replicate.term.p.unwrap() < 0.02 && replicate.eta_squared.unwrap() > 0.7, "{replicate:?}");
    assert!(found.agreement.unwrap().value < found.consistency.unwrap().value - 0.1, "{found:?}");
    // Groups of subjects in which the device differs.
    case.groups = Some((0..18).map(|k| if k < 9 { "a" } else { "b" }.to_owned()).collect());
    let found = case.found(0);
    let names: Vec<&str> = found.measurement_error.iter().map(|row| row.term.term.as_str()).collect();
    assert_eq!(names, ["subject", "replicate", "group:replicate"]);
    // Subjects given all else, so given the groups.
    assert_eq!(found.measurement_error.iter().map(|row| row.term.degrees).collect::<Vec<_>>(), [4, 2, 2]);
    case.groups = Some((0..18).map(|k| format!("{}", k % 2)).collect());
    let refused = of_vectors(&case.vectors, &[1.0; 18], &case.question(0), &Unwatched);
    assert!(matches!(refused, Err(ModelError::Unidentified { detail }) if detail.contains("one group")));
}

#[test]
fn single_shapes_have_no_repeatability() {
    let mut case = Case::new(&load("mixed.json")["balanced"]);
    case.subjects = (0..18).map(|k| k.to_string()).collect();
    let refused = of_vectors(&case.vectors, &[1.0; 18], &case.question(0), &Unwatched);
    assert!(
        matches!(refused, Err(ModelError::Unidentified { detail }) if detail.contains("0 of 18 subjects"))
    );
}

#[test]
fn directions_are_repeated_as_well_as_the_best_coordinate_and_as_badly_as_the_worst() {
    // Two uncorrelated coordinates of their own repeatability: the directions are these coordinates.
    let subjects: Vec<String> = (0..40).map(|k| (k / 4).to_string()).collect();
    let sign = |k: usize, period: usize| if (k / period).is_multiple_of(2) { 1.0 } else { -1.0 };
    let value = |i: usize, k: usize| match i {
        0 => 3.0 * sign(k, 4) + 0.5 * sign(k, 1),
        _ => 0.4 * sign(k, 8) + 2.0 * sign(k, 2),
    };
    let case = Case { subjects, replicates: None, groups: None, vectors: Matrix::from_fn(2, 40, value) };
    let parts = case.found(0).components.unwrap();
    let alone = |i: usize| {
        let vectors = case.vectors.rows(i, 1).into_owned();
        Case { subjects: case.subjects.clone(), replicates: None, groups: None, vectors }
            .found(0)
            .icc
            .unwrap()
            .value
    };
    assert_eq!(parts.components, 2);
    for (found, wanted) in parts.repeatability.iter().zip([alone(0), alone(1)]) {
        assert!((found - wanted).abs() < 1e-10, "{found} for {wanted}");
    }
    assert!(parts.repeatability[0] > 0.9 && parts.repeatability[1] < 0.0, "{parts:?}");
}
