//! Drawings of atoms, and modes of components.

use super::ready::Ready;
use crate::analysis::dictionary::model::Model;
use crate::analysis::rows::columns_of;
use crate::geometry::drawing::svg::{self, Layer, colour};
use crate::service::app::ServiceError;

/// Drawing of the atoms, each in its own frame on a common scale.
pub fn draw_atoms(ready: &Ready) -> String {
    let (content, setup) = (&ready.dictionary.content, &ready.setup);
    let cells: Vec<(String, Vec<Layer>)> = content
        .atoms
        .iter()
        .enumerate()
        .map(|(j, atom)| {
            let columns = columns_of(&atom.control_points, setup.metric.dimension());
            let layer = Layer::of(&setup.space, [columns.as_slice()], colour::MAIN, 1.5, 1.0);
            let caption = match atom.explained {
                Some(part) => format!("{}: {:.1} %", j + 1, 100.0 * part),
                None => format!("{}: used by {:.0} %", j + 1, 100.0 * atom.usage),
            };
            (caption, vec![layer])
        })
        .collect();
    svg::grid(&format!("atoms of {} version {}", ready.dictionary.name, ready.dictionary.version), &cells)
}

/// The mean and both sides of a mode.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// Explained fraction `λ_i/Σλ`.
    pub explained: f64,
    /// Standard deviation of the scores.
    pub deviation: f64,
    /// Control points at `s̄ − σ·deviation`, at `s̄` and at `s̄ + σ·deviation`.
    pub shapes: [Vec<f64>; 3],
}

/// The mode of `component` (from 1): `ȳ ± sigma·√C_ii ξ_i`.
///
/// # Errors
/// A component that does not exist, a sparse dictionary, a sigma out of bounds.
pub fn mode(ready: &Ready, component: usize, sigma: f64) -> Result<Mode, ServiceError> {
    let Model::Components { pca, spread } = &ready.model else {
        return Err(ServiceError::Query("a sparse dictionary has atoms, not modes: see …/atoms".into()));
    };
    let found = pca.eigenvalues.len();
    if !(1..=found).contains(&component) {
        return Err(ServiceError::Query(format!(
            "component: expected a number between 1 and {found}, got {component}"
        )));
    }
    if !(sigma.is_finite() && sigma.abs() <= MAX_SIGMA) {
        return Err(ServiceError::Query(format!(
            "sigma: expected a number within ±{MAX_SIGMA}, got {sigma}"
        )));
    }
    let i = component - 1;
    let deviation = spread.covariance[(i, i)].max(0.0).sqrt();
    let shapes = [-1.0, 0.0, 1.0].map(|side| {
        let step = side * sigma * deviation;
        let mut shape: Vec<f64> =
            pca.mean.iter().zip(pca.eigenshapes.column(i).iter()).map(|(m, xi)| m + step * xi).collect();
        ready.setup.metric.unwhiten(&mut shape);
        shape
    });
    Ok(Mode { explained: pca.explained[i], deviation, shapes })
}

/// Maximum step along a mode, in standard deviations.
const MAX_SIGMA: f64 = 1e6;

/// Drawing of a mode.
pub fn draw_mode(ready: &Ready, component: usize, sigma: f64, mode: &Mode) -> String {
    let layer = |shape: &[f64], colour, width| Layer::of(&ready.setup.space, [shape], colour, width, 1.0);
    let [minus, mean, plus] = &mode.shapes;
    let layers = [
        layer(minus, colour::MINUS, 2.0).named(format!("−{sigma} σ")),
        layer(plus, colour::PLUS, 2.0).named(format!("+{sigma} σ")),
        layer(mean, colour::MAIN, 2.5).named("mean"),
    ];
    svg::draw(&format!("mode {component}: {:.1} %", 100.0 * mode.explained), &layers)
}
