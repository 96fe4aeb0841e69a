//! The vectors of `tests/vectors/analysis`; tolerance 1e-9 relative, as their source states.

use std::path::Path;

use serde_json::Value;
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, Method, Projector, align_all};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::Matching;
use shapelex_analysis::mean::{MeanSpace, ProjectorSum};
use shapelex_analysis::metric::Metric;
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::transformation::Transformation;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::knot_line::gram_row;
use shapelex_geometry::representation::{Representation, ShapeSpace};

const TOLERANCE: f64 = 1e-9;

fn load(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/analysis").join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn generator(name: &str) -> GeneratorKind {
    match name {
        "trigonometric" => GeneratorKind::Trigonometric {},
        "keys" => GeneratorKind::Cubic {},
        "bspline_linear" => GeneratorKind::Bspline { degree: 1 },
        "bspline_quadratic" => GeneratorKind::Bspline { degree: 2 },
        "bspline_cubic" => GeneratorKind::Bspline { degree: 3 },
        other => panic!("unknown generator {other}"),
    }
}

fn space(name: &str, n: usize) -> ShapeSpace {
    let generator = generator(name);
    ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: n, generator }).unwrap()
}

/// Rows of points to coordinate-major numbers.
fn flat(points: &Value) -> Vec<f64> {
    let rows = points.as_array().unwrap();
    (0..2).flat_map(|c| rows.iter().map(move |row| row[c].as_f64().unwrap())).collect()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn close(found: &[f64], wanted: &[f64], what: &str) {
    assert_eq!(found.len(), wanted.len(), "{what}: lengths");
    let scale = wanted.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
    for (i, (a, b)) in found.iter().zip(wanted).enumerate() {
        assert!(
            (a - b).abs() <= TOLERANCE * scale,
            "{what}[{i}]: {a} for {b} (tolerance {TOLERANCE} · {scale})"
        );
    }
}

#[test]
fn gram_closed() {
    for case in load("gram_closed.json").as_array().unwrap() {
        let n = case["control_points"].as_u64().unwrap() as usize;
        let name = case["generator"].as_str().unwrap();
        let generator = generator(name).build(n).unwrap();
        close(&gram_row(&generator.generator, n, 0, 0), &numbers(&case["first_row"]), name);
    }
}

#[test]
fn projectors() {
    let cases = load("projectors.json");
    assert_eq!(cases.as_array().unwrap().len(), 28);
    for case in cases.as_array().unwrap() {
        let (reference, query) = (flat(&case["reference"]), flat(&case["query"]));
        let metric = Metric::of(&space(case["generator"].as_str().unwrap(), reference.len() / 2));
        let transformation: Transformation = serde_json::from_value(case["transformation"].clone()).unwrap();
        let method = Method::new(&transformation, Alignment::Projection, 2).unwrap();
        let what = case["transformation"].as_str().unwrap();
        // `projected` is the member of the reference's subspace nearest to the query
        let found = Projector::new(&metric, &method, query).project(reference).unwrap();
        close(&found.control_points, &flat(&case["projected"]), what);
        let rows: Vec<f64> = found.matrix.transpose().iter().copied().collect();
        let wanted: Vec<f64> = case["matrix"].as_array().unwrap().iter().flat_map(numbers).collect();
        close(&rows, &wanted, &format!("{what} matrix"));
        close(&found.offset, &numbers(&case["offset"]), &format!("{what} offset"));
        close(
            &[found.squared_distance],
            &[case["squared_distance"].as_f64().unwrap()],
            &format!("{what} distance"),
        );
    }
}

/// `tr Ψ(I − P)` of the shape prior: `d·tr Φ − Σ ‖R q‖²…`, here by projecting every unit vector.
#[test]
fn prior_traces() {
    for case in load("projectors.json").as_array().unwrap() {
        let reference = flat(&case["reference"]);
        let length = reference.len();
        let metric = Metric::of(&space(case["generator"].as_str().unwrap(), length / 2));
        let transformation: Transformation = serde_json::from_value(case["transformation"].clone()).unwrap();
        let method = Method::new(&transformation, Alignment::Projection, 2).unwrap();
        let trace: f64 = (0..length)
            .map(|i| {
                let mut unit = vec![0.0; length];
                unit[i] = 1.0;
                Projector::new(&metric, &method, unit).project(reference.clone()).unwrap().squared_distance
            })
            .sum();
        close(&[trace], &[case["prior_energy_matrix_trace"].as_f64().unwrap()], "trace of the prior");
    }
}

#[test]
fn mean_alignment_pca() {
    let cases = load("mean_alignment_pca.json");
    assert_eq!(cases.as_array().unwrap().len(), 10);
    for case in cases.as_array().unwrap() {
        let shapes: Vec<Vec<f64>> = case["shapes"].as_array().unwrap().iter().map(flat).collect();
        let name = case["generator"].as_str().unwrap();
        let what = case["transformation"].as_str().unwrap();
        let space = space(name, shapes[0].len() / 2);
        let metric = Metric::of(&space);
        let transformation: Transformation = serde_json::from_value(case["transformation"].clone()).unwrap();
        let method = Method::new(&transformation, Alignment::Projection, 2).unwrap();
        let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
        let weights = vec![1.0; shapes.len()];
        let (mean, aligned) =
            align_all(&metric, &method, Frame::Training, &matching, shapes.concat(), weights.clone())
                .unwrap();

        let wanted = numbers(&case["eigenvalues"]);
        let found: Vec<f64> =
            (0..wanted.len()).map(|i| mean.eigenvalues.get(i).copied().unwrap_or(0.0)).collect();
        close(&found, &wanted, &format!("{name} {what} eigenvalues"));
        close(&mean.control_points, &flat(&case["mean_training_frame"]), &format!("{name} {what} mean"));
        for (k, wanted) in case["aligned"].as_array().unwrap().iter().enumerate() {
            let mut control_points = aligned[k].whitened.clone();
            metric.unwhiten(&mut control_points);
            close(&control_points, &flat(wanted), &format!("{name} {what} aligned {k}"));
        }
        projector_onto_the_mean_space(case, &metric, &method, &shapes);
        principal_components(case, &metric, &mean.whitened, &aligned);
    }
}

fn projector_onto_the_mean_space(case: &Value, metric: &Metric, method: &Method, shapes: &[Vec<f64>]) {
    let Method::Projection(class) = method else { panic!("a projection") };
    let source =
        ShapesInMemory::new(metric, class.translates(), shapes.concat(), vec![1.0; shapes.len()]).unwrap();
    let space = MeanSpace::new(ProjectorSum::of(&source, class, metric.len()).unwrap(), 6).unwrap();
    for (row, wanted) in case["mean_space_projector"].as_array().unwrap().iter().enumerate() {
        // column `row` of Pᵀ in control-point coordinates: R⁻¹ P R e
        let found: Vec<f64> = (0..metric.len())
            .map(|column| {
                let mut unit = vec![0.0; metric.len()];
                unit[column] = 1.0;
                metric.whiten(&mut unit);
                let mut projected = space.project(&unit);
                metric.unwhiten(&mut projected);
                projected[row]
            })
            .collect();
        close(&found, &numbers(wanted), &format!("mean space projector row {row}"));
    }
}

fn principal_components(
    case: &Value,
    metric: &Metric,
    mean: &[f64],
    aligned: &[shapelex_analysis::alignment::AlignedShape],
) {
    let weights = vec![1.0; aligned.len()];
    let control_points: Vec<f64> = aligned
        .iter()
        .flat_map(|shape| {
            let mut c = shape.whitened.clone();
            metric.unwhiten(&mut c);
            c
        })
        .collect();
    let source = ShapesInMemory::new(metric, false, control_points, weights).unwrap();
    let pca = FunctionalPca::new(&source, metric, mean, false, 10).unwrap();
    let wanted = &case["pca"];
    close(&pca.eigenvalues, &numbers(&wanted["eigenvalues"]), "pca eigenvalues");
    close(&pca.explained, &numbers(&wanted["explained"]), "pca explained");
    let mut first: Vec<f64> = pca.eigenshapes.column(0).iter().copied().collect();
    metric.unwhiten(&mut first);
    let expected = flat(&wanted["first_eigenshape_up_to_sign"]);
    let sign = first.iter().zip(&expected).map(|(a, b)| a * b).sum::<f64>().signum();
    close(&first.iter().map(|v| sign * v).collect::<Vec<_>>(), &expected, "first eigenshape");
    let scores = pca.all_scores(&source).unwrap();
    for (i, row) in wanted["abs_scores"].as_array().unwrap().iter().enumerate() {
        let found: Vec<f64> = scores.iter().map(|shape| shape[i].abs()).collect();
        close(&found, &numbers(row), &format!("scores of component {i}"));
    }

    let centred = FunctionalPca::new(&source, metric, mean, true, 10).unwrap();
    let wanted = &case["pca_centred"];
    let mut average = centred.mean.clone();
    metric.unwhiten(&mut average);
    close(&average, &flat(&wanted["mean"]), "pca mean");
    close(&centred.eigenvalues, &numbers(&wanted["eigenvalues"]), "centred eigenvalues");
    close(&centred.explained, &numbers(&wanted["explained"]), "centred explained");
}

#[test]
fn norm_equality() {
    let case = load("norm_equality.json");
    let curve = flat(&case["curve"]);
    let metric = Metric::of(&space("trigonometric", curve.len() / 2));
    let alpha = numbers(&case["alpha"]);
    let mut difference = curve.clone();
    for (weight, atom) in alpha.iter().zip(case["atoms"].as_array().unwrap()) {
        difference.iter_mut().zip(flat(atom)).for_each(|(c, a)| *c -= weight * a);
    }
    let wanted = case["squared_norm"].as_f64().unwrap();
    close(&[metric.inner(&difference, &difference)], &[wanted], "by the Gram operator");
    metric.whiten(&mut difference);
    close(&[difference.iter().map(|v| v * v).sum()], &[wanted], "by whitening");
    let mut whitened = curve;
    metric.whiten(&mut whitened);
    close(&whitened, &numbers(&case["whitened_curve"]), "whitened curve");
}

#[test]
fn lasso() {
    use shapelex_analysis::sparse::{Atoms, Encode, Lasso};
    use shapelex_numeric::dense::Matrix;
    for case in load("lasso.json").as_array().unwrap() {
        let listed: Vec<Vec<f64>> =
            case["dictionary_columns"].as_array().unwrap().iter().map(numbers).collect();
        let x = numbers(&case["x"]);
        let atoms = Atoms::new(Matrix::from_fn(x.len(), listed.len(), |i, j| listed[j][i]));
        let lasso = Lasso { tolerance: 1e-14, ..Lasso::new(case["lam"].as_f64().unwrap(), false) };
        close(&[atoms.lambda_max(&x)], &[case["lambda_max"].as_f64().unwrap()], "lambda_max");
        let found = lasso.codes(&atoms, &x).unwrap().remove(0);
        close(&found.dense(listed.len()), &numbers(&case["code"]), "code");
        close(&[found.objective], &[case["objective"].as_f64().unwrap()], "objective");
        assert!(found.duality_gap.unwrap() <= 1e-14 * x.iter().map(|v| v * v).sum::<f64>());
    }
}

#[test]
fn geodesics() {
    use shapelex_analysis::path::Path;
    let case = load("geodesics.json");
    let (first, second) = (flat(&case["first"]), flat(&case["second"]));
    let metric = Metric::of(&space(case["generator"].as_str().unwrap(), first.len() / 2));
    let plane = Path::plane(first.clone(), second.clone());
    let sphere = Path::sphere(&metric, first.clone(), second).unwrap();
    close(&[sphere.angle().unwrap()], &[case["angle"].as_f64().unwrap()], "angle");
    for (i, tau) in numbers(&case["tau"]).into_iter().enumerate() {
        close(&plane.at(tau), &flat(&case["plane"][i]), "plane");
        close(&sphere.at(tau), &flat(&case["sphere"][i]), "sphere");
    }
    let opposite: Vec<f64> = first.iter().map(|v| -v).collect();
    assert!(Path::sphere(&metric, first.clone(), opposite).is_err());
    let same = Path::sphere(&metric, first.clone(), first).unwrap();
    assert!(same.at(0.5).iter().zip(same.at(0.0)).all(|(a, b)| (a - b).abs() < 1e-12));
}
